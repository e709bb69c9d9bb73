"""The Sunsat chain as a whole: statistics with the real catalogue, where no answer may be wrong, and what must fail."""

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
    """V ≤ 6 through the on-board format and back, as the device has it."""
    stars = _stars(6.0)
    table = distance_table(stars, np.radians(0.25), CAMERA.diagonal_rad)
    return decode(encode(stars, table, "sunsat", "sunsat"), stars.hip)


@lru_cache
def _catalogue() -> SunsatCatalogue:
    return CHAIN.prepare(_bank(), PROFILE)


def _work(mode: Mode = Mode.LOST_IN_SPACE, hint: AttitudePrior | None = None) -> Work:
    return Work(CAMERA, _catalogue(), PARAMETERS, mode, hint)


def _list(rng: np.random.Generator, rotation: Array, false: int, noise_px: float = 0.2) -> tuple[Centroids, Truth]:
    """Centroids of all catalogue stars in the frame with noise of place and 0.2 mag (§6.3), and false ones."""
    truth = truth_of(stars_near(_stars(6.0), CAMERA, rotation), CAMERA, rotation)
    seen = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((-0.5, -0.5), (CAMERA.columns - 0.5, CAMERA.rows - 0.5), (false, 2))
    v_mag = np.concatenate([truth.v_mag + 0.2 * rng.normal(size=len(seen)), rng.uniform(2.5, 6, false)])
    order = np.argsort(v_mag, kind="stable")
    pixels = np.vstack([seen, spurious])[order]
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


