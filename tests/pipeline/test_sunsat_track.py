"""Sunsat's tracking: the field on the sphere, windows, three stars, predictor, and sequences with false stars."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.onboard import decode, encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array, ra_dec_from_unit
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_angle_rad,
    rotation_from_vector,
)
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.sunsat_match import SunsatCatalogue
from gss.pipeline.chains.sunsat_onboard import SunsatChain
from gss.pipeline.chains.sunsat_track import expected_stars, uncertainty_px
from gss.pipeline.render import FalseStar, render
from gss.pipeline.score import assess
from gss.pipeline.track.predictor import predict, predict_attitude, rotation_vector_rad
from gss.pipeline.track.sphere_field import edge_dec_rad, sphere_field, stars_inside
from gss.pipeline.track.three_stars import Candidates, ThreeStars, by_boxes
from gss.skytables.pairs import distance_table

PROFILE = shipped_camera("sunsat")
CAMERA, SENSOR = PROFILE.camera, PROFILE.sensor
CHAIN = SunsatChain()
PARAMETERS = CHAIN.parameters(PROFILE, None, Commanded(), Mode.TRACKING)
PINHOLE = Camera.from_fov(752, 582, np.radians(11.17))


@lru_cache
def _catalogue() -> SunsatCatalogue:
    stars = load_stars(6.0)
    image = encode(stars, distance_table(stars, np.radians(0.25), CAMERA.diagonal_rad), "sunsat", "sunsat")
    return CHAIN.prepare(decode(image, stars.hip), PROFILE)


POINTINGS = {
    "plain": (1.2, 0.4, 0.3, 0, 0),
    "across zero": (0.01, -0.5, 1.1, 2, 0),
    "across zero, other side": (2 * np.pi - 0.01, 0.9, 2.0, 2, 0),
    "north pole": (2.0, np.pi / 2 - 0.02, 0.7, 1, 1),
    "south pole": (4.0, -np.pi / 2 + 0.01, 0.7, 1, -1),
    "exactly the pole": (0.0, np.pi / 2, 0.0, 1, 1),
    "near the pole, not over it": (3.0, np.pi / 2 - 0.12, 0.0, 0, 0),
}


@pytest.mark.parametrize("name", POINTINGS)
def test_field_on_the_sphere_agrees_with_the_projection(name: str) -> None:
    """Stars between the great circles of the field's edges are those that the camera projects into its frame, also at
    the poles and across RA 0. The zero crossings distinguish the cases (Fig. 4-3).
    """
    ra, dec, roll, crossings, pole = POINTINGS[name]
    attitude = cam_from_icrs(ra, dec, roll)
    field = sphere_field(PINHOLE.corners() @ attitude)
    assert (field.zero_crossings, field.pole) == (crossings, pole)
    rng = np.random.default_rng(1)
    sky = attitude[2] + rng.normal(0, 0.08, (4000, 3))
    sky /= np.linalg.norm(sky, axis=1, keepdims=True)
    ra_rad, dec_rad = ra_dec_from_unit(sky)
    inside = stars_inside(field, ra_rad, dec_rad)
    np.testing.assert_array_equal(np.sort(inside), np.flatnonzero(PINHOLE.contains(PINHOLE.project(sky @ attitude.T))))
    ra_offset_rad = np.mod(ra_rad[inside] - field.first_ra_rad, 2 * np.pi)
    assert np.all(np.diff(ra_offset_rad) >= 0)
    if not pole:
        assert ra_offset_rad.max() < np.pi


def test_field_on_the_sphere_is_correct_at_any_attitude() -> None:
    """At three hundred random attitudes, the same stars are selected as by projection."""
    rng = np.random.default_rng(2)
    for _ in range(300):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        sky = attitude[2] + rng.normal(0, 0.08, (300, 3))
        sky /= np.linalg.norm(sky, axis=1, keepdims=True)
        inside = stars_inside(sphere_field(PINHOLE.corners() @ attitude), *ra_dec_from_unit(sky))
        projected = np.flatnonzero(PINHOLE.contains(PINHOLE.project(sky @ attitude.T)))
        np.testing.assert_array_equal(np.sort(inside), projected)


def test_field_with_a_corner_at_right_ascension_zero_has_the_correct_pole() -> None:
    """A square field whose corners or boresight have right ascension zero, apart from rounding, has a pole only if the
    pole is inside, and selects the same stars as by projection."""
    square = Camera.from_fov(512, 512, np.radians(11.0))
    rng = np.random.default_rng(5)
    for dec_deg in (0, 30, -60, 85.5, 89, 90, -90):
        for roll_deg in range(0, 360, 45):
            attitude = cam_from_icrs(0.0, np.radians(dec_deg), np.radians(roll_deg))
            sky = attitude[2] + rng.normal(0, 0.08, (300, 3))
            sky /= np.linalg.norm(sky, axis=1, keepdims=True)
            field = sphere_field(square.corners() @ attitude)
            inside = stars_inside(field, *ra_dec_from_unit(sky))
            projected = np.flatnonzero(square.contains(square.project(sky @ attitude.T)))
            np.testing.assert_array_equal(np.sort(inside), projected)
            assert field.pole == (np.sign(dec_deg) if abs(dec_deg) > 85 else 0)


def test_great_circle_passes_through_its_points() -> None:
    """At the right ascensions of the two points, the declinations of the great circle are those of the points (App. B)."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        a, b = rng.normal(size=(2, 3))
        ra, dec = ra_dec_from_unit(np.stack([a, b]))
        np.testing.assert_allclose(edge_dec_rad(np.cross(a, b), ra), dec, atol=1e-12)


