"""Identification of all stars of a solved frame: few are missed, none is wrong, and the covariance of the attitude
agrees with its errors.
"""

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
    """Return the stars of a camera to its limiting magnitude plus ``fainter_mag``."""
    profile = shipped_camera(name)
    return known_sky(SKY, profile.camera, profile.sensor.faint_limit_mag + fainter_mag)


def rendered_frame(name: str, attitude: Array, rng: np.random.Generator, false_stars: int = 0) -> Rendered:
    """Render all stars to V 8 and false stars with the camera of a profile."""
    profile = shipped_camera(name)
    spots = [
        FalseStar(rng.uniform(0, profile.camera.columns), rng.uniform(0, profile.camera.rows), rng.uniform(2.5, 6))
        for _ in range(false_stars)
    ]
    return render(TABLE, profile.camera, profile.sensor, attitude, profile.sensor.exposure_s, rng, false_stars=spots)


def solve(name: str, frame: Rendered) -> SolveResult:
    """Solve a frame; stars one magnitude fainter are available for identification."""
    profile = shipped_camera(name)
    return solve_known(frame.pixels, profile.camera, profile.sensor, stars_of(name), deeper=lambda: stars_of(name, 1.0))


def misidentified(result: SolveResult, camera: Camera, attitude: Array) -> int:
    """Return the number of wrong matches: the star is over 3 px from its centroid, or a brighter star is within 2.5 px
    of the centroid.
    """
    assert result.matches is not None
    in_view = SKY.icrs @ attitude[2] > np.cos(camera.half_diagonal_rad + 0.02)
    hip, v_mag, pixels = SKY.hip[in_view], SKY.v_mag[in_view], camera.project(SKY.icrs[in_view] @ attitude.T)
    row = {int(h): k for k, h in enumerate(hip)}
    wrong_matches = 0
    for k, h in zip(result.matches.centroid, result.matches.hip, strict=True):
        distance_px = np.linalg.norm(pixels - result.centroids.pixels[k], axis=1)
        own_row = row[int(h)]
        wrong_matches += bool(distance_px[own_row] > 3 or v_mag[distance_px < 2.5].min(initial=99) < v_mag[own_row])
    return wrong_matches


@pytest.mark.parametrize(("name", "share"), [("cubestar", 0.92), ("sunsat", 0.95)])
def test_nearly_all_detections_are_identified_correctly(name: str, share: float) -> None:
    """Over 40 frames, more than nine in ten centroids are identified, none wrongly, and the attitude errors agree with
    the covariance.
    """
    rng = np.random.default_rng(41)
    identified = detected = wrong_matches = 0
    squared_errors = []
    for _ in range(40):
        attitude = Rotation.random(rng=rng).as_matrix()
        result = solve(name, rendered_frame(name, attitude, rng))
        assert result.attitude is not None
        assert result.matches is not None
        assert (
            len(set(result.matches.centroid.tolist())) == len(set(result.matches.hip.tolist())) == len(result.matches)
        )
        identified, detected = identified + len(result.matches), detected + len(result.centroids)
        wrong_matches += misidentified(result, shipped_camera(name).camera, attitude)
        error = Rotation.from_matrix(result.attitude.cam_from_icrs @ attitude.T).as_rotvec()
        squared_errors.append(error @ np.linalg.solve(result.attitude.covariance_rad2, error))
    assert wrong_matches == 0
    assert identified > share * detected
    assert 1.6 < np.mean(squared_errors) < 4.0
    assert max(squared_errors) < 25


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_false_stars_are_not_identified(name: str) -> None:
    """Thirty false stars per frame are not identified, and more than half of the true stars still are."""
    rng = np.random.default_rng(42)
    mostly_identified = 0
    for _ in range(12):
        attitude = Rotation.random(rng=rng).as_matrix()
        result = solve(name, rendered_frame(name, attitude, rng, false_stars=30))
        assert result.attitude is not None
        assert misidentified(result, shipped_camera(name).camera, attitude) == 0
        mostly_identified += len(result.matches or ()) > 0.5 * (len(result.centroids) - 30)
    assert mostly_identified == 12


def test_faint_stars_improve_the_attitude() -> None:
    """With the faint stars, the mean cross-boresight error is at least a fifth smaller than with the bright stars
    alone.
    """
    rng = np.random.default_rng(43)
    profile = shipped_camera("cubestar")
    bright_only, all_stars = [], []
    bright = stars_of("cubestar").sky
    for _ in range(40):
        attitude = Rotation.random(rng=rng).as_matrix()
        result = solve("cubestar", rendered_frame("cubestar", attitude, rng))
        assert result.attitude is not None
        assert result.matches is not None
        is_bright = np.isin(result.matches.hip, bright.hip)
        row = {int(h): k for k, h in enumerate(bright.hip)}
        icrs = bright.icrs[[row[int(h)] for h in result.matches.hip[is_bright]]]
        centroids = result.centroids.take(result.matches.centroid[is_bright].astype(np.intp))
        fit = refine(
            centroids.pixels, icrs, np.maximum(centroids.sigma_px, 0.03), profile.camera, result.attitude.cam_from_icrs
        )
        for errors, estimate in ((bright_only, fit.cam_from_icrs), (all_stars, result.attitude.cam_from_icrs)):
            errors.append(np.linalg.norm(estimate[2] - attitude[2]))
    assert np.mean(all_stars) < 0.8 * np.mean(bright_only)


CAMERA = Camera(1000, 1000, 2500.0, 2500.0, 499.5, 499.5)


