"""Instrument packages on the server: list, check in a child process, install, export and compare."""
