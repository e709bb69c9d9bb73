"""Health of a sensor over a mission, from its ordinary frames."""
