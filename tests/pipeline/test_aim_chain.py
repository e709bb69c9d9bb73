"""The AIM chain: statistics with the real catalogue, in which no solution may be wrong, and frames that must not be
solved.
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
from gss.pipeline.chains.aim import AimChain
from gss.pipeline.chains.aim_detect import OUTSIDE, WHOLE_IMAGE
from gss.pipeline.chains.aim_match import AimCatalogue, prepare
from gss.pipeline.chains.aim_parameters import SOURCES, default_parameters
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import system
from gss.pipeline.render import FalseStar, render, stars_near, truth_of
from gss.pipeline.score import assess
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table

CHAIN = AimChain()
PROFILE = shipped_camera("aim")
CAMERA, SENSOR = PROFILE.camera, PROFILE.sensor
PLEIADES = cam_from_icrs(np.radians(56.9), np.radians(24.1), 0.5)


@lru_cache
def _stars(v_max: float) -> StarTable:
    return load_stars(v_max)


@lru_cache
def _bank(v_max: float) -> OnboardCatalogue:
    """Encode a bank in the on-board format with magnitudes and decode it, so that it has float32 values as on a device."""
    stars = _stars(v_max)
    return decode(encode(stars, distance_table(stars, 0.0, 0.01), "sunsat", "aim"), stars.hip)


@lru_cache
def _catalogue(v_max: float) -> AimCatalogue:
    return CHAIN.prepare(_bank(v_max), PROFILE)


def _work(
    mode: Mode = Mode.LOST_IN_SPACE, hint: AttitudePrior | None = None, v_max: float = 7.5, **changes: object
) -> Work:
    parameters = replace(CHAIN.parameters(PROFILE, None, Commanded(), mode), **changes)  # type: ignore[arg-type]
    return Work(CAMERA, _catalogue(v_max), parameters, mode, hint)


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Return a boresight with an error of up to 4° (assisted) or an attitude with an error of up to 0.25° (tracking)."""
    if mode is Mode.LOST_IN_SPACE:
        return None
    axis = rng.normal(size=3)
    angle = np.radians(0.25 if mode is Mode.TRACKING else 4.0) * rng.random()
    with_error = rotation_from_vector(axis / np.linalg.norm(axis) * angle) @ rotation
    return (
        AttitudePrior.from_quaternion(quaternion_from_matrix(with_error))
        if mode is Mode.TRACKING
        else AttitudePrior(with_error[2])
    )


def _star_list(
    rng: np.random.Generator, rotation: Array, false_count: int, v_max: float = 7.5
) -> tuple[Centroids, Truth]:
    """Return all catalogue stars in the frame with noise of 0.05 px and 0.05 mag, and false stars, brightest first."""
    truth = truth_of(stars_near(_stars(v_max), CAMERA, rotation), CAMERA, rotation)
    measured = truth.pixels + 0.05 * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((2, 2), (CAMERA.columns - 3, CAMERA.rows - 3), (false_count, 2))
    mag = np.concatenate([truth.v_mag + 0.05 * rng.normal(size=len(measured)), rng.uniform(4, v_max, false_count)])
    order = np.argsort(mag, kind="stable")
    flux = default_parameters(PROFILE).dn_at_mag_0 * 10 ** (-0.4 * mag[order])
    return Centroids.from_pixels(np.vstack([measured, spurious])[order], flux, 0.05), truth


def _solve_list(centroids: Centroids, work: Work) -> SolveResult:
    solution = CHAIN.calculate_attitude(CHAIN.match_stars(centroids, work), centroids, work)
    outcome = Outcome.SOLVED if solution.attitude is not None else Outcome.NONE
    return SolveResult(
        "aim",
        outcome,
        solution.reason,
        CAMERA,
        (),
        centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
    )


# Minimum share of solved images in per cent, by number of false stars. Measured on 200 images with a list to V 7.5
# (8.5 stars per field): lost in space 85, 89, 87, 84; assisted 96, 95, 85, 92; tracking 98, 97, 92, 97. Measured with a
# list to V 6.5 (2.6 stars per field), without false stars: 21, 37 and 65.
LEAST = {
    (7.5, Mode.LOST_IN_SPACE): {0: 75, 1: 75, 5: 70, 10: 70},
    (7.5, Mode.ASSISTED): {0: 88, 1: 88, 5: 75, 10: 80},
    (7.5, Mode.TRACKING): {0: 92, 1: 92, 5: 82, 10: 90},
    (6.5, Mode.LOST_IN_SPACE): {0: 8, 1: 8, 5: 8, 10: 8},
    (6.5, Mode.ASSISTED): {0: 20, 1: 20, 5: 15, 10: 12},
    (6.5, Mode.TRACKING): {0: 45, 1: 40, 5: 28, 10: 28},
}


