"""The compiled loops give the same results as the numpy loops."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import lengths
from gss.domain.camera import Brown, Camera
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.pipeline import kernels
from gss.pipeline.chains import cubestar
from gss.pipeline.detect import Detections, find_stars
from gss.pipeline.identify import verify
from gss.pipeline.identify.neighbour_pattern import (
    PatternSpots,
    pair_attitudes,
    pair_hypotheses,
    pattern_stars,
    supporters,
)
from gss.pipeline.loops import geometry
from gss.pipeline.loops.pixels import _lit
from gss.pipeline.loops.small import ascending, middle_of
from gss.pipeline.peaks import _binomial_sum
from gss.pipeline.regions import find_blobs
from gss.pipeline.render import render
from gss.pipeline.track.predictional import predictional_fit
from gss.skytables.neighbours import link_distances, neighbour_links

TOLERANCE_PX = 1e-6


def frame(seed: int, dtype: str = "uint8", shape: tuple[int, int] = (200, 300)) -> NDArray[Any]:
    """Return a frame with noise on a slope, stars of all brightnesses (some at the edges), hot pixels and a bright
    column.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    light = 12 + 0.05 * x + rng.normal(0, 2, shape)
    for col, row, flux in zip(
        rng.uniform(0, shape[1], 25), rng.uniform(0, shape[0], 25), 10 ** rng.uniform(2, 3.8, 25), strict=True
    ):
        light += flux / 7.5 * np.exp(-((x - col) ** 2 + (y - row) ** 2) / 2.4)
    light[rng.integers(0, shape[0], 40), rng.integers(0, shape[1], 40)] += 90
    light[:, 77] += 9
    return np.asarray(np.clip(np.rint(light), 0, 255).astype(dtype))


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32", ">u2", "int16"])
@pytest.mark.parametrize("width_px", [1.1, 1.9, None])
def test_numpy_and_compiled_loops_find_the_same_stars(dtype: str, width_px: float | None) -> None:
    """Both loops find the same stars in the same order, with positions equal to a millionth of a pixel, and reject the
    same regions for the same reasons. Frames of whole and of partial tiles, and frames that cannot be written.
    """
    for seed in range(6):
        image = frame(seed, dtype, ((200, 300), (192, 320))[seed % 2])
        image.flags.writeable = seed > 2
        with_numpy, compiled = (
            find_stars(image, psf_sigma_px=width_px, saturation_dn=255.0, e_per_dn=2.0 * (seed % 3), fast=f)
            for f in (False, True)
        )
        assert (with_numpy.loops, compiled.loops) == ("numpy", "numba")
        assert len(with_numpy.centroids) == len(compiled.centroids) > 5
        assert np.abs(with_numpy.centroids.pixels - compiled.centroids.pixels).max() < TOLERANCE_PX
        for name in ("flux_dn", "sigma_px", "peak_dn", "area_px"):
            assert np.allclose(
                getattr(with_numpy.centroids, name), getattr(compiled.centroids, name), rtol=TOLERANCE_PX
            )
        assert [r.rejected for r in with_numpy.regions] == [r.rejected for r in compiled.regions]
        assert (with_numpy.trailed, with_numpy.notes) == (compiled.trailed, compiled.notes)


@pytest.mark.parametrize("shape", [(8, 8), (9, 300), (130, 77), (129, 8), (512, 33)])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_the_compiled_filter_is_bit_identical(shape: tuple[int, int], dtype: str) -> None:
    """The compiled filter gives the same numbers as numpy, for any size and type."""
    loops = kernels.kernels(True)
    assert loops.frames is not None
    image = np.random.default_rng(3).integers(0, 256, shape).astype(dtype)
    assert np.array_equal(loops.frames.binomial(image), _binomial_sum(image))


@pytest.mark.parametrize("threshold", [-1.0, 0.0, 14.5, 30.0, 254.5, 255.0, 300.0])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_compiled_blobs_are_bit_identical(threshold: float, dtype: str) -> None:
    """Blobs, their order and their pixels are equal at every threshold, from all pixels above it to none."""
    image = frame(9, dtype, (60, 90))
    with_numpy, compiled = (find_blobs(image, threshold, 3, kernels.kernels(f)) for f in (False, True))
    assert np.array_equal(with_numpy.index, compiled.index)
    assert np.array_equal(with_numpy.start, compiled.start)


