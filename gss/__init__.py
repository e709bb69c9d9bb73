"""GSS: the ground-support system for star trackers."""

__version__ = "0.4.0"