@pytest.mark.parametrize(("v_max", "mode"), list(LEAST))
@pytest.mark.parametrize("false_count", [0, 1, 5, 10])
def test_lists_are_solved_and_never_wrongly(v_max: float, mode: Mode, false_count: int, trials: Any) -> None:
    """For random attitudes, no solution is wrong, at least the stated share is solved, and 90 % of the solutions are
    correct within three sigma.
    """
    rng = np.random.default_rng(3000 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(60)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, false_count, v_max)
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode), v_max))
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
    solved = verdicts.total() - verdicts["none"]
    assert verdicts["wrong"] == 0
    assert solved >= trials.least(LEAST[v_max, mode][false_count], 100)
    assert verdicts["correct"] >= trials.least(90, 100, of=solved)


@pytest.mark.parametrize(
    ("mode", "false_count", "min_solved"),
    [(Mode.LOST_IN_SPACE, 0, 22), (Mode.LOST_IN_SPACE, 10, 18), (Mode.ASSISTED, 5, 21), (Mode.TRACKING, 10, 24)],
)
def test_frames_are_solved_and_never_wrongly(mode: Mode, false_count: int, min_solved: int, trials: Any) -> None:
    """Of rendered frames with all stars to V 8, noise and false stars, none is solved wrongly and at least
    ``min_solved`` of 30 are solved.
    """
    rng = np.random.default_rng(30 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(30)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        false_stars = [
            FalseStar(*rng.uniform((5, 5), (250, 250)), v_mag=rng.uniform(4, 7.5)) for _ in range(false_count)
        ]
        frame = render(_stars(8.0), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=false_stars)
        result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(min_solved, 30)


def test_pure_noise_lists_are_never_solved() -> None:
    """Three to twenty random centroids never give an attitude, whatever the mode and the hint."""
    rng = np.random.default_rng(66)
    for n in (3, 6, 12, 20):
        for _ in range(10):
            mag = np.sort(rng.uniform(4, 7.5, n))
            flux = default_parameters(PROFILE).dn_at_mag_0 * 10 ** (-0.4 * mag)
            centroids = Centroids.from_pixels(rng.uniform((0, 0), (255, 255), (n, 2)), flux, 0.05)
            hint = AttitudePrior.from_quaternion(random_quaternion(rng))
            for mode in Mode:
                result = _solve_list(centroids, _work(mode, hint))
                assert result.outcome is Outcome.NONE
                assert result.reason


def test_the_document_rule_accepts_random_spots() -> None:
    """The document's rule accepts two linked stars. Without the false-match bound, most lists of random spots are
    identified.
    """
    rng = np.random.default_rng(67)
    solved = 0
    for _ in range(10):
        flux = default_parameters(PROFILE).dn_at_mag_0 * 10 ** (-0.4 * np.sort(rng.uniform(4, 7.5, 12)))
        centroids = Centroids.from_pixels(rng.uniform((0, 0), (255, 255), (12, 2)), flux, 0.05)
        solved += _solve_list(centroids, _work(acceptance="document")).outcome is Outcome.SOLVED
    assert solved > 5


def _frame(rotation: Array, seed: int = 8, **options: object) -> tuple[np.ndarray, Truth]:
    """Render a frame with all stars to V 8. Returns its pixels and truth."""
    rng = np.random.default_rng(seed)
    rendered = render(_stars(8.0), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, **options)  # type: ignore[arg-type]
    return rendered.pixels, rendered.truth


def test_frames_without_usable_stars_give_none_with_a_reason() -> None:
    """Blank, saturated, noisy, striped, Moon-lit and mirrored frames give none with a reason, in every mode."""
    rng = np.random.default_rng(12)
    shape = (CAMERA.rows, CAMERA.columns)
    dark = np.full(shape, 55, np.uint16)
    moon, stripes = dark.copy(), dark.copy()
    row, col = np.indices(shape)
    moon[(row - 100) ** 2 + (col - 130) ** 2 < 36**2] = 4095
    stripes[::9] = 900
    frames = {
        "blank": np.zeros(shape, np.uint16),
        "saturated": np.full(shape, 4095, np.uint16),
        "noise": rng.integers(0, 4096, shape).astype(np.uint16),
        "sparse noise": np.where(rng.random(shape) < 0.2, 900, 55).astype(np.uint16),
        "stripes": stripes,
        "moon": moon,
        "mirror": _frame(PLEIADES)[0][:, ::-1].copy(),
    }
    hint = AttitudePrior.from_quaternion(quaternion_from_matrix(PLEIADES))
    for name, frame in frames.items():
        for mode in Mode:
            result = solve(CHAIN, frame, _work(mode, hint))
            assert result.outcome is Outcome.NONE, (name, mode)
            assert result.reason, name


@pytest.mark.parametrize(("ra_deg", "dec_deg"), [(0, 90), (123, -90), (0, 0), (359.99, 20), (0.01, 89.9), (180, -89.9)])
def test_poles_and_zero_right_ascension_are_not_special_cases(ra_deg: float, dec_deg: float) -> None:
    """Frames at the poles and at right ascension 0 are solved correctly or not at all, in every mode."""
    rotation = cam_from_icrs(np.radians(ra_deg), np.radians(dec_deg), 1.0)
    pixels, truth = _frame(rotation, 5)
    for mode in Mode:
        result = solve(CHAIN, pixels, _work(mode, AttitudePrior.from_quaternion(truth.quaternion)))
        assert assess(result, truth, CAMERA).verdict.value in ("correct", "none")


def test_the_same_frame_gives_identical_bits() -> None:
    """Two runs give identical bits, with and without a clock."""
    pixels, _ = _frame(PLEIADES)
    ticks = iter(range(100))
    first = solve(CHAIN, pixels, _work())
    second = solve(CHAIN, pixels.copy(), _work(), clock=lambda: float(next(ticks)))
    assert first.attitude is not None
    assert second.attitude is not None
    assert first.attitude.quaternion.tobytes() == second.attitude.quaternion.tobytes()
    assert first.centroids.pixels.tobytes() == second.centroids.pixels.tobytes()
    assert set(second.timing_s) == {"detect", "match", "attitude"}


def test_rotating_the_sky_rotates_the_attitude() -> None:
    """If all catalogue stars are rotated, the same centroids give the same matches and the attitude rotated
    accordingly.
    """
    rng = np.random.default_rng(5)
    centroids, _ = _star_list(rng, PLEIADES, 1)
    before = _solve_list(centroids, _work())
    rotation = matrix_from_quaternion(random_quaternion(rng))
    rotated_catalogue = prepare(replace(_bank(7.5), icrs=_bank(7.5).icrs @ rotation.T), PROFILE)
    after = _solve_list(centroids, replace(_work(), catalogue=rotated_catalogue))
    assert before.attitude is not None
    assert before.matches is not None
    assert after.attitude is not None
    assert after.matches is not None
    np.testing.assert_array_equal(after.matches.hip, before.matches.hip)
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ rotation, before.attitude.cam_from_icrs) < 1e-9


