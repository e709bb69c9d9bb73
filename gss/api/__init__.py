"""HTTP requests and responses; no arithmetic, no SQL."""
