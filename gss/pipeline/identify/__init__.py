"""Which catalogue star is which centroid."""