def test_only_predicted_windows_are_read_in_tracking() -> None:
    """A false star far from all predicted stars is not measured, and its region states the reason. No guidance error is
    raised.
    """
    pixels, truth = _frame(PLEIADES)
    rng = np.random.default_rng(3)
    star_px = truth.pixels[truth.v_mag < 8.0]
    while True:
        false_star_px = rng.uniform((10, 10), (245, 245))
        if np.abs(star_px - false_star_px).max(axis=1).min() > 30:
            break
    with_false_star, _ = _frame(PLEIADES, false_stars=[FalseStar(*false_star_px, v_mag=5.0)])
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(truth.quaternion))
    detection = CHAIN.find_centroids(with_false_star, work)
    assert any(r.rejected == OUTSIDE for r in detection.regions)
    assert np.linalg.norm(detection.centroids.pixels - false_star_px, axis=1).min() > 5
    matching = CHAIN.match_stars(detection.centroids, work)
    assert not matching.guidance_error
    assert matching.checks < 3000  # of 25 723 stars
    assert len(CHAIN.find_centroids(pixels, work).centroids) == len(detection.centroids)


def test_a_guidance_error_starts_a_search_of_the_whole_frame() -> None:
    """If the predicted attitude is wrong by 2°, no expected star is present. The guidance-error flag is set, the whole
    image is searched, and the attitude is found.
    """
    pixels, truth = _frame(PLEIADES)
    wrong_attitude = rotation_from_vector(np.radians([2.0, 0.0, 0.0])) @ PLEIADES
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(quaternion_from_matrix(wrong_attitude)))
    detection = CHAIN.find_centroids(pixels, work)
    matching = CHAIN.match_stars(detection.centroids, work)
    assert matching.guidance_error
    assert matching.mode is Mode.ASSISTED
    result = solve(CHAIN, pixels, work)
    assert assess(result, truth, CAMERA).verdict.value == "correct"
    empty = solve(CHAIN, np.full((256, 256), 55, np.uint16), work)
    assert empty.notes == (WHOLE_IMAGE,)


