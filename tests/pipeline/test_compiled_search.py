"""The compiled anchor search gives the same results as the numpy one, and the success rate has a lower limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.camera import Brown, Camera, Pinhole
from gss.domain.results import Centroids
from gss.pipeline.chains.reference import KnownSky, known_sky, solve_centroids
from gss.pipeline.identify import anchor_search
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.identify.pyramid import PyramidMatch, identify_lost
from gss.pipeline.identify.verify import SkyCatalogue, field_of
from gss.pipeline.loops import search

TABLE = propagate(load_stars(), 2025.0)
CAMERAS = {
    "cubestar": (Camera.from_optics(1024, 512, 5.6e-3, 5.6e-3, 6.28, Pinhole()), 3.8),
    "sunsat": (Camera.from_optics(752, 582, 6.5e-3, 6.25e-3, 25.0, Pinhole()), 6.0),
}


@pytest.fixture(scope="module")
def skies() -> dict[str, KnownSky]:
    """Return the prepared sky of each camera."""
    sky = SkyCatalogue(TABLE.hip, TABLE.icrs, TABLE.v_mag)
    return {name: known_sky(sky, camera, limit) for name, (camera, limit) in CAMERAS.items()}


def random_list(name: str, sky: SkyCatalogue, false_count: int, seed: int) -> tuple[Centroids, np.ndarray, int]:
    """Return centroids at a random attitude with noise of 0.2 px and 0.15 mag and with false stars, the attitude, and
    the number of stars.
    """
    camera, limit = CAMERAS[name]
    rng = np.random.default_rng(seed)
    attitude = Rotation.random(rng=rng).as_matrix()
    unit = sky.icrs @ attitude.T
    in_front = np.flatnonzero(unit[:, 2] > 0.2)
    pixels = camera.project(unit[in_front])
    inside = camera.contains(pixels)
    size = np.array([camera.columns, camera.rows])
    positions = np.concatenate(
        [pixels[inside] + rng.normal(0, 0.2, (inside.sum(), 2)), rng.uniform(0, size, (false_count, 2))]
    )
    mags = [sky.v_mag[in_front[inside]] + rng.normal(0, 0.15, inside.sum()), rng.uniform(limit - 3, limit, false_count)]
    order = np.argsort(np.concatenate(mags))
    flux = 10 ** (-0.4 * np.concatenate(mags)[order])
    return Centroids.from_pixels(positions[order], flux, 0.2), attitude, int(inside.sum())


def summary(match: PyramidMatch) -> tuple[object, ...]:
    """Return the properties of a match that both searches must have in common."""
    evidence = match.evidence
    if evidence is None:
        return match.hypotheses, match.reason
    return match.hypotheses, evidence.rows.tolist(), evidence.stars.tolist(), evidence.false_match_probability


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("false_count", [0, 10, 30])
def test_both_searches_give_the_same_matches(name: str, false_count: int, skies: dict[str, KnownSky]) -> None:
    """Both searches give the same stars, probability, number of hypotheses and reason for every list."""
    camera, _ = CAMERAS[name]
    prepared_sky = skies[name]
    for seed in range(12):
        view = field_of(random_list(name, prepared_sky.sky, false_count, seed)[0], camera)
        with_numpy, compiled = (
            identify_lost(
                view,
                prepared_sky.sky,
                prepared_sky.pairs,
                camera,
                support=2 + seed % 2,
                only_first=seed % 4 == 3,
                fast=fast,
            )
            for fast in (False, True)
        )
        assert summary(with_numpy)[:3] == summary(compiled)[:3]
        assert summary(compiled)[3:] == pytest.approx(summary(with_numpy)[3:], rel=1e-8)


@pytest.mark.parametrize("most", [3, 64])
@pytest.mark.parametrize("pairs_at_once", [20_000, 200_000])
def test_both_searches_have_the_same_candidates(
    most: int, pairs_at_once: int, skies: dict[str, KnownSky], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each anchor has the same candidates in the same order, also if there are too many, and whatever number of pairs is
    compared at once.
    """
    monkeypatch.setattr(anchor_search, "MAX_CANDIDATES", most)
    monkeypatch.setattr(anchor_search, "PAIRS_AT_ONCE", pairs_at_once)
    sky, table = skies["sunsat"].sky, skies["sunsat"].pairs
    camera, _ = CAMERAS["sunsat"]
    view = field_of(random_list("sunsat", sky, 40, 9)[0], camera)
    n, need = len(view), 2
    expected = anchor_search.AnchorSearch(view, sky, table, n, 0.001, need, 10**9)
    pairs = search._no_pairs(n)
    arrays = table.first, table.second, table.distance_rad
    search._compute_pairs(0, n, (view.unit, view.sigma_rad, anchor_search.TOLERANCE_SIGMA, 0.001), arrays[2], pairs)
    end, anchor = np.empty(len(sky), np.uint32), np.empty(len(sky), np.uint32)
    entry, out = np.empty(0, np.uint32), np.empty((most, 6), np.int64)
    largest, collinear = anchor_search.MAX_OF_A_PAIR, anchor_search.COLLINEAR
    counts = []
    for i in range(n - need - 1):
        stars, longest, entry = search._entries(i, n, pairs, arrays, largest, need, end, anchor, entry)
        count = search._candidates(
            i, view.unit, sky.icrs, pairs, anchor[:stars], end, longest, entry, collinear, need, out
        )
        assert [tuple(row[:5]) for row in out[:count].tolist()] == expected._candidates(i, expected._entries(i, n))
        counts.append(count)
    assert max(counts) == most
    assert min(counts) == 0


