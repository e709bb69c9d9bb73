"""Compiled search for the stars near a direction."""

from __future__ import annotations

import numpy as np
import pytest

from gss.pipeline.loops.cells import room_near, stars_near
from gss.skytables.cells import lattice, sky_cells

POLES = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]


def test_the_lattice_falls_by_equal_steps() -> None:
    """The compiled search computes from this which cells it must look at."""
    z = lattice(0.1)[:, 2]
    assert np.allclose(np.diff(z), -2 / len(z))
    assert z[0] == pytest.approx(1 - 1 / len(z))


@pytest.mark.parametrize("stars", [1, 40, 5000])
@pytest.mark.parametrize("angle_deg", [0.001, 2.0, 30.0, 100.0, 170.0, 180.0])
def test_exactly_the_stars_within_the_angle_are_found(stars: int, angle_deg: float) -> None:
    rng = np.random.default_rng(stars)
    icrs = rng.normal(size=(stars, 3))
    icrs[: stars // 10] *= [1e-3, 1e-3, 1]  # many close to the poles
    icrs /= np.linalg.norm(icrs, axis=1)[:, None]
    cells, cosine = sky_cells(icrs).arrays, np.cos(np.radians(angle_deg))
    out = np.empty(stars, np.int64)
    for z in np.concatenate([POLES, icrs[:: max(stars // 20, 1)], lattice(0.5)]):
        expected = np.flatnonzero(icrs @ z > cosine)
        count = stars_near(icrs, cells, z, cosine, stars, out)
        assert np.array_equal(np.sort(out[:count]), expected)
        assert room_near(cells, z, cosine) >= count
