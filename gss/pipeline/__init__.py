"""From image to attitude and back. Pure numpy and scipy."""
