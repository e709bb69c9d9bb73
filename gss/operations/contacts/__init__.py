"""Contacts: their records, gaps in the records, reports, and replays of their captures."""
