"""Page files and response compression."""
