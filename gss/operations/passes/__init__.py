"""Passes over ground stations: the active orbit, the stations, coming passes and pass plans."""
