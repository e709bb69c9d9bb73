"""Passes over ground stations: the orbit in use, the stations, coming passes and pass plans."""
