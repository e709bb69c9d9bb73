"""Objects that move against the stars: light sources without a star, linked over the frames of a sequence; pure."""
