"""The line: its owner, its events and their dispatch, captures, contacts, gaps."""
