"""Shades of maps, from light for small values to dark for large ones."""

from __future__ import annotations

SHADES = ("#eef4fa", "#cfe1f0", "#9fc5e3", "#6aa3d0", "#3a7fb5", "#1c5a8c", "#0c3a5f")


def shade(value: float, low: float, high: float) -> str:
    """Return the colour of a value between low and high."""
    share = 0.5 if high <= low else (value - low) / (high - low)
    return SHADES[min(len(SHADES) - 1, int(share * len(SHADES)))]