def test_a_read_only_frame_needs_no_other_loops() -> None:
    """Frames of a sensor are read-only, rendered ones are not. Both are searched with the same compiled loop."""
    pixels = frame(3)
    find_blobs(pixels, 30.0, 1, kernels.kernels(fast=True))
    before = list(_lit.signatures)
    read_only = np.frombuffer(pixels.tobytes(), np.uint8).reshape(pixels.shape)
    find_blobs(read_only, 30.0, 1, kernels.kernels(fast=True))
    assert list(_lit.signatures) == before


def test_cubestar_detection_is_bit_identical() -> None:
    """Regions, centroids and notes of CubeStar's detection are the same with both loops."""
    profile = shipped_camera("cubestar")
    rng = np.random.default_rng(4)
    stars = load_stars(6.0)
    for _ in range(4):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        pixels = render(stars, profile.camera, profile.sensor, attitude, profile.sensor.exposure_s, rng).pixels
        parameters = cubestar.default_parameters(profile)
        with_numpy, compiled = (cubestar.find_centroids(pixels, parameters, fast=f) for f in (False, True))
        assert with_numpy.regions == compiled.regions
        assert with_numpy.notes == compiled.notes
        for name in ("col_px", "row_px", "flux_dn", "peak_dn", "area_px", "sigma_px"):
            assert getattr(with_numpy.centroids, name).tobytes() == getattr(compiled.centroids, name).tobytes()


def test_numpy_can_always_be_selected() -> None:
    """With ``fast=False``, numpy is used even if numba is installed, and the result states it."""
    detections: Detections = find_stars(frame(1), psf_sigma_px=1.1, fast=False)
    assert detections.loops == "numpy"


def test_noise_at_the_edge_gives_no_stars() -> None:
    """Frames without stars give no detections, also not in the outermost rows and columns, where the filter repeats
    pixels.
    """
    rng = np.random.default_rng(6)
    detected = [find_stars(rng.normal(40, 3, (256, 512)), psf_sigma_px=1.0, fast=False).centroids for _ in range(12)]
    assert sum(len(c) for c in detected) == 0


