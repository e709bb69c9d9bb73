"""Rerun recordings: of stored frames, contacts and studies, and live. The only door to rerun."""
