"""Corrections to star directions and magnitudes for a date and a camera. Each correction can be switched on or off."""
