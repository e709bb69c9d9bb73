"""Images: storage, solving, replay, overlays and exports."""
