"""The compiled search of pairs against the one in numpy, and floors of the success rate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.camera import Camera, Pinhole
from gss.domain.results import Centroids
from gss.pipeline.chains.reference import KnownSky, known_sky, solve_centroids
from gss.pipeline.identify import pair_search
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.identify.pyramid import PyramidMatch, identify_lost
from gss.pipeline.identify.verify import SkyCatalogue, field_of

TABLE = propagate(load_stars(), 2025.0)
CAMERAS = {
    "cubestar": (Camera.from_optics(1024, 512, 5.6e-3, 5.6e-3, 6.28, Pinhole()), 3.8),
    "sunsat": (Camera.from_optics(752, 582, 6.5e-3, 6.25e-3, 25.0, Pinhole()), 6.0),
}


@pytest.fixture(scope="module")
def skies() -> dict[str, KnownSky]:
    sky = SkyCatalogue(TABLE.hip, TABLE.icrs, TABLE.v_mag)
    return {name: known_sky(sky, camera, limit) for name, (camera, limit) in CAMERAS.items()}


def drawn(name: str, sky: SkyCatalogue, false: int, seed: int) -> tuple[Centroids, np.ndarray, int]:
    """A list of a random attitude with 0.2 px and 0.15 mag noise and false stars, its attitude and its number of stars."""
    camera, limit = CAMERAS[name]
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng).as_matrix()
    unit = sky.icrs @ turn.T
    front = np.flatnonzero(unit[:, 2] > 0.2)
    pixels = camera.project(unit[front])
    on = camera.contains(pixels)
    size = np.array([camera.columns, camera.rows])
    places = np.concatenate([pixels[on] + rng.normal(0, 0.2, (on.sum(), 2)), rng.uniform(0, size, (false, 2))])
    mags = [sky.v_mag[front[on]] + rng.normal(0, 0.15, on.sum()), rng.uniform(limit - 3, limit, false)]
    order = np.argsort(np.concatenate(mags))
    flux = 10 ** (-0.4 * np.concatenate(mags)[order])
    return Centroids.from_pixels(places[order], flux, 0.2), turn, int(on.sum())


def facts(match: PyramidMatch) -> tuple[object, ...]:
    found = match.evidence
    if found is None:
        return match.hypotheses, match.reason
    return match.hypotheses, found.rows.tolist(), found.stars.tolist(), found.false_match_probability


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("false", [0, 10, 30])
def test_both_searches_give_the_same_answers(name: str, false: int, skies: dict[str, KnownSky]) -> None:
    """The same stars, probability, number of hypotheses and reason, list by list."""
    camera, _ = CAMERAS[name]
    known = skies[name]
    for seed in range(12):
        view = field_of(drawn(name, known.sky, false, seed)[0], camera)
        plain, quick = (identify_lost(view, known.sky, known.pairs, camera, fast=fast) for fast in (False, True))
        assert facts(plain)[:3] == facts(quick)[:3]
        assert facts(quick)[3:] == pytest.approx(facts(plain)[3:], rel=1e-8)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("velocity_c", [None, np.array([8e-5, -3e-5, 2e-5])])
@pytest.mark.parametrize("is_near", [False, True])
def test_compiled_loops_solve_a_list_like_numpy(
    name: str, velocity_c: np.ndarray | None, is_near: bool, skies: dict[str, KnownSky]
) -> None:
    """The same names, attitude and covariance, from the whole sky or near a known attitude, with and without aberration."""
    camera, _ = CAMERAS[name]
    known = skies[name]
    for seed in range(8):
        centroids, turn, _ = drawn(name, known.deep, 10, 40 + seed)
        hint = BoundedPrior(turn, 0.01) if is_near else None
        plain, quick = (
            solve_centroids(centroids, camera, known, hint=hint, velocity_c=velocity_c, fast=fast)
            for fast in (False, True)
        )
        assert (plain.outcome, plain.reason) == (quick.outcome, quick.reason)
        if plain.attitude is not None and quick.attitude is not None:
            assert plain.matches.hip.tolist() == quick.matches.hip.tolist()
            covariance = plain.attitude.covariance_rad2
            np.testing.assert_allclose(quick.attitude.quaternion, plain.attitude.quaternion, rtol=0, atol=1e-8)
            np.testing.assert_allclose(
                quick.attitude.covariance_rad2, covariance, rtol=1e-3, atol=1e-3 * covariance[1, 1]
            )


@pytest.mark.parametrize("limits", [{"MAX_JOINED_ROWS": 20_000}, {"ROWS_AT_ONCE": 900}, {"FIRST_POOL_ROWS": 8}])
def test_both_searches_have_the_same_budget(
    limits: dict[str, int], skies: dict[str, KnownSky], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dots without a sky end after the same number of hypotheses with the same reason; the store of pairs grows as needed."""
    for name, value in limits.items():
        monkeypatch.setattr(pair_search, name, value)
    camera, _ = CAMERAS["sunsat"]
    known = skies["sunsat"]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        view = field_of(Centroids.from_pixels(rng.uniform(0, 580, (40, 2)), 10 ** rng.uniform(0, 2, 40)), camera)
        plain, quick = (
            identify_lost(view, known.sky, known.pairs, camera, accept=1e-30, fast=fast) for fast in (False, True)
        )
        assert facts(plain) == facts(quick)


FLOORS = {("cubestar", 0): 59, ("cubestar", 10): 59, ("sunsat", 0): 58, ("sunsat", 10): 57}


@pytest.mark.parametrize(("name", "false"), FLOORS)
def test_success_does_not_fall(name: str, false: int, skies: dict[str, KnownSky]) -> None:
    """Of 60 fixed lists at least as many are solved as when this test was written, and none wrongly."""
    camera, _ = CAMERAS[name]
    right = 0
    for seed in range(1000, 1060):
        centroids, turn, _ = drawn(name, skies[name].sky, false, seed)
        result = solve_centroids(centroids, camera, skies[name])
        if result.attitude is None:
            continue
        assert result.attitude.cam_from_icrs[2] @ turn[2] > np.cos(5 * camera.pixel_rad)
        right += 1
    assert right >= FLOORS[name, false]
