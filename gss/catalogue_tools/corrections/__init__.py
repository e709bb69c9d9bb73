"""Where and how bright a star appears at a date, to a camera: one switch each."""
