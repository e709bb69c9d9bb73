"""The fast special forms agree with the general functions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from gss.domain.rotation import rotation_from_vector
from gss.pipeline.small import best_rotation, determinant, distances2, median


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_the_median_is_numpys(count: int) -> None:
    """Odd and even counts, in any order."""
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == pytest.approx(np.median(values), abs=1e-15)


def test_the_determinant_is_numpys() -> None:
    """Of any (3, 3) matrix."""
    matrix = np.random.default_rng(1).normal(size=(3, 3))
    assert determinant(matrix) == pytest.approx(np.linalg.det(matrix), rel=1e-12)


@pytest.mark.parametrize("count", [2, 3, 20])
def test_stars_turn_back_as_scipy_turns_them(count: int) -> None:
    """The best rotation of noisy weighted directions is scipy's, and never a reflection."""
    rng = np.random.default_rng(count)
    icrs = rng.normal([0, 0, 8], 1, (count, 3))
    icrs /= np.linalg.norm(icrs, axis=1)[:, None]
    unit = Rotation.random(random_state=3).apply(icrs) + rng.normal(0, 1e-4, (count, 3))
    weight = rng.uniform(1, 9, count)
    ours = best_rotation(unit, icrs, weight)
    assert np.linalg.det(ours) == pytest.approx(1)
    assert ours == pytest.approx(Rotation.align_vectors(unit, icrs, weight)[0].as_matrix(), abs=1e-9)


def test_distances_are_scipys() -> None:
    """Squared, of all pairs of points."""
    rng = np.random.default_rng(2)
    first, second = rng.uniform(0, 999, (5, 2)), rng.uniform(0, 999, (9, 2))
    assert distances2(first, second) == pytest.approx(cdist(first, second, "sqeuclidean"))


@pytest.mark.parametrize("length_rad", [0.0, 1e-12, 1e-6, 0.3, 3.1, 3.2, 6.5])
def test_a_rotation_vector_turns_as_scipy_turns_it(length_rad: float) -> None:
    """From no turn at all to more than a whole one."""
    vector = length_rad * np.array([0.6, -0.64, 0.48])
    assert rotation_from_vector(vector) == pytest.approx(Rotation.from_rotvec(vector).as_matrix(), abs=1e-15)