@pytest.mark.parametrize(
    ("detections", "expected"),
    [
        (4, [(0, 4)]),
        (6, [(0, 6)]),
        (14, [(0, 6), (6, 12), (12, 14), (0, 14)]),
        (24, [(0, 6), (6, 12), (12, 18), (18, 24), (0, 12), (12, 24), (0, 24)]),
    ],
)
def test_groups_end_with_all_detections(detections: int, expected: list[tuple[int, int]]) -> None:
    """Groups of each size contain all detections. With ``only_first``, only the first group of each size is searched."""
    assert list(anchor_search.groups(detections, False)) == expected
    assert list(anchor_search.groups(detections, True)) == [group for group in expected if group[0] == 0]


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("velocity_c", [None, np.array([8e-5, -3e-5, 2e-5])])
@pytest.mark.parametrize("is_near", [False, True])
def test_compiled_loops_solve_a_list_like_numpy(
    name: str, velocity_c: np.ndarray | None, is_near: bool, skies: dict[str, KnownSky]
) -> None:
    """Both give the same stars, attitude and covariance, lost in space or near a known attitude, with and without
    aberration.
    """
    camera, _ = CAMERAS[name]
    prepared_sky = skies[name]
    for seed in range(8):
        centroids, attitude, _ = random_list(name, prepared_sky.deep, 10, 40 + seed)
        hint = BoundedPrior(attitude, 0.01) if is_near else None
        with_numpy, compiled = (
            solve_centroids(centroids, camera, prepared_sky, hint=hint, velocity_c=velocity_c, fast=fast)
            for fast in (False, True)
        )
        assert (with_numpy.outcome, with_numpy.reason) == (compiled.outcome, compiled.reason)
        if with_numpy.attitude is not None and compiled.attitude is not None:
            assert with_numpy.matches.hip.tolist() == compiled.matches.hip.tolist()
            covariance = with_numpy.attitude.covariance_rad2
            np.testing.assert_allclose(compiled.attitude.quaternion, with_numpy.attitude.quaternion, rtol=0, atol=1e-8)
            np.testing.assert_allclose(
                compiled.attitude.covariance_rad2, covariance, rtol=1e-3, atol=1e-3 * covariance[1, 1]
            )


