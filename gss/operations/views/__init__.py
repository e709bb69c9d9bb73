"""Shared views: pages of the console with their state, stored under a name."""
