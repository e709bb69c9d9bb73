"""The complete Sunsat chain: statistics with the real catalogue, in which no solution may be wrong, and frames that
must not be solved.
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
from gss.domain.camera import Camera
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
from gss.pipeline.attitude import triad
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.sunsat import triad_covariance_rad2
from gss.pipeline.chains.sunsat_detect import brightness_dn
from gss.pipeline.chains.sunsat_match import SunsatCatalogue
from gss.pipeline.chains.sunsat_onboard import SunsatChain
from gss.pipeline.chains.systems import system
from gss.pipeline.render import FalseStar, render, stars_near, truth_of
from gss.pipeline.score import assess
from gss.pipeline.trace import Trace
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table

PROFILE = shipped_camera("sunsat")
CAMERA, SENSOR = PROFILE.camera, PROFILE.sensor
CHAIN = SunsatChain()
PARAMETERS = CHAIN.parameters(PROFILE, None, Commanded(), Mode.LOST_IN_SPACE)
DOCUMENT = replace(PARAMETERS, acceptance="document")
ORION = cam_from_icrs(np.radians(84.0), 0.0, 0.5)
MODES = [Mode.LOST_IN_SPACE, Mode.ASSISTED, Mode.TRACKING]


@lru_cache
def _stars(v_max: float) -> StarTable:
    return load_stars(v_max)


@lru_cache
def _bank() -> OnboardCatalogue:
    """Return the stars to V 6, encoded in the on-board format and decoded, as on the device."""
    stars = _stars(6.0)
    table = distance_table(stars, np.radians(0.25), CAMERA.diagonal_rad)
    return decode(encode(stars, table, "sunsat", "sunsat"), stars.hip)


@lru_cache
def _catalogue() -> SunsatCatalogue:
    return CHAIN.prepare(_bank(), PROFILE)


def _work(mode: Mode = Mode.LOST_IN_SPACE, hint: AttitudePrior | None = None) -> Work:
    return Work(CAMERA, _catalogue(), PARAMETERS, mode, hint)


def _star_list(
    rng: np.random.Generator, rotation: Array, false_count: int, noise_px: float = 0.2
) -> tuple[Centroids, Truth]:
    """Return centroids of all catalogue stars in the frame with noise of position and of 0.2 mag (§6.3), and of false
    stars, brightest first.
    """
    truth = truth_of(stars_near(_stars(6.0), CAMERA, rotation), CAMERA, rotation)
    measured = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((-0.5, -0.5), (CAMERA.columns - 0.5, CAMERA.rows - 0.5), (false_count, 2))
    v_mag = np.concatenate([truth.v_mag + 0.2 * rng.normal(size=len(measured)), rng.uniform(2.5, 6, false_count)])
    order = np.argsort(v_mag, kind="stable")
    pixels = np.vstack([measured, spurious])[order]
    return Centroids.from_pixels(pixels, brightness_dn(v_mag[order], PARAMETERS), noise_px), truth


def _solve_list(centroids: Centroids, work: Work) -> SolveResult:
    matching = CHAIN.match_stars(centroids, work)
    solution = CHAIN.calculate_attitude(matching, centroids, work)
    outcome = Outcome.NONE if solution.attitude is None else Outcome.SOLVED
    return SolveResult(
        "sunsat",
        outcome,
        solution.reason,
        CAMERA,
        (),
        centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
    )


def _false_matches(result: SolveResult, truth: Truth) -> int:
    """Return the number of false matches, including those with weight zero."""
    if result.matches is None:
        return 0
    equal_weights = replace(result.matches, weight=np.ones(len(result.matches)))
    return assess(replace(result, matches=equal_weights), truth, CAMERA).false_matches


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Return a boresight with an error of up to 2° (assisted, §3.5) or an attitude with an error of up to 0.3° per axis
    (tracking).
    """
    if mode is Mode.LOST_IN_SPACE:
        return None
    if mode is Mode.TRACKING:
        return AttitudePrior.from_quaternion(
            quaternion_from_matrix(rotation_from_vector(np.radians(rng.uniform(-0.3, 0.3, 3))) @ rotation)
        )
    axis = rng.normal(size=3)
    axis -= axis @ rotation[2] * rotation[2]
    angle = np.radians(2) * rng.random()
    return AttitudePrior(np.cos(angle) * rotation[2] + np.sin(angle) * axis / np.linalg.norm(axis))


