"""Files up and down, and what the sensor holds in its banks."""
