"""Contacts: their records, what is missing in them, reports, and replays of their captures."""
