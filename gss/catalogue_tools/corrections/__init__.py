"""Corrections to star directions and magnitudes for a date and a camera, each of which can be switched on or off."""
