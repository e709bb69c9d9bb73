"""Catalogue management: preview, build, storage, reports, camera design."""
