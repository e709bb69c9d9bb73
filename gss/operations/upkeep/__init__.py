"""Keeping the installation well: disk, retention, backup and restore, checking the store, health and figures."""
