"""The CubeStar chain: success rates with the real catalogue, in which no solution may be wrong, and frames that must
not be solved.
"""

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
    """Return the catalogue to V 3.8, encoded in the on-board format and decoded, so that it has float32 values as on
    the device.
    """
    stars = _stars(3.8)
    return decode(encode(stars, distance_table(stars, 0.0, CAMERA.diagonal_rad), "cubestar", "cubestar"), stars.hip)


def _star_list(
    rng: np.random.Generator, rotation: Array, false_count: int, noise_px: float = 0.2
) -> tuple[Centroids, Truth]:
    """Return centroids of all catalogue stars in the frame with noise, and of false stars, brightest first."""
    truth = truth_of(stars_near(_stars(3.8), CAMERA, rotation), CAMERA, rotation)
    measured = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((-0.5, -0.5), (CAMERA.columns - 0.5, CAMERA.rows - 0.5), (false_count, 2))
    v_mag = np.concatenate([truth.v_mag, rng.uniform(2, 3.8, false_count)])
    order = np.argsort(v_mag, kind="stable")
    pixels = np.vstack([measured, spurious])[order]
    return Centroids.from_pixels(pixels, 10 ** (-0.4 * v_mag[order]), max(noise_px, 1e-3)), truth


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Return a boresight with an error of up to 5° (assisted, Erlank 2013 §4.3.5) or an attitude with an error of up to
    0.25° (tracking).
    """
    if mode is Mode.LOST_IN_SPACE:
        return None
    axis = rng.normal(size=3)
    if mode is Mode.TRACKING:
        turn = axis / np.linalg.norm(axis) * np.radians(0.25) * rng.random()
        return AttitudePrior.from_quaternion(quaternion_from_matrix(rotation_from_vector(turn) @ rotation))
    axis -= axis @ rotation[2] * rotation[2]
    angle = np.radians(5) * rng.random()
    return AttitudePrior(np.cos(angle) * rotation[2] + np.sin(angle) * axis / np.linalg.norm(axis))


# Minimum percentage of solved images, by number of false stars: the result of 24 000 trials less three standard
# deviations of a sample of 200. Erlank 2013 Tables 4.4 and 4.5 give 93, 79, 72, 58 lost in space and 98.5, 96, 96, 94
# assisted.
EXPECTED_PERCENT = {
    Mode.LOST_IN_SPACE: {0: 90, 1: 89, 5: 76, 10: 62},
    Mode.ASSISTED: {0: 97, 1: 97, 5: 94, 10: 91},
    Mode.TRACKING: {0: 98, 1: 98, 5: 98, 10: 98},
}


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("false_count", [0, 1, 5, 10])
def test_lists_are_solved_and_never_wrongly(mode: Mode, false_count: int, trials: Any) -> None:
    """For random attitudes with noise of 0.2 px, no solution is wrong, at least the stated share is solved, and 95 % of
    the solutions are correct.
    """
    rng = np.random.default_rng(1000 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(200)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, false_count)
        hint = _hint(rng, rotation, mode)
        result = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS, mode=mode, hint=hint)
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
    solved = verdicts.total() - verdicts["none"]
    assert verdicts["wrong"] == 0
    assert solved >= trials.least(EXPECTED_PERCENT[mode][false_count], 100)
    assert verdicts["correct"] >= trials.least(95, 100, of=solved)


@pytest.mark.parametrize(
    ("mode", "false_count", "min_solved"),
    [(Mode.LOST_IN_SPACE, 0, 30), (Mode.LOST_IN_SPACE, 10, 12), (Mode.ASSISTED, 5, 36), (Mode.TRACKING, 10, 38)],
)
def test_frames_are_solved_and_never_wrongly(mode: Mode, false_count: int, min_solved: int, trials: Any) -> None:
    """Of rendered frames with all stars to V 6.5, noise and false stars, none is solved wrongly and at least
    ``min_solved`` of 40 are solved.
    """
    rng = np.random.default_rng(7 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(40)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        spots = [FalseStar(*rng.uniform((5, 5), (1018, 506)), v_mag=rng.uniform(1, 3.8)) for _ in range(false_count)]
        frame = render(_stars(6.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=spots)
        result = solve(frame.pixels, CAMERA, _bank(), PARAMETERS, mode=mode, hint=_hint(rng, rotation, mode))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(min_solved, 40)


def test_pure_noise_lists_are_never_solved(trials: Any) -> None:
    """Twenty random centroids never give an attitude, in any mode, with a random hint."""
    rng = np.random.default_rng(66)
    for _ in range(trials(300)):
        centroids = Centroids.from_pixels(rng.uniform((0, 0), (1023, 511), (20, 2)))
        rotation = matrix_from_quaternion(random_quaternion(rng))
        for mode in Mode:
            hint = AttitudePrior.from_quaternion(quaternion_from_matrix(rotation))
            result = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS, mode=mode, hint=hint)
            assert result.outcome is Outcome.NONE
            assert result.reason


def test_accuracy_without_noise_is_that_of_the_document() -> None:
    """Without noise, the errors of 100 images are below those of Figs. 4.4 and 4.5: 0.004° across the boresight and
    0.02° about it.
    """
    rng = np.random.default_rng(44)
    noiseless = replace(SENSOR, read_noise_e=0.0, dark_current_e_s=0.0, background_e_s=0.0)
    camera = replace(CAMERA, distortion=Brown())
    cross_deg, roll_deg = [], []
    for _ in range(100):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(3.8), camera, noiseless, rotation, SENSOR.exposure_s, rng, noise=False)
        result = solve(frame.pixels, camera, _bank(), PARAMETERS)
        if result.outcome is Outcome.SOLVED:
            assessment = assess(result, frame.truth, camera)
            cross_deg.append(np.degrees(assessment.cross_rad))
            roll_deg.append(abs(np.degrees(assessment.about_rad)))
    assert len(cross_deg) >= 85
    assert max(cross_deg) < 0.004
    assert max(roll_deg) < 0.02


def _solved_list(seed: int) -> tuple[Centroids, Array, SolveResult]:
    """Return the first random list that is solved, its attitude and its result."""
    rng = np.random.default_rng(seed)
    while True:
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _star_list(rng, rotation, 2)
        result = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS)
        if result.attitude is not None and 8 <= len(centroids) <= PARAMETERS.max_centroids:
            return centroids, rotation, result


def test_rotating_the_sky_rotates_the_attitude() -> None:
    """If the catalogue is rotated, the same centroids give the same matches and the attitude rotated accordingly."""
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
    # The bank stores float32 directions, which are rounded by 6e-8.
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ turn, before.attitude.cam_from_icrs) < 1e-6


def test_the_order_of_centroids_has_no_effect() -> None:
    """The same centroids in any order give the same stars and, within rounding errors, the same attitude."""
    centroids, _, before = _solved_list(7)
    assert before.attitude is not None
    assert before.matches is not None
    for seed in range(10):
        order = np.random.default_rng(seed).permutation(len(centroids))
        after = solve_centroids(centroids.take(order), CAMERA, _bank(), PARAMETERS)
        assert after.attitude is not None
        assert after.matches is not None
        hip_of = dict(zip(order[after.matches.centroid].tolist(), after.matches.hip.tolist(), strict=True))
        assert hip_of == dict(zip(before.matches.centroid.tolist(), before.matches.hip.tolist(), strict=True))
        assert rotation_angle_rad(after.attitude.cam_from_icrs, before.attitude.cam_from_icrs) < 1e-12


def test_the_same_frame_gives_identical_bits() -> None:
    """Two runs, with and without a clock, and the single steps that the device runs give identical bits."""
    rng = np.random.default_rng(8)
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng).pixels
    ticks = iter(range(100))
    first = solve(frame, CAMERA, _bank(), PARAMETERS)
    second = solve(frame.copy(), CAMERA, _bank(), PARAMETERS, clock=lambda: float(next(ticks)))
    detection = find_centroids(frame, PARAMETERS)
    matching = match_stars(detection.centroids, CAMERA, _bank(), PARAMETERS)
    steps = calculate_attitude(matching, detection.centroids, CAMERA, _bank(), PARAMETERS)
    assert first.attitude is not None
    assert second.attitude is not None
    assert steps.attitude is not None
    for other in (second.attitude, steps.attitude):
        assert first.attitude.quaternion.tobytes() == other.quaternion.tobytes()
        assert first.attitude.covariance_rad2.tobytes() == other.covariance_rad2.tobytes()
    assert first.centroids.pixels.tobytes() == second.centroids.pixels.tobytes()
    assert (first.regions, first.timing_s) == (second.regions, {})
    assert set(second.timing_s) == {"detect", "match", "attitude"}


def test_trace_contains_the_intermediate_steps() -> None:
    """The caller's trace contains detection and matching, including both rounds of votes."""
    trace = Trace()
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, np.random.default_rng(8)).pixels
    result = solve(frame, CAMERA, _bank(), PARAMETERS, trace=trace)
    matching = trace.kept["matching"]
    assert len(matching.first_votes) == len(matching.verification_votes) == len(result.centroids)  # type: ignore[attr-defined]
    assert trace.kept["detection"].regions == result.regions  # type: ignore[attr-defined]


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_too_few_stars_are_reported(n: int) -> None:
    """Up to three centroids give no attitude in lost-in-space mode, and the reason states how many are needed."""
    centroids, _, _ = _solved_list(9)
    result = solve_centroids(centroids.take(np.arange(n)), CAMERA, _bank(), PARAMETERS)
    assert result.outcome is Outcome.NONE
    assert result.attitude is None
    assert result.matches is None
    assert (
        result.reason == "no star found in the frame" if n == 0 else "4 needed in lost in space mode" in result.reason
    )


