"""API worker processes beside the one link process."""