def test_both_predictional_fits_pair_the_same_stars() -> None:
    """Both loops correct an attitude that is off by half of the first radius to the same attitude, with the same pairs, or
    both fail. The lists have close pairs, false stars and missing stars; some have fewer than two pairs."""
    rng, fitted = np.random.default_rng(8), 0
    for case in range(60):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        sky = rng.normal([0.0, 0.0, 12.0], 1.0, (3 * case // 2, 3))
        sky /= lengths(sky)[:, None]
        measured = np.concatenate([sky[::2], sky[:5] + 2e-4, rng.normal([0.0, 0.0, 12.0], 1.0, (case // 6, 3))])
        measured = measured + 5e-5 * rng.normal(size=measured.shape)
        measured /= lengths(measured)[:, None]
        rows, icrs = np.flatnonzero(rng.random(len(sky)) < 0.9), sky @ attitude
        start = rotation_from_vector(1e-3 * rng.normal(size=3) / 2) @ attitude
        plain, compiled = (
            predictional_fit(measured, icrs, rows, start, (2e-3, 1e-3, 5e-4), 0.2, fast=fast) for fast in (False, True)
        )
        assert (plain is None) == (compiled is None)
        if plain is None or compiled is None:
            continue
        fitted += 1
        assert (plain.measured.tolist(), plain.row.tolist()) == (compiled.measured.tolist(), compiled.row.tolist())
        assert plain.compared == compiled.compared
        assert np.abs(plain.cam_from_icrs - compiled.cam_from_icrs).max() < 1e-12
    assert 40 < fitted < 60
    one_place = np.tile([0.0, 0.0, 1.0], (3, 1))
    assert [
        predictional_fit(one_place, one_place, np.arange(3), np.eye(3), (1e-3,), 0.2, fast=f) for f in (False, True)
    ] == [
        None,
        None,
    ]


def test_both_loops_count_the_same_supporters() -> None:
    """Both loops count the same spots at the attitudes of all hypotheses. Spots have other magnitudes than their stars, are
    saturated or are false; stars have unknown magnitudes, companions, or lie at the edge of the field."""
    rng, most = np.random.default_rng(5), 0
    table = load_stars(7.5)
    v_mag = np.where(rng.random(len(table)) < 0.01, np.nan, table.v_mag)
    stars, links = pattern_stars(table.icrs.copy(), v_mag), link_distances(neighbour_links(table.icrs), table.icrs)
    for _ in range(8):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        near = np.flatnonzero(table.icrs @ attitude[2] > np.cos(np.radians(3.0)))
        unit = np.concatenate([table.icrs[near] @ attitude.T, rng.normal([0.0, 0.0, 40.0], 1.0, (5, 3))])
        unit = unit + 1e-4 * rng.normal(size=unit.shape)
        unit /= lengths(unit)[:, None]
        unit[1] = unit[0]  # a centroid twice
        mag = np.concatenate([table.v_mag[near], rng.uniform(4, 7, 5)]) + 0.3 * rng.normal(size=len(unit))
        spots = PatternSpots(np.arange(len(unit)), unit, mag, rng.random(len(unit)) < 0.2)
        pairs = pair_hypotheses(spots, links, v_mag, np.ones(len(table), bool), 4e-4, 0.6, 2000)
        attitudes = pair_attitudes(unit, table.icrs, pairs)
        plain, compiled = (supporters(spots, pairs, attitudes, stars, 4e-4, 0.6, fast=f) for f in (False, True))
        assert plain.tolist() == compiled.tolist()
        most = max(most, int(plain.max()))
    assert most > 10


def test_the_compiled_order_and_median_agree_with_numpy() -> None:
    """Values that are even, crowded at one end, equal, few or none are put in numpy's order. Values that are not numbers keep the
    order complete.
    """
    rng = np.random.default_rng(5)
    for values in (
        rng.uniform(-4, 1027, 900),
        rng.exponential(1, 900) ** 3,
        np.full(7, 2.5),
        np.array([3.0]),
        np.empty(0),
    ):
        assert values[ascending(values)].tolist() == np.sort(values).tolist()
        assert np.array_equal(
            middle_of(values, len(values)), np.median(values) if len(values) else np.nan, equal_nan=True
        )
    values = np.where(rng.random(50) < 0.3, np.nan, rng.random(50))
    assert np.sort(ascending(values)).tolist() == list(range(50))


def test_both_loops_measure_the_same_directions() -> None:
    """Positions outside the domain of the lens model are left out, in any memory layout and with fluxes that are not
    positive numbers.
    """
    camera = Camera(640, 480, 500.0, 510.0, 320.0, 240.0, Brown(k1=-0.5, k2=0.1))
    rng = np.random.default_rng(8)
    place_px = rng.uniform(-900, 1500, (200, 2))
    flux_dn = rng.normal(50, 60, 200)
    flux_dn[::17] = np.nan
    centroids = Centroids.from_pixels(place_px, flux_dn, sigma_px=0.01)
    plain, compiled = (verify.field_of(centroids, camera, fast=fast) for fast in (False, True))
    assert 20 < len(plain) < 180
    assert plain.centroid.tolist() == compiled.centroid.tolist()
    assert plain.pixels.tolist() == compiled.pixels.tolist()
    for one, other in zip(plain.arrays, compiled.arrays, strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12)


def test_a_read_only_list_needs_no_other_loops() -> None:
    """Stored lists are read-only, and columns of a table are not contiguous. Both are measured by the loop that is compiled
    in advance.
    """
    camera = Camera(640, 480, 500.0, 510.0, 320.0, 240.0)
    centroids = Centroids.from_pixels(np.random.default_rng(4).uniform(0, 400, (30, 2)))
    measured = verify.field_of(centroids, camera, fast=True).unit
    versions = len(geometry._measured.signatures)
    contiguous = Centroids(*(np.array(getattr(centroids, column.name)) for column in fields(centroids)))
    for column in fields(contiguous):
        getattr(contiguous, column.name).flags.writeable = False
    assert np.array_equal(verify.field_of(contiguous, camera, fast=True).unit, measured)
    assert len(geometry._measured.signatures) == versions
