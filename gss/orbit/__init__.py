"""Orbits of spacecraft and their passes over ground stations. The package uses no clock, files or database."""