def test_attitude_of_a_rotating_camera_is_predicted() -> None:
    """If the camera rotates by 0.9° between frames, the last two attitudes predict the stars without a guidance error."""
    step = rotation_from_vector(np.radians(0.9) * np.array([0.6, 0.8, 0.0]))
    pixels, truth = _frame(step @ step @ PLEIADES)
    last, before = (quaternion_from_matrix(r) for r in (step @ PLEIADES, PLEIADES))
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(last, (before,)))
    detection = CHAIN.find_centroids(pixels, work)
    assert CHAIN.match_stars(detection.centroids, work).mode is Mode.TRACKING
    assert assess(solve(CHAIN, pixels, work), truth, CAMERA).verdict.value == "correct"


@pytest.mark.parametrize("window_px", [3, 4])
def test_both_window_sizes_measure_star_positions(window_px: int) -> None:
    """Windows of 3 x 3 and of the sensor's 4 x 4 pixels, with their bias correctors, measure stars of V 5 to 6.5 within
    a few hundredths of a pixel.
    """
    parameters = default_parameters(PROFILE, None, window_px)
    errors_px = []
    for seed in range(12):
        rotation = matrix_from_quaternion(random_quaternion(np.random.default_rng(seed)))
        pixels, truth = _frame(rotation, seed)
        centroids = CHAIN.find_centroids(pixels, Work(CAMERA, _catalogue(7.5), parameters)).centroids
        star_px = truth.pixels[(truth.v_mag > 5) & (truth.v_mag < 6.5) & CAMERA.contains(truth.pixels, 4)]
        errors_px.extend(np.linalg.norm(centroids.pixels - true_px, axis=1).min() for true_px in star_px)
    assert len(errors_px) > 10
    assert np.median(errors_px) < 0.035


def test_hints_are_required_and_wrong_hints_give_none() -> None:
    """Assisted and tracking modes need a hint; tracking needs a complete attitude. A hint wrong by 40° gives none."""
    centroids, _ = _star_list(np.random.default_rng(9), PLEIADES, 0)
    for mode, hint in ((Mode.ASSISTED, None), (Mode.TRACKING, None), (Mode.TRACKING, AttitudePrior(PLEIADES[2]))):
        with pytest.raises(BadInput, match="needs a hint"):
            CHAIN.match_stars(centroids, _work(mode, hint))
    wrong_attitude = rotation_from_vector(np.array([np.radians(40), 0, 0])) @ PLEIADES
    for mode in (Mode.ASSISTED, Mode.TRACKING):
        hint = AttitudePrior.from_quaternion(quaternion_from_matrix(wrong_attitude))
        assert _solve_list(centroids, _work(mode, hint)).outcome is Outcome.NONE


@pytest.mark.parametrize("n", range(4))
def test_few_stars_are_reported(n: int) -> None:
    """Up to three centroids give no attitude in lost-in-space mode. The reason states that there are no stars or that
    the field is too narrow.
    """
    centroids, _ = _star_list(np.random.default_rng(9), PLEIADES, 0)
    result = _solve_list(centroids.take(np.arange(n)), _work())
    assert result.outcome is Outcome.NONE
    assert result.reason == "no star found in the frame" if n == 0 else "field this narrow" in result.reason