def table(pixels: Array, v_mag: Array) -> SkyCatalogue:
    """Return a catalogue of stars exactly at these pixels for the identity attitude, brightest first."""
    order = np.argsort(v_mag, kind="stable")
    return SkyCatalogue(
        np.arange(1, len(v_mag) + 1, dtype=np.int32)[order], CAMERA.unproject(pixels)[order], v_mag[order]
    )


def identify(pixels: Array, v_seen: Array, sky: SkyCatalogue, anchors: int) -> dict[int, int]:
    """Return the identified Hipparcos number of each spot. The first ``anchors`` spots, which are stars 1, 2 …, are
    already matched.
    """
    spots = Spots(pixels, np.full(len(pixels), 0.1), v_seen - 20.0, 1.2)
    rows: Rows = np.arange(anchors, dtype=np.intp)
    star_rows: Rows = np.array([int(np.flatnonzero(sky.hip == k + 1)[0]) for k in rows], np.intp)

    def fit_to(r: Rows, s: Rows, sigma_px: Array) -> Refined:
        return refine(pixels[r], sky.icrs[s], sigma_px, CAMERA, rotation_from_vector(np.zeros(3)))

    matched = match_all(spots, sky, fit_to(rows, star_rows, np.full(anchors, 0.1)), rows, star_rows, fit_to)
    return (
        {} if matched is None else {int(r): int(sky.hip[s]) for r, s in zip(matched.rows, matched.stars, strict=True)}
    )


def scene(extra_pixels: list[list[float]], extra_mag: list[float]) -> tuple[Array, Array]:
    """Return pixels and magnitudes of eight matched stars of V 3 to 4.4 and of additional stars."""
    ring = np.array([[500 + 350 * np.cos(a), 500 + 350 * np.sin(a)] for a in np.linspace(0, 5.5, 8)])
    pixels = np.vstack([ring, np.array(extra_pixels).reshape(-1, 2)])
    return pixels, np.concatenate([3 + 0.2 * np.arange(8), extra_mag])


def test_an_isolated_faint_star_is_identified() -> None:
    """A star with the position and brightness of the catalogue is identified."""
    pixels, v_mag = scene([[420.0, 530.0]], [6.0])
    assert identify(pixels, v_mag, table(pixels, v_mag), 8)[8] == 9


def test_a_spot_with_wrong_brightness_or_position_is_not_identified() -> None:
    """A spot two magnitudes too bright, or 1.5 px away, is not identified with that star."""
    pixels, v_mag = scene([[420.0, 530.0]], [6.0])
    sky = table(pixels, v_mag)
    assert 8 not in identify(pixels, v_mag + np.array([0.0] * 8 + [-2.0]), sky, 8)
    assert 8 not in identify(pixels + np.array([[0.0, 0.0]] * 8 + [[1.5, 0.0]]), v_mag, sky, 8)


def test_a_blend_of_two_equal_stars_is_not_identified() -> None:
    """A single detection between two equal stars two pixels apart is ambiguous and is not identified."""
    pixels, v_mag = scene([[420.0, 530.0], [422.0, 530.0]], [6.0, 6.0])
    detected = np.vstack([pixels[:8], [[421.0, 530.0]]])
    assert 8 not in identify(detected, np.append(v_mag[:8], 5.3), table(pixels, v_mag), 8)


def test_a_faint_companion_does_not_prevent_identification() -> None:
    """A star with a companion three magnitudes fainter is identified."""
    pixels, v_mag = scene([[420.0, 530.0], [422.0, 530.0]], [5.0, 8.0])
    assert identify(pixels[:9], v_mag[:9], table(pixels, v_mag), 8)[8] == 9


def test_two_detections_of_one_star_are_not_identified() -> None:
    """If two detections fit one star, neither is identified."""
    pixels, v_mag = scene([[420.0, 530.0]], [6.0])
    detected = np.vstack([pixels, pixels[8:] + 0.2])
    identified = identify(detected, np.append(v_mag, 6.0), table(pixels, v_mag), 8)
    assert 8 not in identified
    assert 9 not in identified


def test_a_crowded_field_does_not_identify_random_dots() -> None:
    """At most two of two hundred random dots in a sky of six thousand faint stars are identified, because position and
    brightness are ambiguous.
    """
    rng = np.random.default_rng(44)
    pixels, v_mag = scene(rng.uniform(0, 999, (6000, 2)).tolist(), rng.uniform(6, 7, 6000).tolist())
    detected = np.vstack([pixels[:8], rng.uniform(0, 999, (200, 2))])
    identified = identify(detected, np.append(v_mag[:8], rng.uniform(6, 7, 200)), table(pixels, v_mag), 8)
    assert set(range(8)) <= set(identified)
    assert len(identified) <= 10


def test_contradicting_positions_give_no_matches() -> None:
    """If the positions of the matched stars contradict each other, no match is returned."""
    pixels, v_mag = scene([], [])
    rng = np.random.default_rng(45)
    assert identify(pixels + rng.uniform(-9, 9, pixels.shape), v_mag, table(pixels, v_mag), 8) == {}


def test_saturated_stars_do_not_affect_the_flux_line() -> None:
    """Twenty unsaturated and four saturated stars give the zero point within 0.1 mag and the slope within 0.05."""
    rng = np.random.default_rng(46)
    v_mag = np.linspace(1, 6, 24)
    magnitude = v_mag - 18 + rng.normal(0, 0.05, 24) + np.where(v_mag < 1.8, 1.2, 0.0)
    line = flux_line(magnitude, v_mag, np.full(24, 0.02))
    assert abs(float(line.v_mag(np.array(-12.0))) - 6.0) < 0.1
    assert abs(line.slope - 1) < 0.05
    assert line.scatter < 0.25
