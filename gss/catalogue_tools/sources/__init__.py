"""Where the stars come from: Hipparcos, Gaia, lists that people bring."""
