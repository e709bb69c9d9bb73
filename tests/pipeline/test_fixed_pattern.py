"""Subtraction of a detector's fixed pattern from frames."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.errors import BadInput
from gss.pipeline.fixed_pattern import DarkPattern, clean

PATTERN = np.array([[0, 1, 2], [3, 0, -1], [0, 0, 50]], np.float32)
KNOWN = DarkPattern(PATTERN, np.array([[2, 2]]), 0.25)
LEVEL = 20.0


def test_the_pattern_goes_and_a_hot_pixel_takes_its_neighbours_median() -> None:
    """A constant frame with the pattern becomes constant."""
    frame = (LEVEL + PATTERN).astype(np.uint8)
    assert np.allclose(clean(frame, KNOWN, 255.0, 0.25), LEVEL)


def test_another_exposure_keeps_its_pattern_and_loses_its_hot_pixels() -> None:
    """Four times the exposure has another dark current: only bad pixels are replaced, by good neighbours alone."""
    frame = (LEVEL + PATTERN).astype(np.uint8)
    out = clean(frame, KNOWN, 255.0, 1.0)
    assert out[0, 2] == LEVEL + 2
    assert out[2, 2] == np.median([frame[1, 1], frame[1, 2], frame[2, 1]])
    assert KNOWN.fits(None)
    assert KNOWN.fits(0.3)
    assert not KNOWN.fits(0.31)


def test_what_is_saturated_stays_saturated() -> None:
    """A clipped pixel does not become an unsaturated bright one."""
    frame = np.full((3, 3), 255, np.uint8)
    assert clean(frame, KNOWN, 255.0)[0, 1] == 255.0


def test_a_block_of_bad_pixels_is_mended_where_it_has_neighbours() -> None:
    """The middle of a 3 x 3 block has no good neighbour and stays as it is."""
    bad = np.array([[c, r] for c in (1, 2, 3) for r in (1, 2, 3)])
    frame = np.full((5, 5), 7.0, np.float32)
    frame[1:4, 1:4] = 99.0
    out = clean(frame, DarkPattern(np.zeros((5, 5), np.float32), bad, 0.1), 1e9)
    assert out[2, 2] == 99.0
    assert (np.delete(out.ravel(), 12) == 7.0).all()


def test_a_frame_of_another_size_is_refused() -> None:
    """Expected and got are named."""
    with pytest.raises(BadInput, match="does not fit this detector"):
        clean(np.zeros((4, 4), np.uint8), KNOWN, 255.0)
