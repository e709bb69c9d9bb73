"""The CubeStar chain: success rates with the real catalogue, no wrong attitude, and inputs that must fail."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from gss.catalogue_tools.onboard import decode, encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Centroids, Outcome, SolveResult, Truth
from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_angle_rad,
    rotation_from_vector,
)
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.cubestar import (
    calculate_attitude,
    find_centroids,
    solve,
    solve_centroids,
)
from gss.pipeline.chains.cubestar_match import document_distortion, match_stars
from gss.pipeline.chains.cubestar_parameters import default_parameters
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.render import FalseStar, HotPixel, render, stars_near, truth_of
from gss.pipeline.score import assess
from gss.pipeline.trace import Trace
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table

PROFILE = shipped_camera("cubestar")
CAMERA, SENSOR = PROFILE.camera, PROFILE.sensor
PARAMETERS = default_parameters(PROFILE)
ORION = cam_from_icrs(np.radians(84.0), 0.0, 0.5)


@lru_cache
def _stars(v_max: float) -> StarTable:
    return load_stars(v_max)


@lru_cache
def _bank() -> OnboardCatalogue:
    """Return the catalogue to V 3.8, encoded in the on-board format and decoded: float32 as on the device."""
    stars = _stars(3.8)
    return decode(encode(stars, distance_table(stars, 0.0, CAMERA.diagonal_rad), "cubestar", "cubestar"), stars.hip)


def _list(rng: np.random.Generator, rotation: Array, false: int, noise_px: float = 0.2) -> tuple[Centroids, Truth]:
    """Return centroids of all catalogue stars in the frame with noise, and false ones, brightest first."""
    truth = truth_of(stars_near(_stars(3.8), CAMERA, rotation), CAMERA, rotation)
    seen = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((-0.5, -0.5), (CAMERA.columns - 0.5, CAMERA.rows - 0.5), (false, 2))
    v_mag = np.concatenate([truth.v_mag, rng.uniform(2, 3.8, false)])
    order = np.argsort(v_mag, kind="stable")
    pixels = np.vstack([seen, spurious])[order]
    return Centroids.from_pixels(pixels, 10 ** (-0.4 * v_mag[order]), max(noise_px, 1e-3)), truth


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Return a hint: boresight up to 5° off for assisted (Erlank 2013 §4.3.5), attitude up to 0.25° off for tracking."""
    if mode is Mode.LOST_IN_SPACE:
        return None
    axis = rng.normal(size=3)
    if mode is Mode.TRACKING:
        turn = axis / np.linalg.norm(axis) * np.radians(0.25) * rng.random()
        return AttitudePrior.from_quaternion(quaternion_from_matrix(rotation_from_vector(turn) @ rotation))
    axis -= axis @ rotation[2] * rotation[2]
    angle = np.radians(5) * rng.random()
    return AttitudePrior(np.cos(angle) * rotation[2] + np.sin(angle) * axis / np.linalg.norm(axis))


# Minimum percentage of solved images: the result of 24 000 trials less three standard deviations of a sample of 200.
# Erlank 2013 Tables 4.4 and 4.5 have 93, 79, 72, 58 lost in space and 98.5, 96, 96, 94 assisted.
EXPECTED_PERCENT = {
    Mode.LOST_IN_SPACE: {0: 90, 1: 89, 5: 76, 10: 62},
    Mode.ASSISTED: {0: 97, 1: 97, 5: 94, 10: 91},
    Mode.TRACKING: {0: 98, 1: 98, 5: 98, 10: 98},
}


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("false", [0, 1, 5, 10])
def test_lists_are_solved_and_never_wrongly(mode: Mode, false: int, trials: Any) -> None:
    """Random attitudes, 0.2 px noise: no wrong answer, at least the expected share solved, 95 % of those correct."""
    rng = np.random.default_rng(1000 + false)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(200)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, false)
        hint = _hint(rng, rotation, mode)
        result = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS, mode=mode, hint=hint)
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
    solved = verdicts.total() - verdicts["none"]
    assert verdicts["wrong"] == 0
    assert solved >= trials.least(EXPECTED_PERCENT[mode][false], 100)
    assert verdicts["correct"] >= trials.least(95, 100, of=solved)