# Minimum percentage of solved lists, by number of false stars: the result of 800 trials less three standard deviations
# of a sample of 80.
EXPECTED_PERCENT = {
    Mode.LOST_IN_SPACE: {0: 91, 1: 91, 5: 88, 10: 88},
    Mode.ASSISTED: {0: 92, 1: 92, 5: 91, 10: 88},
    Mode.TRACKING: {0: 92, 1: 92, 5: 92, 10: 91},
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("false_count", [0, 1, 5, 10])
def test_star_lists_are_solved_and_never_wrongly(mode: Mode, false_count: int, trials: Any) -> None:
    """For random attitudes with noise of 0.2 px and 0.2 mag, no solution and no match is wrong, and at least the stated
    share is solved.
    """
    rng = np.random.default_rng(1000 + false_count)
    verdicts: Counter[str] = Counter()
    false_matches = 0
    for _ in range(trials(80)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, false_count)
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
        false_matches += _false_matches(result, truth)
    assert verdicts["wrong"] == 0
    assert false_matches == 0
    solved = verdicts.total() - verdicts["none"]
    assert solved >= trials.least(EXPECTED_PERCENT[mode][false_count], 100)
    assert verdicts["correct"] >= trials.least(93, 100, of=solved)


@pytest.mark.parametrize(
    ("mode", "false_count", "min_solved"),
    [(Mode.LOST_IN_SPACE, 0, 36), (Mode.LOST_IN_SPACE, 5, 34), (Mode.ASSISTED, 5, 36), (Mode.TRACKING, 10, 37)],
)
def test_rendered_frames_are_solved_and_never_wrongly(
    mode: Mode, false_count: int, min_solved: int, trials: Any
) -> None:
    """Of rendered frames with all stars to V 7.5, noise and false stars, none is solved wrongly and at least
    ``min_solved`` of 40 are solved.
    """
    rng = np.random.default_rng(70 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(40)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        spots = [FalseStar(*rng.uniform((5, 5), (746, 576)), v_mag=rng.uniform(2.5, 6)) for _ in range(false_count)]
        frame = render(_stars(7.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=spots)
        result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
        assert _false_matches(result, frame.truth) == 0
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(min_solved, 40)


@pytest.mark.parametrize(("ra", "dec"), [(0.0, 0.2), (2 * np.pi - 1e-4, -0.7), (1.0, np.pi / 2), (2.0, -np.pi / 2)])
@pytest.mark.parametrize("mode", MODES)
def test_fields_at_poles_and_zero_right_ascension_are_solved(mode: Mode, ra: float, dec: float) -> None:
    """Fields at the poles and across right ascension 0 are solved in every mode."""
    rng = np.random.default_rng(3)
    rotation = cam_from_icrs(ra, dec, 0.4)
    frame = render(_stars(7.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng)
    result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
    assert assess(result, frame.truth, CAMERA).verdict.value in ("correct", "imprecise")


@pytest.mark.parametrize("mode", MODES)
def test_mirrored_lists_give_none(mode: Mode, trials: Any) -> None:
    """Lists with reversed columns never give an attitude, even if a constellation is symmetrical."""
    rng = np.random.default_rng(9)
    for _ in range(trials(100)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _star_list(rng, rotation, 0)
        mirrored = replace(centroids, col_px=CAMERA.columns - 1 - centroids.col_px)
        result = _solve_list(mirrored, _work(mode, _hint(rng, rotation, mode)))
        assert result.attitude is None
        assert result.reason


@pytest.mark.parametrize("mode", MODES)
def test_pure_noise_is_never_solved(mode: Mode, trials: Any) -> None:
    """Twenty random centroids never give an attitude, in any mode."""
    rng = np.random.default_rng(66)
    for _ in range(trials(100)):
        flux = brightness_dn(np.sort(rng.uniform(2.5, 6, 20)), PARAMETERS)
        centroids = Centroids.from_pixels(rng.uniform((0, 0), (751, 581), (20, 2)), flux)
        rotation = matrix_from_quaternion(random_quaternion(rng))
        assert _solve_list(centroids, _work(mode, _hint(rng, rotation, mode))).attitude is None


def test_an_error_of_half_a_magnitude_gives_no_wrong_solution() -> None:
    """If all magnitudes are 0.5 too faint, at least half of the lists are solved, none wrongly."""
    rng = np.random.default_rng(12)
    solved = 0
    for _ in range(60):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 1)
        result = _solve_list(replace(centroids, flux_dn=centroids.flux_dn * 10**-0.2), _work())
        solved += result.attitude is not None
        assert assess(result, truth, CAMERA).verdict.value != "wrong"
        assert _false_matches(result, truth) == 0
    assert solved >= 30


def test_frames_without_usable_stars_give_none_with_a_reason() -> None:
    """Blank, saturated, noisy, striped and Moon-lit frames give no attitude and a reason, in every mode."""
    rng = np.random.default_rng(12)
    dark = np.full((582, 752), 12, np.uint8)
    moon, stripes = dark.copy(), dark.copy()
    row, col = np.indices(moon.shape)
    moon[(row - 200) ** 2 + (col - 300) ** 2 < 40**2] = 255
    stripes[::9] = 200
    frames = {
        "blank": np.zeros_like(dark),
        "dark": dark,
        "saturated": np.full_like(dark, 255),
        "noise": rng.integers(0, 256, dark.shape).astype(np.uint8),
        "sparse noise": np.where(rng.random(dark.shape) < 0.2, 200, 12).astype(np.uint8),
        "stripes": stripes,
        "moon": moon,
    }
    for name, frame in frames.items():
        for mode in MODES:
            result = solve(CHAIN, frame, _work(mode, _hint(rng, ORION, mode)))
            assert result.attitude is None, (name, mode)
            assert result.reason, (name, mode)


def test_frames_of_another_camera_give_none() -> None:
    """The sky through a lens of twice the focal length is not identified. A frame of another size is rejected."""
    rng = np.random.default_rng(13)
    other = Camera.from_fov(752, 582, np.radians(5.6))
    for _ in range(10):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(7.5), other, SENSOR, rotation, SENSOR.exposure_s, rng)
        assert solve(CHAIN, frame.pixels, _work()).attitude is None
    with pytest.raises(BadInput, match="does not fit"):
        solve(CHAIN, np.zeros((512, 1024), np.uint8), _work())


@pytest.mark.parametrize(("camera", "limit_mag"), [("cubestar", 4.2), ("oersted", 4.5)])
def test_the_chain_supports_other_cameras(camera: str, limit_mag: float) -> None:
    """With a bank in its format, the chain solves frames of the cameras of other systems, none wrongly."""
    profile = shipped_camera(camera)
    stars = _stars(6.0).brighter_than(limit_mag)
    table = distance_table(stars, np.radians(0.25), profile.camera.diagonal_rad)
    catalogue = CHAIN.prepare(decode(encode(stars, table, "sunsat", camera), stars.hip), profile)
    work = Work(profile.camera, catalogue, CHAIN.parameters(profile, None, Commanded(), Mode.LOST_IN_SPACE))
    rng = np.random.default_rng(2)
    verdicts: Counter[str] = Counter()
    for _ in range(8):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(6.0), profile.camera, profile.sensor, rotation, profile.sensor.exposure_s, rng)
        verdicts[assess(solve(CHAIN, frame.pixels, work), frame.truth, profile.camera).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts["none"] <= 2


def test_missing_stars_give_no_wrong_solution() -> None:
    """If a random third of the stars is missing, most lists are solved, none wrongly."""
    rng = np.random.default_rng(21)
    solved = 0
    for _ in range(60):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 2)
        result = _solve_list(centroids.take(rng.random(len(centroids)) > 1 / 3), _work())
        solved += result.attitude is not None
        assert assess(result, truth, CAMERA).verdict.value != "wrong"
        assert _false_matches(result, truth) == 0
    assert solved >= 40


def test_the_same_frame_gives_identical_bits() -> None:
    """Two runs, with and without a clock, and the single steps that the device runs give identical bits in every mode."""
    rng = np.random.default_rng(8)
    frame = render(_stars(7.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng).pixels
    for mode in MODES:
        work = _work(mode, _hint(rng, ORION, mode))
        ticks = iter(range(100))
        first = solve(CHAIN, frame, work)
        second = solve(CHAIN, frame.copy(), replace(work), clock=lambda ticks=ticks: float(next(ticks)))  # type: ignore[misc]
        detection = CHAIN.find_centroids(frame, work)
        matching = CHAIN.match_stars(detection.centroids, work)
        steps = CHAIN.calculate_attitude(matching, detection.centroids, work)
        assert first.attitude is not None
        assert second.attitude is not None
        assert steps.attitude is not None
        for other in (second.attitude, steps.attitude):
            assert first.attitude.quaternion.tobytes() == other.quaternion.tobytes()
            assert first.attitude.covariance_rad2.tobytes() == other.covariance_rad2.tobytes()
        assert first.centroids.pixels.tobytes() == second.centroids.pixels.tobytes()
        assert (first.regions, first.timing_s) == (second.regions, {})
        assert CHAIN.detect_ms(frame.size, detection) > 0
        assert CHAIN.match_ms(matching) > 0
        assert CHAIN.attitude_ms(matching) > 0
        assert 0 < matching.confidence <= 1


def test_rotating_the_sky_rotates_the_attitude() -> None:
    """If the catalogue is rotated, the same centroids give the same matches and the attitude rotated accordingly."""
    rng = np.random.default_rng(5)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, _ = _star_list(rng, rotation, 2)
    before = _solve_list(centroids, _work())
    turn = matrix_from_quaternion(random_quaternion(rng))
    stars = replace(_stars(6.0), icrs=_stars(6.0).icrs @ turn.T)
    table = distance_table(stars, np.radians(0.25), CAMERA.diagonal_rad)
    bank = decode(encode(stars, table, "sunsat", "sunsat"), stars.hip)
    after = _solve_list(centroids, replace(_work(), catalogue=CHAIN.prepare(bank, PROFILE)))
    assert before.attitude is not None
    assert after.attitude is not None
    assert before.matches is not None
    assert after.matches is not None
    assert set(after.matches.hip.tolist()) == set(before.matches.hip.tolist())
    # The bank stores float32 right ascensions, which are rounded by 2e-7 rad.
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ turn, before.attitude.cam_from_icrs) < 1e-5


def test_triad_covariance_agrees_with_the_scatter() -> None:
    """Over 4 000 noisy pairs, the rotation errors about all axes agree with the covariance of the formula."""
    rng = np.random.default_rng(6)
    b = CAMERA.unproject(np.array([[100.0, 80.0], [600.0, 500.0]]))
    sigma = np.array([5e-5, 9e-5])
    errors = []
    for _ in range(4000):
        measured = b + sigma[:, None] * rng.normal(size=(2, 3))
        measured /= np.linalg.norm(measured, axis=1, keepdims=True)
        error_matrix = triad(measured, b)
        errors.append(
            [
                error_matrix[2, 1] - error_matrix[1, 2],
                error_matrix[0, 2] - error_matrix[2, 0],
                error_matrix[1, 0] - error_matrix[0, 1],
            ]
        )
    scatter = np.cov(np.array(errors).T / 2)
    expected = triad_covariance_rad2(b[0], b[1], *sigma)
    np.testing.assert_allclose(
        scatter / np.sqrt(np.outer(np.diag(expected), np.diag(expected))),
        expected / np.sqrt(np.outer(np.diag(expected), np.diag(expected))),
        atol=0.08,
    )


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_stars_are_reported(n: int) -> None:
    """Fewer than three stars give no attitude, and the reason states their number."""
    centroids, _ = _star_list(np.random.default_rng(9), ORION, 0)
    result = _solve_list(centroids.take(np.arange(n)), _work())
    assert result.attitude is None
    assert result.reason == f"{n or 'no'} star{'' if n == 1 else 's'} found in the frame; 3 needed"


def test_a_wrong_hint_gives_no_attitude() -> None:
    """A boresight hint wrong by more than the permitted 2° gives none. A missing hint is rejected."""
    centroids, _ = _star_list(np.random.default_rng(9), ORION, 0)
    for degrees in (2.5, 40.0):
        wrong_attitude = rotation_from_vector(np.array([np.radians(degrees), 0, 0])) @ ORION
        assert _solve_list(centroids, _work(Mode.ASSISTED, AttitudePrior(wrong_attitude[2]))).attitude is None
    with_true_hint = _solve_list(centroids, _work(Mode.ASSISTED, AttitudePrior(ORION[2])))
    assert with_true_hint.attitude is not None
    with pytest.raises(BadInput, match="assisted needs a hint"):
        _solve_list(centroids, _work(Mode.ASSISTED))


def test_the_star_vector_matcher_can_be_selected() -> None:
    """The star-vector matcher solves a list without false stars, and gives none if one star is at a wrong position."""
    rng = np.random.default_rng(17)
    centroids, truth = _star_list(rng, ORION, 0, 0.05)
    work = replace(_work(), parameters=replace(PARAMETERS, matcher="star_vectors", max_rounds=1))
    assert assess(_solve_list(centroids, work), truth, CAMERA).verdict.value in ("correct", "imprecise")
    centroids = centroids.take(np.arange(8))
    one_wrong = replace(centroids, col_px=centroids.col_px + 30.0 * (np.arange(8) == 2))
    assert _solve_list(one_wrong, work).attitude is None


def test_the_document_acceptance_rule_can_be_selected() -> None:
    """The document's rule, which tests only the largest group, solves lists of three stars that the false-match bound
    rejects.
    """
    rng = np.random.default_rng(18)
    rejected = 0
    for _ in range(40):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 0)
        three_stars = centroids.take(np.arange(min(3, len(centroids))))
        with_bound = _solve_list(three_stars, _work())
        with_document_rule = _solve_list(three_stars, replace(_work(), parameters=DOCUMENT))
        assert assess(with_bound, truth, CAMERA).verdict.value != "wrong"
        rejected += with_bound.attitude is None and with_document_rule.attitude is not None
    assert rejected >= 5


def test_a_bank_without_magnitudes_is_rejected() -> None:
    """A bank in CubeStar's format, which has no magnitudes, is rejected with a reason."""
    stars = _stars(3.0)
    image = encode(stars, distance_table(stars, 0.0, 0.2), "cubestar", "cubestar")
    with pytest.raises(BadInput, match="magnitudes"):
        CHAIN.prepare(decode(image, stars.hip), PROFILE)


def test_the_chain_is_registered() -> None:
    """The chain is registered under its name, and a solved frame leads to tracking."""
    assert system("sunsat").name == "sunsat"
    assert system("sunsat").next_mode(Mode.LOST_IN_SPACE, True) is Mode.TRACKING


def test_trace_contains_the_intermediate_steps() -> None:
    """The caller's trace contains detection and matching, with pairs and measured magnitudes."""
    trace = Trace()
    frame = render(_stars(7.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, np.random.default_rng(8)).pixels
    result = solve(CHAIN, frame, _work(), trace=trace)
    matching = trace.kept["matching"]
    assert result.attitude is not None
    assert matching.pairs > 0  # type: ignore[attr-defined]
    assert np.all(np.abs(matching.v_mag - 4) < 3)  # type: ignore[attr-defined]
