"""Images: stored, solved, replayed, drawn, exported."""