def test_only_the_document_rule_tracks_with_two_stars() -> None:
    """Erlank 2013 §4.5 tracks with two stars. GSS requires three by default, because two stars also fit a mirrored
    frame.
    """
    rng = np.random.default_rng(10)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, truth = _star_list(rng, rotation, 0)
    hint = AttitudePrior.from_quaternion(truth.quaternion)
    two, three = centroids.take(np.arange(2)), centroids.take(np.arange(3))
    document = replace(PARAMETERS, acceptance="document")
    result = solve_centroids(two, CAMERA, _bank(), document, mode=Mode.TRACKING, hint=hint)
    assert assess(result, truth, CAMERA).verdict.value == "correct"
    rejected = solve_centroids(two, CAMERA, _bank(), PARAMETERS, mode=Mode.TRACKING, hint=hint)
    assert rejected.attitude is None
    assert "3 needed" in rejected.reason
    result = solve_centroids(three, CAMERA, _bank(), PARAMETERS, mode=Mode.TRACKING, hint=hint)
    assert assess(result, truth, CAMERA).verdict.value == "correct"


def _dark(value: int = 11) -> np.ndarray:
    return np.full((512, 1024), value, np.uint8)


def test_frames_without_usable_stars_give_none_with_a_reason() -> None:
    """Blank, saturated, noisy, striped and Moon-lit frames give none with a reason, never an attitude."""
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
    """With two hundred hot pixels the frame is solved correctly, and hot pixels are rejected as too small."""
    rng = np.random.default_rng(13)
    hot = [HotPixel(int(rng.integers(1024)), int(rng.integers(512)), 4000.0) for _ in range(200)]
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng, hot_pixels=hot)
    result = solve(frame.pixels, CAMERA, _bank(), PARAMETERS)
    assert assess(result, frame.truth, CAMERA).verdict.value == "correct"
    assert sum("< min" in r.rejected for r in result.regions) >= 15  # about a ninth of them are on the search grid


