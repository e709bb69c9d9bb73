"""Spacecraft with several heads: mountings, fused attitude, agreement, misalignment and drift."""