@pytest.mark.parametrize(
    ("mode", "false", "least"),
    [(Mode.LOST_IN_SPACE, 0, 30), (Mode.LOST_IN_SPACE, 10, 12), (Mode.ASSISTED, 5, 36), (Mode.TRACKING, 10, 38)],
)
def test_frames_are_solved_and_never_wrongly(mode: Mode, false: int, least: int, trials: Any) -> None:
    """Rendered frames with all stars to V 6.5, noise and false stars: none wrong, at least ``least`` solved."""
    rng = np.random.default_rng(7 + false)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(40)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        spots = [FalseStar(*rng.uniform((5, 5), (1018, 506)), v_mag=rng.uniform(1, 3.8)) for _ in range(false)]
        frame = render(_stars(6.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=spots)
        result = solve(frame.pixels, CAMERA, _bank(), PARAMETERS, mode=mode, hint=_hint(rng, rotation, mode))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(least, 40)


def test_pure_noise_lists_are_never_solved(trials: Any) -> None:
    """Twenty random centroids, lost and with a random hint, never give an attitude."""
    rng = np.random.default_rng(66)
    for _ in range(trials(300)):
        centroids = Centroids.from_pixels(rng.uniform((0, 0), (1023, 511), (20, 2)))
        rotation = matrix_from_quaternion(random_quaternion(rng))
        for mode in Mode:
            hint = AttitudePrior.from_quaternion(quaternion_from_matrix(rotation))
            result = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS, mode=mode, hint=hint)
            assert result.outcome is Outcome.NONE
            assert result.reason


def test_ideal_accuracy_equals_the_documents() -> None:
    """Without noise the errors of 100 images are below Figs.

    4.4 and 4.5: 0.004° across the boresight, 0.02° about it.
    """
    rng = np.random.default_rng(44)
    quiet = replace(SENSOR, read_noise_e=0.0, dark_current_e_s=0.0, background_e_s=0.0)
    camera = replace(CAMERA, distortion=Brown())
    cross, about = [], []
    for _ in range(100):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(3.8), camera, quiet, rotation, SENSOR.exposure_s, rng, noise=False)
        result = solve(frame.pixels, camera, _bank(), PARAMETERS)
        if result.outcome is Outcome.SOLVED:
            graded = assess(result, frame.truth, camera)
            cross.append(np.degrees(graded.cross_rad))
            about.append(abs(np.degrees(graded.about_rad)))
    assert len(cross) >= 85
    assert max(cross) < 0.004
    assert max(about) < 0.02


def _solved_list(seed: int) -> tuple[Centroids, Array, SolveResult]:
    rng = np.random.default_rng(seed)
    while True:
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _list(rng, rotation, 2)
        result = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS)
        if result.attitude is not None and 8 <= len(centroids) <= PARAMETERS.max_centroids:
            return centroids, rotation, result


def test_rotating_the_sky_rotates_the_attitude() -> None:
    """With a rotated catalogue the same centroids give the inversely rotated attitude and the same matches."""
    centroids, _, before = _solved_list(5)
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(6)))
    stars = replace(_stars(3.8), icrs=_stars(3.8).icrs @ turn.T)
    bank = decode(encode(stars, distance_table(stars, 0.0, CAMERA.diagonal_rad), "cubestar", "cubestar"), stars.hip)
    after = solve_centroids(centroids, CAMERA, bank, PARAMETERS)
    assert before.attitude is not None
    assert after.attitude is not None
    assert before.matches is not None
    assert after.matches is not None
    np.testing.assert_array_equal(after.matches.hip, before.matches.hip)
    # float32 directions of the bank differ by 6e-8
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ turn, before.attitude.cam_from_icrs) < 1e-6


def test_the_order_of_centroids_does_not_matter() -> None:
    """Any order of the same centroids gives the same stars and, to rounding, the same attitude."""
    centroids, _, before = _solved_list(7)
    assert before.attitude is not None
    assert before.matches is not None
    for seed in range(10):
        order = np.random.default_rng(seed).permutation(len(centroids))
        after = solve_centroids(centroids.take(order), CAMERA, _bank(), PARAMETERS)
        assert after.attitude is not None
        assert after.matches is not None
        names = dict(zip(order[after.matches.centroid].tolist(), after.matches.hip.tolist(), strict=True))
        assert names == dict(zip(before.matches.centroid.tolist(), before.matches.hip.tolist(), strict=True))
        assert rotation_angle_rad(after.attitude.cam_from_icrs, before.attitude.cam_from_icrs) < 1e-12


