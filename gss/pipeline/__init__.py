"""Image processing, star identification, attitude and image rendering. Uses only numpy and scipy and has no side
effects."""
