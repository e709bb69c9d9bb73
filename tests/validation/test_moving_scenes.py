"""Sequences of the experiment of moving objects."""

from __future__ import annotations

import numpy as np

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.instruments.registry import shipped_camera
from validation.moving.population import population
from validation.moving.scenes import SINGLE, scene


def test_an_object_of_a_short_sequence_is_a_line_in_one_frame() -> None:
    """In a sequence with long steps, the object at which the camera points is on the detector in one frame only, with a
    long trail."""
    profile, stars = shipped_camera("sunsat"), load_stars(4.0)
    objects = population(400, np.random.default_rng([1, 0]))
    for seed in range(3):
        rendered = scene(profile, stars, objects, (2.5, 4.0), np.random.default_rng([seed, 2]), SINGLE)
        assert len(rendered.images) == SINGLE.frames
        assert np.allclose(np.diff(rendered.times_s), SINGLE.step_s)
        lines = [t for t in rendered.tracks if t.on[1] and t.trail_px[1] >= 0.8 * SINGLE.trail_px]
        assert lines
        assert all(np.count_nonzero(t.on) == 1 for t in lines)