def test_the_same_frame_gives_identical_bits() -> None:
    """Two runs agree in every bit, with and without a clock, and so do the device's single steps."""
    rng = np.random.default_rng(8)
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng).pixels
    ticks = iter(range(100))
    a = solve(frame, CAMERA, _bank(), PARAMETERS)
    b = solve(frame.copy(), CAMERA, _bank(), PARAMETERS, clock=lambda: float(next(ticks)))
    detection = find_centroids(frame, PARAMETERS)
    matching = match_stars(detection.centroids, CAMERA, _bank(), PARAMETERS)
    steps = calculate_attitude(matching, detection.centroids, CAMERA, _bank(), PARAMETERS)
    assert a.attitude is not None
    assert b.attitude is not None
    assert steps.attitude is not None
    for other in (b.attitude, steps.attitude):
        assert a.attitude.quaternion.tobytes() == other.quaternion.tobytes()
        assert a.attitude.covariance_rad2.tobytes() == other.covariance_rad2.tobytes()
    assert a.centroids.pixels.tobytes() == b.centroids.pixels.tobytes()
    assert (a.regions, a.timing_s) == (b.regions, {})
    assert set(b.timing_s) == {"detect", "match", "attitude"}


def test_trace_contains_the_intermediate_steps() -> None:
    """The caller's trace contains detection and matching, with both rounds of votes."""
    trace = Trace()
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, np.random.default_rng(8)).pixels
    result = solve(frame, CAMERA, _bank(), PARAMETERS, trace=trace)
    matching = trace.kept["matching"]
    assert len(matching.first_votes) == len(matching.verification_votes) == len(result.centroids)  # type: ignore[attr-defined]
    assert trace.kept["detection"].regions == result.regions  # type: ignore[attr-defined]


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_too_few_stars_are_reported(n: int) -> None:
    """Up to three centroids give no attitude when lost in space, and the reason states their number."""
    centroids, _, _ = _solved_list(9)
    result = solve_centroids(centroids.take(np.arange(n)), CAMERA, _bank(), PARAMETERS)
    assert result.outcome is Outcome.NONE
    assert result.attitude is None
    assert result.matches is None
    assert (
        result.reason == "no star found in the frame" if n == 0 else "4 needed in lost in space mode" in result.reason
    )


def test_only_the_documents_settings_track_with_two_stars() -> None:
    """Erlank 2013 §4.5: tracking works with two stars; ours needs three, because two also fit a mirrored frame."""
    rng = np.random.default_rng(10)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, truth = _list(rng, rotation, 0)
    hint = AttitudePrior.from_quaternion(truth.quaternion)
    two, three = centroids.take(np.arange(2)), centroids.take(np.arange(3))
    document = replace(PARAMETERS, acceptance="document")
    result = solve_centroids(two, CAMERA, _bank(), document, mode=Mode.TRACKING, hint=hint)
    assert assess(result, truth, CAMERA).verdict.value == "correct"
    refused = solve_centroids(two, CAMERA, _bank(), PARAMETERS, mode=Mode.TRACKING, hint=hint)
    assert refused.attitude is None
    assert "3 needed" in refused.reason
    result = solve_centroids(three, CAMERA, _bank(), PARAMETERS, mode=Mode.TRACKING, hint=hint)
    assert assess(result, truth, CAMERA).verdict.value == "correct"


def _dark(value: int = 11) -> np.ndarray:
    return np.full((512, 1024), value, np.uint8)


def test_hopeless_frames_give_none_with_a_reason() -> None:
    """Blank, saturated, all-noise, striped and Moon-lit frames give none with a reason, never an attitude."""
    rng = np.random.default_rng(12)
    moon = _dark()
    row, col = np.indices(moon.shape)
    moon[(row - 200) ** 2 + (col - 300) ** 2 < 40**2] = 255
    stripes = _dark()
    stripes[::9] = 200
    frames = {
        "blank": _dark(0),
        "saturated": _dark(255),
        "noise": rng.integers(0, 256, (512, 1024)).astype(np.uint8),
        "sparse noise": np.where(rng.random((512, 1024)) < 0.2, 200, 11).astype(np.uint8),
        "stripes": stripes,
        "moon": moon,
    }
    for name, frame in frames.items():
        result = solve(frame, CAMERA, _bank(), PARAMETERS)
        assert result.outcome is Outcome.NONE, name
        assert result.reason, name
    assert solve(stripes, CAMERA, _bank(), PARAMETERS).notes == ("search stopped: more than 50 areas are too large",)
    assert "area 5" in solve(moon, CAMERA, _bank(), PARAMETERS).regions[0].rejected


def test_hot_pixels_do_not_change_the_result() -> None:
    """Two hundred hot pixels change neither the detected stars nor the attitude by more than the noise."""
    rng = np.random.default_rng(13)
    hot = [HotPixel(int(rng.integers(1024)), int(rng.integers(512)), 4000.0) for _ in range(200)]
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng, hot_pixels=hot)
    result = solve(frame.pixels, CAMERA, _bank(), PARAMETERS)
    assert assess(result, frame.truth, CAMERA).verdict.value == "correct"
    assert sum("< min" in r.rejected for r in result.regions) >= 15  # a ninth of them, those on the search grid


