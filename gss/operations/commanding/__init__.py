"""Commanding: authority, checks, sending, on-board schedule and history."""
