"""Maintenance of the installation: disk space, retention, backup and restore, store checks, health and metrics."""