def test_stars_clipped_by_the_edge_are_excluded() -> None:
    """With the edge rule, no accepted region touches the border of the frame. Without it, such stars are accepted."""
    rng = np.random.default_rng(14)
    stars = [FalseStar(0.3, 100, 1.0), FalseStar(1023, 200, 1.0), FalseStar(500, 0, 1.0), FalseStar(500, 300, 1.0)]
    frame = render(_stars(3.0).take(np.zeros(0, np.intp)), CAMERA, SENSOR, np.eye(3), 0.25, rng, false_stars=stars)
    assert len(find_centroids(frame.pixels, PARAMETERS).centroids) == 1
    assert len(find_centroids(frame.pixels, replace(PARAMETERS, edge_rule=False)).centroids) == 4


def test_a_wrong_hint_gives_no_attitude() -> None:
    """A boresight hint wrong by 40° and a tracking attitude wrong by 2° give none with a reason."""
    centroids, rotation, _ = _solved_list(15)
    wrong_by_40_deg = rotation_from_vector(np.array([np.radians(40), 0, 0])) @ rotation
    wrong_by_2_deg = rotation_from_vector(np.array([np.radians(2), 0, 0])) @ rotation
    assisted = AttitudePrior(wrong_by_40_deg[2])
    lost = solve_centroids(centroids, CAMERA, _bank(), PARAMETERS, mode=Mode.ASSISTED, hint=assisted)
    assert lost.outcome is Outcome.NONE
    tracked = solve_centroids(
        centroids,
        CAMERA,
        _bank(),
        PARAMETERS,
        mode=Mode.TRACKING,
        hint=AttitudePrior.from_quaternion(quaternion_from_matrix(wrong_by_2_deg)),
    )
    assert tracked.outcome is Outcome.NONE
    assert "verified" in tracked.reason


