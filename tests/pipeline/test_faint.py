"""Naming every star of a solved frame: few left out, none misnamed, and an attitude whose covariance is that of its errors."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import SolveResult
from gss.domain.rotation import rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.reference import KnownSky, known_sky, solve_known
from gss.pipeline.identify.faint import Rows, Spots, match_all
from gss.pipeline.identify.flux_line import flux_line
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.refine import Refined, refine
from gss.pipeline.render import FalseStar, Rendered, render

TABLE = propagate(load_stars(), 2025.0)
SKY = SkyCatalogue(TABLE.hip, TABLE.icrs, TABLE.v_mag)


@functools.cache
def stars_of(name: str, fainter_mag: float = 0.0) -> KnownSky:
    p = shipped_camera(name)
    return known_sky(SKY, p.camera, p.sensor.faint_limit_mag + fainter_mag)


def shot(name: str, r: Array, rng: np.random.Generator, false_stars: int = 0) -> Rendered:
    """Return the whole table to V 8 on the detector, and false stars."""
    p = shipped_camera(name)
    spots = [
        FalseStar(rng.uniform(0, p.camera.columns), rng.uniform(0, p.camera.rows), rng.uniform(2.5, 6))
        for _ in range(false_stars)
    ]
    return render(TABLE, p.camera, p.sensor, r, p.sensor.exposure_s, rng, false_stars=spots)


def solve(name: str, frame: Rendered) -> SolveResult:
    p = shipped_camera(name)
    return solve_known(frame.pixels, p.camera, p.sensor, stars_of(name), deeper=lambda: stars_of(name, 1.0))


def misnamed(result: SolveResult, camera: Camera, r: Array) -> int:
    """Return the number of matches whose star is over 3 px from its centroid, or within 2.5 px of it beside a brighter
    star.
    """
    assert result.matches is not None
    near = SKY.icrs @ r[2] > np.cos(camera.half_diagonal_rad + 0.02)
    hip, v_mag, place = SKY.hip[near], SKY.v_mag[near], camera.project(SKY.icrs[near] @ r.T)
    row = {int(h): k for k, h in enumerate(hip)}
    wrong = 0
    for k, h in zip(result.matches.centroid, result.matches.hip, strict=True):
        away = np.linalg.norm(place - result.centroids.pixels[k], axis=1)
        mine = row[int(h)]
        wrong += bool(away[mine] > 3 or v_mag[away < 2.5].min(initial=99) < v_mag[mine])
    return wrong


@pytest.mark.parametrize(("name", "share"), [("cubestar", 0.92), ("sunsat", 0.95)])
def test_nearly_all_detections_get_their_right_name(name: str, share: float) -> None:
    """Of all centroids in 40 frames more than nine in ten are named, no star wrongly; the error is of its covariance's size."""
    rng = np.random.default_rng(41)
    named = seen = wrong = 0
    quadratic = []
    for _ in range(40):
        r = Rotation.random(rng=rng).as_matrix()
        result = solve(name, shot(name, r, rng))
        assert result.attitude is not None
        assert result.matches is not None
        assert (
            len(set(result.matches.centroid.tolist())) == len(set(result.matches.hip.tolist())) == len(result.matches)
        )
        named, seen = named + len(result.matches), seen + len(result.centroids)
        wrong += misnamed(result, shipped_camera(name).camera, r)
        error = Rotation.from_matrix(result.attitude.cam_from_icrs @ r.T).as_rotvec()
        quadratic.append(error @ np.linalg.solve(result.attitude.covariance_rad2, error))
    assert wrong == 0
    assert named > share * seen
    assert 1.6 < np.mean(quadratic) < 4.0
    assert max(quadratic) < 25


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_spots_that_are_not_stars_get_no_name(name: str) -> None:
    """Thirty false stars per frame are not identified and rarely prevent the identification of true ones."""
    rng = np.random.default_rng(42)
    named = 0
    for _ in range(12):
        r = Rotation.random(rng=rng).as_matrix()
        result = solve(name, shot(name, r, rng, false_stars=30))
        assert result.attitude is not None
        assert misnamed(result, shipped_camera(name).camera, r) == 0
        named += len(result.matches or ()) > 0.5 * (len(result.centroids) - 30)
    assert named == 12


def test_more_stars_make_a_better_attitude() -> None:
    """Naming the faint stars takes a fifth and more off the mean cross-boresight error of the proof's own stars."""
    rng = np.random.default_rng(43)
    p = shipped_camera("cubestar")
    few, many = [], []
    bright = stars_of("cubestar").sky
    for _ in range(40):
        r = Rotation.random(rng=rng).as_matrix()
        result = solve("cubestar", shot("cubestar", r, rng))
        assert result.attitude is not None
        assert result.matches is not None
        own = np.isin(result.matches.hip, bright.hip)
        row = {int(h): k for k, h in enumerate(bright.hip)}
        icrs = bright.icrs[[row[int(h)] for h in result.matches.hip[own]]]
        c = result.centroids.take(result.matches.centroid[own].astype(np.intp))
        fit = refine(c.pixels, icrs, np.maximum(c.sigma_px, 0.03), p.camera, result.attitude.cam_from_icrs)
        for errors, found in ((few, fit.cam_from_icrs), (many, result.attitude.cam_from_icrs)):
            errors.append(np.linalg.norm(found[2] - r[2]))
    assert np.mean(many) < 0.8 * np.mean(few)


CAMERA = Camera(1000, 1000, 2500.0, 2500.0, 499.5, 499.5)