def test_predictor_has_the_weights_of_the_document() -> None:
    """Three samples are weighted as in eq. 4.22 and two as in eq. 4.23; a single sample is returned unchanged. A line
    is extrapolated exactly.
    """
    assert predict(np.array([3.0, 2.0, 1.0])) == pytest.approx(2.5 * 3 - 2 * 2 + 0.5 * 1)
    assert predict(np.array([5.0, 3.0])) == pytest.approx(7.0)
    assert predict(np.array([5.0])) == pytest.approx(5.0)
    line = np.array([4.0, 3.0, 2.0, 1.0])
    assert predict(line) == pytest.approx(5.0)


def test_predictor_uses_the_times_of_the_samples() -> None:
    """For samples at unequal times, the acceleration is calculated from the velocities in the middle of the intervals,
    and is ignored far ahead. A line is extrapolated exactly at any distance.
    """
    times = np.array([-0.8, -2.0, -3.5])
    assert predict(4.0 + 3.0 * times, -times) == pytest.approx(4.0)
    assert predict(4.0 + 3.0 * times[:2], -times[:2]) == pytest.approx(4.0)
    assert predict(4.0 + 3.0 * (times - 20), 20 - times) == pytest.approx(4.0)
    curved = 0.5 * times**2
    velocities = -np.diff(curved) / -np.diff(times)
    acceleration = (velocities[1] - velocities[0]) / ((times[2] - times[0]) / 2)
    expected = curved[0] - velocities[0] * times[0] + 0.5 * acceleration * times[0] ** 2
    assert predict(curved, -times) == pytest.approx(expected)
    assert predict(curved - 1.0, 9.0 - times) == pytest.approx(curved[0] - 1.0 + velocities[0] * (9.0 - times[0]))


def test_attitude_is_predicted_at_any_pointing() -> None:
    """A constant rate is extrapolated within 1e-12 rad from two and from three attitudes, and rotation vectors agree
    with scipy.
    """
    rng = np.random.default_rng(4)
    for _ in range(20):
        start, rate = matrix_from_quaternion(random_quaternion(rng)), rng.normal(0, 0.003, 3)
        quaternions = [quaternion_from_matrix(rotation_from_vector(-rate * k) @ start) for k in range(4)]
        for earlier in ((quaternions[1],), (quaternions[1], quaternions[0])):
            predicted = predict_attitude(quaternions[2], earlier)
            assert rotation_angle_rad(predicted, matrix_from_quaternion(quaternions[3])) < 1e-12
        assert rotation_angle_rad(predict_attitude(quaternions[2], ()), matrix_from_quaternion(quaternions[2])) < 1e-12
        vector = rng.normal(0, 1, 3)
        np.testing.assert_allclose(rotation_vector_rad(rotation_from_vector(vector)), vector, atol=1e-12)
        np.testing.assert_allclose(rotation_vector_rad(start), Rotation.from_matrix(start).as_rotvec(), atol=1e-9)


