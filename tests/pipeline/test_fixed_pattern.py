"""Subtraction of a detector's fixed pattern from frames."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.errors import BadInput
from gss.pipeline.fixed_pattern import DarkPattern, clean

PATTERN = np.array([[0, 1, 2], [3, 0, -1], [0, 0, 50]], np.float32)
DARK = DarkPattern(PATTERN, np.array([[2, 2]]), 0.25)
LEVEL = 20.0


def test_the_pattern_is_subtracted_and_hot_pixels_are_replaced() -> None:
    """A constant frame with the pattern becomes constant, including the hot pixel."""
    frame = (LEVEL + PATTERN).astype(np.uint8)
    assert np.allclose(clean(frame, DARK, 255.0, 0.25), LEVEL)


def test_at_another_exposure_only_hot_pixels_are_replaced() -> None:
    """At four times the exposure the dark current differs, so only bad pixels are replaced, by the median of their good
    neighbours.
    """
    frame = (LEVEL + PATTERN).astype(np.uint8)
    cleaned = clean(frame, DARK, 255.0, 1.0)
    assert cleaned[0, 2] == LEVEL + 2
    assert cleaned[2, 2] == np.median([frame[1, 1], frame[1, 2], frame[2, 1]])
    assert DARK.fits(None)
    assert DARK.fits(0.3)
    assert not DARK.fits(0.31)


def test_saturated_pixels_remain_saturated() -> None:
    """A saturated pixel is not changed, although the pattern there is not zero."""
    frame = np.full((3, 3), 255, np.uint8)
    assert clean(frame, DARK, 255.0)[0, 1] == 255.0


def test_bad_pixels_with_good_neighbours_are_replaced() -> None:
    """In a block of 3 x 3 bad pixels, the middle one has no good neighbour and is not changed; the others are replaced."""
    bad_px = np.array([[c, r] for c in (1, 2, 3) for r in (1, 2, 3)])
    frame = np.full((5, 5), 7.0, np.float32)
    frame[1:4, 1:4] = 99.0
    cleaned = clean(frame, DarkPattern(np.zeros((5, 5), np.float32), bad_px, 0.1), 1e9)
    assert cleaned[2, 2] == 99.0
    assert (np.delete(cleaned.ravel(), 12) == 7.0).all()


def test_a_frame_of_another_size_is_rejected() -> None:
    """A frame whose size differs from the detector's is rejected."""
    with pytest.raises(BadInput, match="does not fit this detector"):
        clean(np.zeros((4, 4), np.uint8), DARK, 255.0)