def _false_names(result: SolveResult, truth: Truth) -> int:
    """False ones among all matches, those without weight too."""
    if result.matches is None:
        return 0
    everyone = replace(result.matches, weight=np.ones(len(result.matches)))
    return assess(replace(result, matches=everyone), truth, CAMERA).false_matches


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Boresight up to 2° off for assisted (§3.5), attitude up to 0.3° off per axis for tracking."""
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


# Solved per cent of lists at least: what 800 trials gave, less three standard deviations of a sample of 80.
EXPECTED_PERCENT = {
    Mode.LOST_IN_SPACE: {0: 91, 1: 91, 5: 88, 10: 88},
    Mode.ASSISTED: {0: 92, 1: 92, 5: 91, 10: 88},
    Mode.TRACKING: {0: 92, 1: 92, 5: 92, 10: 91},
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("false", [0, 1, 5, 10])
def test_star_lists_are_solved_and_never_wrongly(mode: Mode, false: int, trials: Any) -> None:
    """Random attitudes, 0.2 px and 0.2 mag of noise: no wrong answer and no false name, the expected share solved."""
    rng = np.random.default_rng(1000 + false)
    verdicts: Counter[str] = Counter()
    names = 0
    for _ in range(trials(80)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, false)
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
        names += _false_names(result, truth)
    assert verdicts["wrong"] == 0
    assert names == 0
    solved = verdicts.total() - verdicts["none"]
    assert solved >= trials.least(EXPECTED_PERCENT[mode][false], 100)
    assert verdicts["correct"] >= trials.least(93, 100, of=solved)


@pytest.mark.parametrize(
    ("mode", "false", "least"),
    [(Mode.LOST_IN_SPACE, 0, 36), (Mode.LOST_IN_SPACE, 5, 34), (Mode.ASSISTED, 5, 36), (Mode.TRACKING, 10, 37)],
)
def test_rendered_frames_are_solved_and_never_wrongly(mode: Mode, false: int, least: int, trials: Any) -> None:
    """Rendered frames with all stars to V 7.5, noise and false stars: none wrong, at least ``least`` solved."""
    rng = np.random.default_rng(70 + false)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(40)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        spots = [FalseStar(*rng.uniform((5, 5), (746, 576)), v_mag=rng.uniform(2.5, 6)) for _ in range(false)]
        frame = render(_stars(7.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=spots)
        result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
        assert _false_names(result, frame.truth) == 0
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(least, 40)


@pytest.mark.parametrize(("ra", "dec"), [(0.0, 0.2), (2 * np.pi - 1e-4, -0.7), (1.0, np.pi / 2), (2.0, -np.pi / 2)])
@pytest.mark.parametrize("mode", MODES)
def test_poles_and_right_ascension_zero_are_nothing_special(mode: Mode, ra: float, dec: float) -> None:
    """A field over a pole or across RA 0 is solved in every mode."""
    rng = np.random.default_rng(3)
    rotation = cam_from_icrs(ra, dec, 0.4)
    frame = render(_stars(7.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng)
    result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
    assert assess(result, frame.truth, CAMERA).verdict.value in ("correct", "imprecise")


@pytest.mark.parametrize("mode", MODES)
def test_mirrored_skies_give_none(mode: Mode, trials: Any) -> None:
    """Lists with the columns reversed: never an attitude, symmetrical constellations included."""
    rng = np.random.default_rng(9)
    for _ in range(trials(100)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _list(rng, rotation, 0)
        mirrored = replace(centroids, col_px=CAMERA.columns - 1 - centroids.col_px)
        result = _solve_list(mirrored, _work(mode, _hint(rng, rotation, mode)))
        assert result.attitude is None
        assert result.reason


@pytest.mark.parametrize("mode", MODES)
def test_pure_noise_is_never_solved(mode: Mode, trials: Any) -> None:
    """Twenty random centroids never give an attitude."""
    rng = np.random.default_rng(66)
    for _ in range(trials(100)):
        flux = brightness_dn(np.sort(rng.uniform(2.5, 6, 20)), PARAMETERS)
        centroids = Centroids.from_pixels(rng.uniform((0, 0), (751, 581), (20, 2)), flux)
        rotation = matrix_from_quaternion(random_quaternion(rng))
        assert _solve_list(centroids, _work(mode, _hint(rng, rotation, mode))).attitude is None


def test_an_error_of_half_a_magnitude_gives_no_wrong_answer() -> None:
    """All magnitudes 0.5 too faint: fewer solutions, none wrong."""
    rng = np.random.default_rng(12)
    solved = 0
    for _ in range(60):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 1)
        result = _solve_list(replace(centroids, flux_dn=centroids.flux_dn * 10**-0.2), _work())
        solved += result.attitude is not None
        assert assess(result, truth, CAMERA).verdict.value != "wrong"
        assert _false_names(result, truth) == 0
    assert solved >= 30


def test_frames_without_usable_stars_give_none_with_a_reason() -> None:
    """Blank, saturated, noisy, striped and Moon-lit frames have no solution and a reason, in every mode."""
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
    """The same sky through a lens of double the focal length is not identified, and another format is refused."""
    rng = np.random.default_rng(13)
    other = Camera.from_fov(752, 582, np.radians(5.6))
    for _ in range(10):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(7.5), other, SENSOR, rotation, SENSOR.exposure_s, rng)
        assert solve(CHAIN, frame.pixels, _work()).attitude is None
    with pytest.raises(BadInput, match="does not fit"):
        solve(CHAIN, np.zeros((512, 1024), np.uint8), _work())


@pytest.mark.parametrize(("camera", "limit_mag"), [("cubestar", 4.2), ("oersted", 4.5)])
def test_the_chain_runs_on_other_cameras(camera: str, limit_mag: float) -> None:
    """With a bank in its format the chain solves frames of other systems' cameras, none wrongly."""
    known = shipped_camera(camera)
    stars = _stars(6.0).brighter_than(limit_mag)
    table = distance_table(stars, np.radians(0.25), known.camera.diagonal_rad)
    catalogue = CHAIN.prepare(decode(encode(stars, table, "sunsat", camera), stars.hip), known)
    work = Work(known.camera, catalogue, CHAIN.parameters(known, None, Commanded(), Mode.LOST_IN_SPACE))
    rng = np.random.default_rng(2)
    verdicts: Counter[str] = Counter()
    for _ in range(8):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(6.0), known.camera, known.sensor, rotation, known.sensor.exposure_s, rng)
        verdicts[assess(solve(CHAIN, frame.pixels, work), frame.truth, known.camera).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts["none"] <= 2


def test_missing_stars_give_no_wrong_answer() -> None:
    """With a third of the stars missing at random most lists are still solved, none wrongly."""
    rng = np.random.default_rng(21)
    solved = 0
    for _ in range(60):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 2)
        result = _solve_list(centroids.take(rng.random(len(centroids)) > 1 / 3), _work())
        solved += result.attitude is not None
        assert assess(result, truth, CAMERA).verdict.value != "wrong"
        assert _false_names(result, truth) == 0
    assert solved >= 40


def test_the_same_frame_gives_identical_bits() -> None:
    """Two runs agree in every bit, with and without a clock, in every mode, and so do the steps the device offers."""
    rng = np.random.default_rng(8)
    frame = render(_stars(7.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng).pixels
    for mode in MODES:
        work = _work(mode, _hint(rng, ORION, mode))
        ticks = iter(range(100))
        a = solve(CHAIN, frame, work)
        b = solve(CHAIN, frame.copy(), replace(work), clock=lambda ticks=ticks: float(next(ticks)))  # type: ignore[misc]
        detection = CHAIN.find_centroids(frame, work)
        matching = CHAIN.match_stars(detection.centroids, work)
        steps = CHAIN.calculate_attitude(matching, detection.centroids, work)
        assert a.attitude is not None
        assert b.attitude is not None
        assert steps.attitude is not None
        for other in (b.attitude, steps.attitude):
            assert a.attitude.quaternion.tobytes() == other.quaternion.tobytes()
            assert a.attitude.covariance_rad2.tobytes() == other.covariance_rad2.tobytes()
        assert a.centroids.pixels.tobytes() == b.centroids.pixels.tobytes()
        assert (a.regions, a.timing_s) == (b.regions, {})
        assert CHAIN.detect_ms(frame.size, detection) > 0
        assert CHAIN.match_ms(matching) > 0
        assert CHAIN.attitude_ms(matching) > 0
        assert 0 < matching.confidence <= 1


def test_rotating_the_sky_rotates_the_attitude() -> None:
    """With the whole catalogue turned the same centroids give the attitude turned back, with the same names."""
    rng = np.random.default_rng(5)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, _ = _list(rng, rotation, 2)
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
    # float32 right ascensions of the bank differ by 2e-7 rad
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ turn, before.attitude.cam_from_icrs) < 1e-5