def test_predictor_is_more_accurate_than_the_last_attitude() -> None:
    """At 0.1°/s per axis, the last attitude is wrong by about ten pixels, and the prediction by less than a tenth of a
    pixel (§4.1.8).
    """
    rate = np.radians([0.1, 0.1, 0.1])
    quaternions = [quaternion_from_matrix(rotation_from_vector(-rate * k)) for k in range(4)]
    stars = CAMERA.unproject(np.array([[20.0, 20.0], [700.0, 500.0]])) @ matrix_from_quaternion(quaternions[3])
    truth = CAMERA.project(stars @ matrix_from_quaternion(quaternions[3]).T)
    last = np.linalg.norm(CAMERA.project(stars @ matrix_from_quaternion(quaternions[2]).T) - truth, axis=1)
    predicted = np.linalg.norm(
        CAMERA.project(stars @ predict_attitude(quaternions[2], (quaternions[1], quaternions[0])).T) - truth, axis=1
    )
    assert 8 < last.max() < 12
    assert predicted.max() < 0.1


def test_boxes_spread_the_stars() -> None:
    """One star of each box precedes the second of any box, and the leftmost star of a box is the first (§4.1.4)."""
    pixels = np.array([[10, 10], [20, 10], [700, 10], [10, 570], [380, 290], [30, 12]], float)
    assert by_boxes(pixels, 752, 582).tolist() == [0, 2, 4, 3, 1, 5]


def _three(columns: list[list[int]], seed: int = 0) -> ThreeStars:
    """Return the three-star test of the candidates of each reference star."""
    rng = np.random.default_rng(seed)
    unit = np.column_stack([rng.uniform(-0.1, 0.1, (12, 2)), np.ones(12)])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    test = ThreeStars(unit, unit.copy(), 1e-4)
    for reference, observed in enumerate(columns):
        test.add(Candidates(reference, np.array(observed, np.intp)))
    return test


def test_three_stars_with_correct_distances_are_matched() -> None:
    """Among several candidates per reference star, the true three are matched (Tables 4-1, 4-2)."""
    assert _three([[0], [8, 1], [9, 2, 10]]).result == [(0, 0), (1, 1), (2, 2)]


def test_a_wrong_star_is_replaced_by_a_fourth() -> None:
    """If one of three stars is wrong, the two correct ones are kept and a fourth star completes the set (§4.1.4.1)."""
    test = _three([[0], [7], [2]])
    assert test.result == []
    assert test.pair == [(0, 0), (2, 2)]
    assert test.add(Candidates(3, np.array([3], np.intp)))
    assert test.result == [(0, 0), (2, 2), (3, 3)]


def test_a_seventh_star_removes_the_first_four() -> None:
    """After six wrong columns, a seventh removes the first four, and the next correct columns give the set."""
    test = _three([[9], [10], [11], [9], [10], [11]])
    assert len(test.columns) == 6
    test.add(Candidates(6, np.array([6], np.intp)))
    assert [c.reference for c in test.columns] == [4, 5, 6]
    test.add(Candidates(7, np.array([7], np.intp)))
    assert test.add(Candidates(8, np.array([8], np.intp)))


def test_one_star_is_not_matched_twice() -> None:
    """One observed star is never matched to two reference stars."""
    assert _three([[0], [0], [0]]).result == []


def _hint(rotation: Array, error_rad: Array | float = 0.0) -> AttitudePrior:
    """Return a tracking hint with an error about each axis."""
    return AttitudePrior.from_quaternion(
        quaternion_from_matrix(rotation_from_vector(np.asarray(error_rad) * np.ones(3)) @ rotation)
    )


def test_windows_cover_the_expected_stars() -> None:
    """Expected stars are in the frame. Their windows have the sizes of eq. 4.20–4.21: 53 px for the attitude of another
    sensor, and a few pixels for the tracker's previous attitudes.
    """
    rotation = cam_from_icrs(1.4, 0.1, 0.0)
    first = expected_stars(CAMERA, _catalogue(), PARAMETERS, _hint(rotation))
    assert len(first) >= 10
    assert CAMERA.contains(first.pixels).all()
    assert first.radius_px.min() >= 53 + 5
    assert first.streak is None
    with_history = replace(
        _hint(rotation), earlier=(quaternion_from_matrix(rotation_from_vector(np.array([0, 0.002, 0])) @ rotation),)
    )
    later = expected_stars(CAMERA, _catalogue(), PARAMETERS, with_history)
    assert later.radius_px.max() < 20
    assert later.streak is not None
    # 2 mrad/s at a focal length of 3846 px is 3.85 px in half a second of exposure. The contour grows by less.
    lengths = np.array([s.length_px for s in later.streak])
    assert 0.5 < lengths.max() < 3.85
    assert lengths.min() >= 0
    assert all(abs(abs(s.direction_rad) - np.pi / 2) > 1.4 for s in later.streak)
    assert uncertainty_px(CAMERA, _catalogue(), PARAMETERS, with_history) == pytest.approx(2.0, abs=1.5)