def test_a_required_hint_must_be_given() -> None:
    """Assisted mode without a boresight and tracking without an attitude are rejected before matching."""
    centroids, rotation, _ = _solved_list(16)
    for mode, hint in ((Mode.ASSISTED, None), (Mode.TRACKING, None), (Mode.TRACKING, AttitudePrior(rotation[2]))):
        with pytest.raises(BadInput, match="needs a hint"):
            match_stars(centroids, CAMERA, _bank(), PARAMETERS, mode, hint)


def test_a_frame_of_another_camera_is_rejected() -> None:
    """A frame with a size other than the camera's is rejected."""
    with pytest.raises(BadInput, match="does not fit"):
        solve(np.zeros((1024, 512), np.uint8), CAMERA, _bank(), PARAMETERS)


def test_a_bank_without_pairs_matches_nothing() -> None:
    """A catalogue of one star, without pairs, gives none without an error."""
    stars = _stars(3.8).take(np.array([0]))
    table = distance_table(stars, 0.0, 1.0)
    bank = OnboardCatalogue(stars.hip, stars.icrs.astype(np.float32), stars.v_mag, table)
    centroids, _, _ = _solved_list(17)
    assert solve_centroids(centroids, CAMERA, bank, PARAMETERS).outcome is Outcome.NONE


def test_the_distortion_correction_of_the_document_is_approximate() -> None:
    """Inverting the signs of the toolbox's coefficients is accurate in the middle and wrong by tens of pixels in the
    corners of this wide-angle lens.
    """
    approximate = replace(CAMERA, distortion=document_distortion(CAMERA))

    def error_px(camera: Camera, pixels: Array) -> Array:
        """Return the error in pixels of the ideal image."""
        approximate_direction = camera.unproject(pixels)
        exact_direction = CAMERA.unproject(pixels)
        return (
            np.linalg.norm(
                approximate_direction[:, :2] / approximate_direction[:, 2:]
                - exact_direction[:, :2] / exact_direction[:, 2:],
                axis=1,
            )
            * CAMERA.focal_col_px
        )

    middle = np.array([[511.5, 255.5], [540, 270]])
    corners = np.array([[0.0, 0], [1023, 0], [0, 511], [1023, 511]])
    assert error_px(approximate, middle).max() < 0.02
    assert 5 < error_px(approximate, corners).max() < 60
    with pytest.raises(BadInput, match="Brown"):
        document_distortion(shipped_camera("sunsat").camera)


def test_the_distortion_correction_of_the_document_reduces_the_solved_share() -> None:
    """With the approximate correction, clearly fewer lists are solved than with the exact inverse, but no attitude is
    wrong.
    """
    rng = np.random.default_rng(31)
    parameters = replace(PARAMETERS, undistort="document")
    exact, approximate = 0, 0
    for _ in range(60):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 0)
        exact += solve_centroids(centroids, CAMERA, _bank(), PARAMETERS).outcome is Outcome.SOLVED
        assessment = assess(solve_centroids(centroids, CAMERA, _bank(), parameters), truth, CAMERA)
        approximate += not np.isnan(assessment.cross_rad)
        assert not assessment.cross_rad > 3 * CAMERA.pixel_rad
    assert 0.3 * exact < approximate < 0.85 * exact