@pytest.mark.parametrize(("budget", "of_a_pair"), [(20_000, 50_000), (1_000_000, 900)])
def test_both_searches_have_the_same_budget(
    budget: int, of_a_pair: int, skies: dict[str, KnownSky], monkeypatch: pytest.MonkeyPatch
) -> None:
    """For random dots, both searches stop after the same number of hypotheses with the same reason."""
    monkeypatch.setattr(anchor_search, "MAX_OF_A_PAIR", of_a_pair)
    camera, _ = CAMERAS["sunsat"]
    prepared_sky = skies["sunsat"]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        view = field_of(Centroids.from_pixels(rng.uniform(0, 580, (40, 2)), 10 ** rng.uniform(0, 2, 40)), camera)
        with_numpy, compiled = (
            identify_lost(view, prepared_sky.sky, prepared_sky.pairs, camera, accept=1e-30, budget=budget, fast=fast)
            for fast in (False, True)
        )
        assert summary(with_numpy) == summary(compiled)
        assert (with_numpy.hypotheses > budget) == (budget == 20_000)


@pytest.mark.parametrize("fast", [False, True])
def test_lists_of_many_detections(fast: bool, skies: dict[str, KnownSky]) -> None:
    """The correct attitude is found if most of the detections are false."""
    camera, _ = CAMERAS["sunsat"]
    prepared_sky = skies["sunsat"]
    for false_count in (30, 60):
        centroids, attitude, stars = random_list("sunsat", prepared_sky.sky, false_count, 3)
        assert stars > 10
        match = identify_lost(field_of(centroids, camera), prepared_sky.sky, prepared_sky.pairs, camera, fast=fast)
        assert match.evidence is not None
        assert match.evidence.cam_from_icrs[2] @ attitude[2] > np.cos(5 * camera.pixel_rad)


FLOORS = {("cubestar", 0): 59, ("cubestar", 10): 59, ("sunsat", 0): 58, ("sunsat", 10): 57}


@pytest.mark.parametrize(("name", "false_count"), FLOORS)
def test_success_rate_does_not_decrease(name: str, false_count: int, skies: dict[str, KnownSky]) -> None:
    """Of 60 fixed lists, at least as many are solved as when this test was written, and none wrongly."""
    camera, _ = CAMERAS[name]
    solved = 0
    for seed in range(1000, 1060):
        centroids, attitude, _ = random_list(name, skies[name].sky, false_count, seed)
        result = solve_centroids(centroids, camera, skies[name])
        if result.attitude is None:
            continue
        assert result.attitude.cam_from_icrs[2] @ attitude[2] > np.cos(5 * camera.pixel_rad)
        solved += 1
    assert solved >= FLOORS[name, false_count]


@pytest.mark.parametrize("k1", [-0.3, -1.0])
def test_positions_outside_the_domain_of_the_lens_are_dropped(k1: float) -> None:
    """Both implementations drop the same positions, also those of which only a neighbour half a pixel away can be
    converted, and their errors and magnitudes are equal. A flux that is not a number is the smallest.
    """
    camera = Camera(1024, 1024, 500.0, 500.0, 511.5, 511.5, Brown(k1=k1))
    pixels = np.random.default_rng(2).uniform(0, 1023, (20_000, 2))
    flux = np.where(np.arange(len(pixels)) % 50 == 0, np.nan, 10.0)
    with_numpy, compiled = (field_of(Centroids.from_pixels(pixels, flux), camera, fast=fast) for fast in (False, True))
    assert 0 < len(with_numpy) < len(pixels)
    assert np.array_equal(with_numpy.centroid, compiled.centroid)
    np.testing.assert_allclose(compiled.unit, with_numpy.unit, rtol=0, atol=1e-14)
    np.testing.assert_allclose(compiled.sigma_rad, with_numpy.sigma_rad, rtol=1e-9)
    np.testing.assert_allclose(compiled.magnitude, with_numpy.magnitude, rtol=1e-14)