def test_triad_meets_the_better_star_and_its_covariance_is_the_scatter() -> None:
    """Over 4 000 noisy pairs the rotation errors have the covariance that the formula says, on every axis."""
    rng = np.random.default_rng(6)
    b = CAMERA.unproject(np.array([[100.0, 80.0], [600.0, 500.0]]))
    sigma = np.array([5e-5, 9e-5])
    errors = []
    for _ in range(4000):
        seen = b + sigma[:, None] * rng.normal(size=(2, 3))
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        m = triad(seen, b)
        errors.append([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    scatter = np.cov(np.array(errors).T / 2)
    expected = triad_covariance_rad2(b[0], b[1], *sigma)
    np.testing.assert_allclose(
        scatter / np.sqrt(np.outer(np.diag(expected), np.diag(expected))),
        expected / np.sqrt(np.outer(np.diag(expected), np.diag(expected))),
        atol=0.08,
    )


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_stars_are_reported(n: int) -> None:
    """Below three stars there is no attitude, and the reason counts them."""
    centroids, _ = _list(np.random.default_rng(9), ORION, 0)
    result = _solve_list(centroids.take(np.arange(n)), _work())
    assert result.attitude is None
    assert result.reason == f"{n or 'no'} star{'' if n == 1 else 's'} found in the frame; 3 needed"


def test_a_wrong_hint_gives_no_attitude() -> None:
    """A boresight hint 40° off ends as none; one beyond the allowed 2° too; no hint is refused."""
    centroids, _ = _list(np.random.default_rng(9), ORION, 0)
    for degrees in (2.5, 40.0):
        wrong = rotation_from_vector(np.array([np.radians(degrees), 0, 0])) @ ORION
        assert _solve_list(centroids, _work(Mode.ASSISTED, AttitudePrior(wrong[2]))).attitude is None
    right = _solve_list(centroids, _work(Mode.ASSISTED, AttitudePrior(ORION[2])))
    assert right.attitude is not None
    with pytest.raises(BadInput, match="assisted needs a hint"):
        _solve_list(centroids, _work(Mode.ASSISTED))


def test_star_vectors_can_be_chosen() -> None:
    """The alternative names the stars of a clean list as match groups do, and gives none with a false star among them."""
    rng = np.random.default_rng(17)
    centroids, truth = _list(rng, ORION, 0, 0.05)
    work = replace(_work(), parameters=replace(PARAMETERS, matcher="star_vectors", max_rounds=1))
    assert assess(_solve_list(centroids, work), truth, CAMERA).verdict.value in ("correct", "imprecise")
    centroids = centroids.take(np.arange(8))
    moved = replace(centroids, col_px=centroids.col_px + 30.0 * (np.arange(8) == 2))
    assert _solve_list(moved, work).attitude is None


def test_the_documents_acceptance_can_be_chosen() -> None:
    """With the largest group as the only test three lone stars are solved that the bound refuses."""
    rng = np.random.default_rng(18)
    refused = 0
    for _ in range(40):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 0)
        three = centroids.take(np.arange(min(3, len(centroids))))
        strict = _solve_list(three, _work())
        lenient = _solve_list(three, replace(_work(), parameters=DOCUMENT))
        assert assess(strict, truth, CAMERA).verdict.value != "wrong"
        refused += strict.attitude is None and lenient.attitude is not None
    assert refused >= 5


def test_a_bank_without_magnitudes_is_refused() -> None:
    """CubeStar's format holds no magnitudes; preparing it says what is needed. An empty bank gives none."""
    stars = _stars(3.0)
    image = encode(stars, distance_table(stars, 0.0, 0.2), "cubestar", "cubestar")
    with pytest.raises(BadInput, match="magnitudes"):
        CHAIN.prepare(decode(image, stars.hip), PROFILE)


def test_the_chain_is_registered() -> None:
    """The systems know it by its name, and a solved frame leads to tracking."""
    assert system("sunsat").name == "sunsat"
    assert system("sunsat").next_mode(Mode.LOST_IN_SPACE, True) is Mode.TRACKING


def test_trace_contains_the_intermediate_steps() -> None:
    """A trace lent by the caller holds detection and matching, with pairs, rivals and measured magnitudes."""
    trace = Trace()
    frame = render(_stars(7.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, np.random.default_rng(8)).pixels
    result = solve(CHAIN, frame, _work(), trace=trace)
    matching = trace.kept["matching"]
    assert result.attitude is not None
    assert matching.pairs > 0  # type: ignore[attr-defined]
    assert np.all(np.abs(matching.v_mag - 4) < 3)  # type: ignore[attr-defined]
