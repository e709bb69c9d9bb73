"""Rerun recordings of stored frames, contacts and studies, and live. Only this package imports rerun."""
