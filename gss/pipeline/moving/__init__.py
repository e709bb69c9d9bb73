"""Objects that move against the stars: light sources that are not stars, linked over the frames of a sequence."""
