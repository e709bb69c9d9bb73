"""Fast special cases agree with the general functions of numpy and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from gss.domain.rotation import rotation_from_vector
from gss.pipeline.small import best_rotation, determinant, distances2, median, standard_deviation


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_median_agrees_with_numpy(count: int) -> None:
    """The median agrees for odd and even numbers of values in any order."""
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == pytest.approx(np.median(values), abs=1e-15)


@pytest.mark.parametrize("count", [1, 2, 40])
def test_standard_deviation_agrees_with_numpy(count: int) -> None:
    """The standard deviation agrees."""
    values = np.random.default_rng(count).normal(5.0, 2.0, count)
    assert standard_deviation(values) == pytest.approx(values.std(), rel=1e-12, abs=1e-15)


def test_determinant_agrees_with_numpy() -> None:
    """The determinant of a (3, 3) matrix agrees."""
    matrix = np.random.default_rng(1).normal(size=(3, 3))
    assert determinant(matrix) == pytest.approx(np.linalg.det(matrix), rel=1e-12)


@pytest.mark.parametrize("count", [2, 3, 20])
def test_best_rotation_agrees_with_scipy(count: int) -> None:
    """The best rotation of noisy weighted directions agrees with scipy's and is never a reflection."""
    rng = np.random.default_rng(count)
    icrs = rng.normal([0, 0, 8], 1, (count, 3))
    icrs /= np.linalg.norm(icrs, axis=1)[:, None]
    unit = Rotation.random(random_state=3).apply(icrs) + rng.normal(0, 1e-4, (count, 3))
    weight = rng.uniform(1, 9, count)
    rotation = best_rotation(unit, icrs, weight)
    assert np.linalg.det(rotation) == pytest.approx(1)
    assert rotation == pytest.approx(Rotation.align_vectors(unit, icrs, weight)[0].as_matrix(), abs=1e-9)


def test_distances_agree_with_scipy() -> None:
    """The squared distances of all pairs of points agree."""
    rng = np.random.default_rng(2)
    first, second = rng.uniform(0, 999, (5, 2)), rng.uniform(0, 999, (9, 2))
    assert distances2(first, second) == pytest.approx(cdist(first, second, "sqeuclidean"))


@pytest.mark.parametrize("length_rad", [0.0, 1e-12, 1e-6, 0.3, 3.1, 3.2, 6.5])
def test_rotation_vectors_agree_with_scipy(length_rad: float) -> None:
    """Rotation vectors agree from no rotation to more than a full rotation."""
    vector = length_rad * np.array([0.6, -0.64, 0.48])
    assert rotation_from_vector(vector) == pytest.approx(Rotation.from_rotvec(vector).as_matrix(), abs=1e-15)
