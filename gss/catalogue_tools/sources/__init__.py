"""Sources of stars: Hipparcos, Gaia, users' lists."""