def _sequence(
    seed: int, steps: int, start: Array, discs: int = 0, points: int = 0, rate: float = 0.0007
) -> Counter[str]:
    """Return the verdicts of a tracking sequence that starts from an attitude wrong by 0.3° per axis. It restarts after
    an unsolved frame.
    """
    rng = np.random.default_rng(seed)
    rotation_rad_s = rng.uniform(-rate, rate, 3)
    verdicts: Counter[str] = Counter()
    history: list[Array] = []
    for k in range(steps):
        rotation = rotation_from_vector(-rotation_rad_s * k) @ start
        spots = [FalseStar(*rng.uniform((0, 0), (751, 581)), v_mag=rng.uniform(2.5, 6)) for _ in range(points)]
        frame = render(
            load_stars(6.5), CAMERA, SENSOR, rotation, 0.5, rng, rate_rad_s=rotation_rad_s, false_stars=spots
        )
        pixels = _with_discs(frame.pixels, rng, discs)
        hint = (
            AttitudePrior.from_quaternion(history[0], tuple(history[1:3]))
            if history
            else _hint(rotation, np.radians(0.3))
        )
        result = solve(CHAIN, pixels, Work(CAMERA, _catalogue(), PARAMETERS, Mode.TRACKING, hint))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
        history = [result.attitude.quaternion, *history][:3] if result.attitude else []
    return verdicts


def _with_discs(pixels: Array, rng: np.random.Generator, count: int) -> Array:
    """Add false stars of about 100 pixels each, as in the document's simulation (§4.3)."""
    image = pixels.astype(int)
    row, col = np.indices((13, 13)) - 6
    disc = (row**2 + col**2 <= 5.64**2).astype(int)
    for _ in range(count):
        c, r = rng.integers(0, 752 - 13), rng.integers(0, 582 - 13)
        image[r : r + 13, c : c + 13] += disc * int(rng.integers(4, 25))
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("kind", ["none", "discs", "points"])
def test_tracking_continues_with_a_hundred_false_stars(kind: str) -> None:
    """With 100 false stars per frame, tracking continues with occasional restarts, and no attitude is wrong (§4.3)."""
    verdicts: Counter[str] = Counter()
    for seed in range(4):
        start = matrix_from_quaternion(random_quaternion(np.random.default_rng(100 + seed)))
        discs_and_points = {"discs": (100, 0), "points": (0, 100)}.get(kind, (0, 0))
        verdicts += _sequence(seed, 12, start, *discs_and_points)
    assert verdicts["wrong"] == 0
    assert verdicts["correct"] >= 43


@pytest.mark.parametrize(("ra", "dec"), [(0.0, 0.3), (2 * np.pi - 1e-3, -0.9), (1.0, np.pi / 2), (5.0, -np.pi / 2)])
def test_tracking_works_at_poles_and_zero_right_ascension(ra: float, dec: float) -> None:
    """Every frame of a sequence through a pole or across RA 0 is solved correctly."""
    verdicts = _sequence(7, 8, cam_from_icrs(ra, dec, 0.4))
    assert verdicts["wrong"] == 0
    assert verdicts["correct"] + verdicts["imprecise"] == 8


def test_tracking_needs_an_attitude() -> None:
    """Tracking without a hint, or with only a boresight, is rejected."""
    frame = np.full((582, 752), 12, np.uint8)
    for hint in (None, AttitudePrior(np.array([0.0, 0.0, 1.0]))):
        with pytest.raises(BadInput, match="tracking needs a hint"):
            solve(CHAIN, frame, Work(CAMERA, _catalogue(), PARAMETERS, Mode.TRACKING, hint))


def test_a_wrong_initial_attitude_gives_none() -> None:
    """Tracking from a random wrong attitude never gives an attitude."""
    rng = np.random.default_rng(8)
    for _ in range(25):
        frame = render(load_stars(6.5), CAMERA, SENSOR, matrix_from_quaternion(random_quaternion(rng)), 0.5, rng)
        wrong_hint = AttitudePrior.from_quaternion(random_quaternion(rng))
        result = solve(CHAIN, frame.pixels, Work(CAMERA, _catalogue(), PARAMETERS, Mode.TRACKING, wrong_hint))
        assert result.attitude is None
        assert result.reason
