"""Orbits of spacecraft and their passes over ground stations. Pure: no clock, file or database."""
