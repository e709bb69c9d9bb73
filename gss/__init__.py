"""GSS: the ground-support system for star trackers."""

__version__ = "0.1.0"
