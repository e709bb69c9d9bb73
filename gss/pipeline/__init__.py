"""Image processing, star identification, attitude and image rendering, with numpy and scipy only."""
