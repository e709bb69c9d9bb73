"""Following stars from frame to frame."""
