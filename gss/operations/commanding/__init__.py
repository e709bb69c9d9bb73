"""Commanding: authority, checks, sending, stacks, on-board schedule and history."""
