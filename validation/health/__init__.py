"""Health of a sensor over a rendered mission."""