def table(pixels: Array, v_mag: Array) -> SkyCatalogue:
    """Return stars exactly at those pixels for the identity attitude, brightest first."""
    order = np.argsort(v_mag, kind="stable")
    return SkyCatalogue(
        np.arange(1, len(v_mag) + 1, dtype=np.int32)[order], CAMERA.unproject(pixels)[order], v_mag[order]
    )


def name(pixels: Array, v_seen: Array, sky: SkyCatalogue, anchors: int) -> dict[int, int]:
    """Hipparcos number by spot; the first ``anchors`` spots, which are stars 1, 2 …, are proved."""
    spots = Spots(pixels, np.full(len(pixels), 0.1), v_seen - 20.0, 1.2)
    rows: Rows = np.arange(anchors, dtype=np.intp)
    of: Rows = np.array([int(np.flatnonzero(sky.hip == k + 1)[0]) for k in rows], np.intp)

    def fit_to(r: Rows, s: Rows, sigma_px: Array) -> Refined:
        return refine(pixels[r], sky.icrs[s], sigma_px, CAMERA, rotation_from_vector(np.zeros(3)))

    named = match_all(spots, sky, fit_to(rows, of, np.full(anchors, 0.1)), rows, of, fit_to)
    return {} if named is None else {int(r): int(sky.hip[s]) for r, s in zip(named.rows, named.stars, strict=True)}


def scene(extra_pixels: list[list[float]], extra_mag: list[float]) -> tuple[Array, Array]:
    """Eight proved stars of V 3 to 4.4 and some more."""
    ring = np.array([[500 + 350 * np.cos(a), 500 + 350 * np.sin(a)] for a in np.linspace(0, 5.5, 8)])
    pixels = np.vstack([ring, np.array(extra_pixels).reshape(-1, 2)])
    return pixels, np.concatenate([3 + 0.2 * np.arange(8), extra_mag])


def test_an_isolated_faint_star_is_identified() -> None:
    """A star where and as bright as the catalogue says gets its name."""
    pixels, v_mag = scene([[420.0, 530.0]], [6.0])
    assert name(pixels, v_mag, table(pixels, v_mag), 8)[8] == 9


def test_a_spot_with_wrong_brightness_or_position_is_not_identified() -> None:
    """A spot two magnitudes too bright, or 1.5 px away, is not identified with that star."""
    pixels, v_mag = scene([[420.0, 530.0]], [6.0])
    sky = table(pixels, v_mag)
    assert 8 not in name(pixels, v_mag + np.array([0.0] * 8 + [-2.0]), sky, 8)
    assert 8 not in name(pixels + np.array([[0.0, 0.0]] * 8 + [[1.5, 0.0]]), v_mag, sky, 8)


def test_blend_of_equals_gets_no_name() -> None:
    """One detection in the middle of two equal stars two pixels apart could be either, and is neither."""
    pixels, v_mag = scene([[420.0, 530.0], [422.0, 530.0]], [6.0, 6.0])
    seen = np.vstack([pixels[:8], [[421.0, 530.0]]])
    assert 8 not in name(seen, np.append(v_mag[:8], 5.3), table(pixels, v_mag), 8)


def test_faint_companion_does_not_matter() -> None:
    """A companion three magnitudes fainter leaves the star its name."""
    pixels, v_mag = scene([[420.0, 530.0], [422.0, 530.0]], [5.0, 8.0])
    assert name(pixels[:9], v_mag[:9], table(pixels, v_mag), 8)[8] == 9


def test_two_detections_of_one_star_get_no_name() -> None:
    """Where two detections fit one star, none takes its name."""
    pixels, v_mag = scene([[420.0, 530.0]], [6.0])
    seen = np.vstack([pixels, pixels[8:] + 0.2])
    found = name(seen, np.append(v_mag, 6.0), table(pixels, v_mag), 8)
    assert 8 not in found
    assert 9 not in found


def test_a_crowded_field_does_not_identify_random_dots() -> None:
    """Two hundred random dots over a sky of six thousand faint stars are rarely identified, because position and brightness
    are ambiguous."""
    rng = np.random.default_rng(44)
    pixels, v_mag = scene(rng.uniform(0, 999, (6000, 2)).tolist(), rng.uniform(6, 7, 6000).tolist())
    seen = np.vstack([pixels[:8], rng.uniform(0, 999, (200, 2))])
    found = name(seen, np.append(v_mag[:8], rng.uniform(6, 7, 200)), table(pixels, v_mag), 8)
    assert set(range(8)) <= set(found)
    assert len(found) <= 10


def test_false_geometry_is_not_confirmed() -> None:
    """Matches that the stars' own places contradict give None, not a worse attitude."""
    pixels, v_mag = scene([], [])
    rng = np.random.default_rng(45)
    assert name(pixels + rng.uniform(-9, 9, pixels.shape), v_mag, table(pixels, v_mag), 8) == {}


def test_flux_line_is_that_of_the_stars_in_spite_of_saturation() -> None:
    """Twenty linear stars and four saturated ones give the zero point to 0.05 mag and the slope to 0.05."""
    rng = np.random.default_rng(46)
    v_mag = np.linspace(1, 6, 24)
    magnitude = v_mag - 18 + rng.normal(0, 0.05, 24) + np.where(v_mag < 1.8, 1.2, 0.0)
    line = flux_line(magnitude, v_mag, np.full(24, 0.02))
    assert abs(float(line.v_mag(np.array(-12.0))) - 6.0) < 0.1
    assert abs(line.slope - 1) < 0.05
    assert line.scatter < 0.25