def test_stars_cut_by_the_edge_are_excluded() -> None:
    """No accepted region touches the frame's border; without the rule such stars are accepted."""
    rng = np.random.default_rng(14)
    at = [FalseStar(0.3, 100, 1.0), FalseStar(1023, 200, 1.0), FalseStar(500, 0, 1.0), FalseStar(500, 300, 1.0)]
    frame = render(_stars(3.0).take(np.zeros(0, np.intp)), CAMERA, SENSOR, np.eye(3), 0.25, rng, false_stars=at)
    assert len(find_centroids(frame.pixels, PARAMETERS).centroids) == 1
    assert len(find_centroids(frame.pixels, replace(PARAMETERS, edge_rule=False)).centroids) == 4


def test_a_wrong_hint_gives_no_attitude() -> None:
    """A boresight hint 40° off, and a tracking attitude 2° off, give none with a reason."""
    centroids, rotation, _ = _solved_list(15)
    far = rotation_from_vector(np.array([np.radians(40), 0, 0])) @ rotation
    near = rotation_from_vector(np.array([np.radians(2), 0, 0])) @ rotation
    assisted = AttitudePrior(far[2])
    lost = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS, mode=Mode.ASSISTED, hint=assisted)
    assert lost.outcome is Outcome.NONE
    tracked = solve_centroids(
        centroids,
        CAMERA,
        _bank(),
        PARAMETERS,
        mode=Mode.TRACKING,
        hint=AttitudePrior.from_quaternion(quaternion_from_matrix(near)),
    )
    assert tracked.outcome is Outcome.NONE
    assert "verified" in tracked.reason


def test_a_required_hint_must_be_given() -> None:
    """Assisted without a boresight and tracking without an attitude are rejected before anything runs."""
    centroids, rotation, _ = _solved_list(16)
    for mode, hint in ((Mode.ASSISTED, None), (Mode.TRACKING, None), (Mode.TRACKING, AttitudePrior(rotation[2]))):
        with pytest.raises(BadInput, match="needs a hint"):
            match_stars(centroids, CAMERA, _bank(), PARAMETERS, mode, hint)


def test_a_frame_of_another_camera_is_rejected() -> None:
    """The frame's size must be the camera's."""
    with pytest.raises(BadInput, match="does not fit"):
        solve(np.zeros((1024, 512), np.uint8), CAMERA, _bank(), PARAMETERS)


def test_an_empty_bank_matches_nothing() -> None:
    """A catalogue of one star, without pairs, gives none and no error."""
    stars = _stars(3.8).take(np.array([0]))
    table = distance_table(stars, 0.0, 1.0)
    bank = OnboardCatalogue(stars.hip, stars.icrs.astype(np.float32), stars.v_mag, table)
    centroids, _, _ = _solved_list(17)
    assert solve_centroids(centroids, CAMERA, bank, PARAMETERS).outcome is Outcome.NONE


def test_the_documents_correction_is_an_approximation() -> None:
    """Inverting the signs of the toolbox is accurate in the middle and wrong by tens of pixels in the corners of this
    wide lens.
    """
    approximate = replace(CAMERA, distortion=document_distortion(CAMERA))

    def error_px(camera: Camera, pixels: Array) -> Array:
        """Return the error in pixels of the ideal image."""
        v = camera.unproject(pixels)
        w = CAMERA.unproject(pixels)
        return np.linalg.norm(v[:, :2] / v[:, 2:] - w[:, :2] / w[:, 2:], axis=1) * CAMERA.focal_col_px

    middle = np.array([[511.5, 255.5], [540, 270]])
    corners = np.array([[0.0, 0], [1023, 0], [0, 511], [1023, 511]])
    assert error_px(approximate, middle).max() < 0.02
    assert 5 < error_px(approximate, corners).max() < 60
    with pytest.raises(BadInput, match="Brown"):
        document_distortion(shipped_camera("sunsat").camera)


def test_the_documents_correction_reduces_the_solved_share() -> None:
    """With the approximation clearly fewer lists are solved than with the exact inverse, but no attitude is wrong."""
    rng = np.random.default_rng(31)
    parameters = replace(PARAMETERS, undistort="document")
    exact, approximate = 0, 0
    for _ in range(60):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 0)
        exact += solve_centroids(centroids, CAMERA, _bank(), PARAMETERS).outcome is Outcome.SOLVED
        graded = assess(solve_centroids(centroids, CAMERA, _bank(), parameters), truth, CAMERA)
        approximate += not np.isnan(graded.cross_rad)
        assert not graded.cross_rad > 3 * CAMERA.pixel_rad
    assert 0.3 * exact < approximate < 0.85 * exact