def test_a_bank_without_magnitudes_is_supported() -> None:
    """If the bank format has no magnitudes, every star may match every spot, and tracking still solves the frame."""
    stars = _stars(6.5)
    bank = decode(encode(stars, distance_table(stars, 0.0, 0.01), "cubestar", "aim"), stars.hip)
    catalogue = CHAIN.prepare(bank, PROFILE)
    assert catalogue.limit_mag == SENSOR.faint_limit_mag
    pixels, truth = _frame(PLEIADES)
    hint = AttitudePrior.from_quaternion(quaternion_from_matrix(PLEIADES))
    result = solve(CHAIN, pixels, replace(_work(Mode.TRACKING, hint), catalogue=catalogue))
    assert assess(result, truth, CAMERA).verdict.value == "correct"


def test_constants_have_sources_and_limits() -> None:
    """Invalid parameters are rejected, commanded parameters are used, and the bias corrector is that of the star width."""
    base = default_parameters(PROFILE)
    for invalid in ({"acceptance": "hope"}, {"threshold_dn": 0.0}, {"window_px": 5}, {"min_area_px": 0}):
        with pytest.raises(BadInput):
            replace(base, **invalid)  # type: ignore[arg-type]
    commanded = CHAIN.parameters(PROFILE, 0.1, Commanded(9.0, 3, 77, np.radians(2)), Mode.ASSISTED)
    assert (commanded.threshold_dn, commanded.min_area_px, commanded.max_area_px) == (9.0, 3, 77)
    assert commanded.assisted_radius_rad == pytest.approx(CAMERA.half_diagonal_rad + np.radians(2))
    assert commanded.dn_at_mag_0 == pytest.approx(base.dn_at_mag_0 * 0.1 / SENSOR.exposure_s)
    assert base.gain == pytest.approx(1.041, abs=1e-3)
    assert {"threshold_dn", "gain", "tolerance_rad", "acceptance"} <= set(SOURCES)
    assert system("aim").name == "aim"


def test_mode_transitions_and_durations() -> None:
    """After a failure, tracking falls back to assisted, and assisted to lost in space. Reading the frame through the
    converter takes 1.6 s.
    """
    assert CHAIN.next_mode(Mode.LOST_IN_SPACE, True) is Mode.TRACKING
    assert CHAIN.next_mode(Mode.TRACKING, False) is Mode.ASSISTED
    assert CHAIN.next_mode(Mode.ASSISTED, False) is Mode.LOST_IN_SPACE
    pixels, truth = _frame(PLEIADES)
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(truth.quaternion))
    detection = CHAIN.find_centroids(pixels, work)
    matching = CHAIN.match_stars(detection.centroids, work)
    assert 1600 < CHAIN.detect_ms(pixels.size, detection) < 1800
    assert 0 < CHAIN.match_ms(matching) < 1000
    assert CHAIN.attitude_ms(matching) < 200
    assert 0 < matching.confidence <= 1
    assert matching.weight.sum() == len(matching.selected)


@pytest.mark.parametrize("fault", ["mirrored", "focal length off by 1 %", "100 false stars", "brightness off by 0.5"])
def test_faulty_lists_are_never_solved_wrongly(fault: str) -> None:
    """A mirrored frame gives none, and no other fault gives a wrong attitude, in any mode."""
    for mode in Mode:
        rng = np.random.default_rng(77)
        for _ in range(8):  # a campaign of thousands of trials is described in docs/never-wrong.md
            rotation = matrix_from_quaternion(random_quaternion(rng))
            centroids, truth = _star_list(rng, rotation, 100 if "false" in fault else 0)
            pixels, flux = centroids.pixels, centroids.flux_dn
            if fault == "mirrored":
                pixels = pixels * [-1, 1] + [CAMERA.columns - 1, 0]
            if fault.startswith("focal"):
                pixels = CAMERA.with_focal_scaled(1.01).project(CAMERA.unproject(pixels))
            if fault.startswith("brightness"):
                flux = flux * 10 ** (-0.4 * 0.5 * rng.normal(size=len(flux)))
            result = _solve_list(Centroids.from_pixels(pixels, flux, 0.05), _work(mode, _hint(rng, rotation, mode)))
            verdict = assess(result, truth, CAMERA).verdict.value
            assert verdict == "none" if fault == "mirrored" else verdict != "wrong"
