"""The compiled loops against the numpy ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.instruments.registry import shipped_camera
from gss.pipeline import kernels
from gss.pipeline.chains import cubestar
from gss.pipeline.detect import Detections, find_stars
from gss.pipeline.peaks import _binomial_sum
from gss.pipeline.regions import find_blobs
from gss.pipeline.render import render

TOLERANCE_PX = 1e-6


def frame(seed: int, kind: str = "uint8", shape: tuple[int, int] = (200, 300)) -> NDArray[Any]:
    """Noise on a slope, stars of all brightnesses (some at the edges), hot pixels, a bright column."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    light = 12 + 0.05 * x + rng.normal(0, 2, shape)
    for col, row, flux in zip(
        rng.uniform(0, shape[1], 25), rng.uniform(0, shape[0], 25), 10 ** rng.uniform(2, 3.8, 25), strict=True
    ):
        light += flux / 7.5 * np.exp(-((x - col) ** 2 + (y - row) ** 2) / 2.4)
    light[rng.integers(0, shape[0], 40), rng.integers(0, shape[1], 40)] += 90
    light[:, 77] += 9
    return np.asarray(np.clip(np.rint(light), 0, 255).astype(kind))


@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("width_px", [1.1, None])
def test_both_ways_find_the_same_stars(kind: str, width_px: float | None) -> None:
    """The same stars in the same order, positions to a millionth of a pixel, the same regions with the same reasons."""
    for seed in range(6):
        image = frame(seed, kind)
        plain, quick = (find_stars(image, psf_sigma_px=width_px, saturation_dn=255.0, fast=f) for f in (False, True))
        assert (plain.loops, quick.loops) == ("numpy", "numba")
        assert len(plain.centroids) == len(quick.centroids) > 5
        assert np.abs(plain.centroids.pixels - quick.centroids.pixels).max() < TOLERANCE_PX
        assert np.allclose(plain.centroids.flux_dn, quick.centroids.flux_dn, rtol=TOLERANCE_PX)
        assert np.allclose(plain.centroids.sigma_px, quick.centroids.sigma_px, rtol=TOLERANCE_PX)
        assert [r.rejected for r in plain.regions] == [r.rejected for r in quick.regions]


@pytest.mark.parametrize("shape", [(8, 8), (9, 300), (130, 77), (129, 8), (512, 33)])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_filter_is_the_same_to_the_bit(shape: tuple[int, int], kind: str) -> None:
    """The compiled filter gives the same numbers as the strips of numpy, at any size and type."""
    loops = kernels.kernels(True)
    assert loops.binomial is not None
    image = np.random.default_rng(3).integers(0, 256, shape).astype(kind)
    assert np.array_equal(loops.binomial(image), _binomial_sum(image))


@pytest.mark.parametrize("threshold", [-1.0, 0.0, 14.5, 30.0, 254.5, 255.0, 300.0])
@pytest.mark.parametrize("kind", ["uint8", "uint16", "float32"])
def test_components_are_the_same_to_the_bit(threshold: float, kind: str) -> None:
    """Blobs, their order and their pixels are equal at every threshold, from all pixels lit to none."""
    image = frame(9, kind, (60, 90))
    plain, quick = (find_blobs(image, threshold, 3, kernels.kernels(f)) for f in (False, True))
    assert np.array_equal(plain.index, quick.index)
    assert np.array_equal(plain.start, quick.start)


def test_cubestar_answers_the_same_to_the_bit() -> None:
    """Regions, centroids and notes of CubeStar's detection do not depend on who ran the loops."""
    known = shipped_camera("cubestar")
    rng = np.random.default_rng(4)
    stars = load_stars(6.0)
    for _ in range(4):
        pose = matrix_from_quaternion(random_quaternion(rng))
        pixels = render(stars, known.camera, known.sensor, pose, known.sensor.exposure_s, rng).pixels
        parameters = cubestar.default_parameters(known)
        plain, quick = (cubestar.find_centroids(pixels, parameters, fast=f) for f in (False, True))
        assert plain.regions == quick.regions
        assert plain.notes == quick.notes
        for name in ("col_px", "row_px", "flux_dn", "peak_dn", "area_px", "sigma_px"):
            assert getattr(plain.centroids, name).tobytes() == getattr(quick.centroids, name).tobytes()


def test_numpy_can_always_be_selected() -> None:
    """``fast=False`` runs numpy wherever it is installed, and the result states it."""
    found: Detections = find_stars(frame(1), psf_sigma_px=1.1, fast=False)
    assert found.loops == "numpy"


def test_stars_are_not_made_of_noise_at_the_edge() -> None:
    """Frames without stars give no detections in the outermost rows and columns, where the filter repeats pixels."""
    rng = np.random.default_rng(6)
    found = [find_stars(rng.normal(40, 3, (256, 512)), psf_sigma_px=1.0, fast=False).centroids for _ in range(12)]
    assert sum(len(c) for c in found) == 0
