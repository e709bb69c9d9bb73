"""The FAR-MST chain: statistics with the real catalogue, in which no solution may be wrong, and frames that must not be
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
from gss.pipeline.chains.far_mst_catalogue import FarMstCatalogue
from gss.pipeline.chains.far_mst_parameters import SOURCES, FarMstParameters
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Commanded, Work, solve
from gss.pipeline.chains.systems import system
from gss.pipeline.render import FalseStar, HotPixel, render, stars_near, truth_of
from gss.pipeline.score import assess
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table

PROFILE = shipped_camera("far_mst")
CAMERA, SENSOR = PROFILE.camera, PROFILE.sensor
CHAIN = system("far_mst")
LIMIT_MAG = 4.5
ORION = cam_from_icrs(np.radians(84.0), 0.0, 0.5)


@lru_cache
def _stars(v_max: float) -> StarTable:
    return load_stars(v_max)


def _bank(stars: StarTable) -> OnboardCatalogue:
    """Encode a bank in the on-board format and decode it, so that it has float32 values as on the device."""
    return decode(encode(stars, distance_table(stars, 0.0, CAMERA.diagonal_rad), "cubestar", "far_mst"), stars.hip)


@lru_cache
def _catalogue() -> FarMstCatalogue:
    prepared = CHAIN.prepare(_bank(_stars(LIMIT_MAG)), PROFILE)
    assert isinstance(prepared, FarMstCatalogue)
    return prepared


@lru_cache
def _parameters(mode: Mode = Mode.LOST_IN_SPACE) -> FarMstParameters:
    parameters = CHAIN.parameters(PROFILE, None, Commanded(), mode)
    assert isinstance(parameters, FarMstParameters)
    return parameters


def _solve_list(centroids: Centroids, work: Work) -> SolveResult:
    matching = CHAIN.match_stars(centroids, work)
    solution = CHAIN.calculate_attitude(matching, centroids, work)
    outcome = Outcome.NONE if solution.attitude is None else Outcome.SOLVED
    return SolveResult(
        CHAIN.name,
        outcome,
        solution.reason,
        work.camera,
        (),
        centroids,
        solution.matches,
        solution.attitude,
        solution.false_match_probability,
    )


def _star_list(
    rng: np.random.Generator, rotation: Array, false_count: int, noise_px: float = 0.2
) -> tuple[Centroids, Truth]:
    """Return centroids of all catalogue stars in the frame with noise, and of false stars, brightest first."""
    truth = truth_of(stars_near(_stars(LIMIT_MAG), CAMERA, rotation), CAMERA, rotation)
    measured = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((-0.5, -0.5), (CAMERA.columns - 0.5, CAMERA.rows - 0.5), (false_count, 2))
    v_mag = np.concatenate([truth.v_mag, rng.uniform(1, LIMIT_MAG, false_count)])
    order = np.argsort(v_mag, kind="stable")
    pixels = np.vstack([measured, spurious])[order]
    return Centroids.from_pixels(pixels, 10 ** (-0.4 * v_mag[order]), max(noise_px, 1e-3)), truth


def _work(mode: Mode = Mode.LOST_IN_SPACE, hint: AttitudePrior | None = None, **changes: object) -> Work:
    return Work(CAMERA, _catalogue(), replace(_parameters(mode), **changes), mode, hint)  # type: ignore[arg-type]


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Return a boresight with an error of up to 5° (assisted) or two previous attitudes at 10° per frame (tracking)."""
    if mode is Mode.LOST_IN_SPACE:
        return None
    axis = rng.normal(size=3)
    if mode is Mode.TRACKING:
        step = rotation_from_vector(axis / np.linalg.norm(axis) * np.radians(10))
        previous = step.T @ rotation
        return AttitudePrior.from_quaternion(
            quaternion_from_matrix(previous), (quaternion_from_matrix(step.T @ previous),)
        )
    axis -= axis @ rotation[2] * rotation[2]
    angle = np.radians(5) * rng.random()
    return AttitudePrior(np.cos(angle) * rotation[2] + np.sin(angle) * axis / np.linalg.norm(axis))


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("false_count", [0, 1, 5, 10])
def test_far_mst_lists_are_solved_and_never_wrongly(mode: Mode, false_count: int, trials: Any) -> None:
    """For random attitudes with noise of 0.2 px, no solution is wrong, 97 % are solved, and 93 % of the solutions are
    correct.
    """
    rng = np.random.default_rng(2000 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(100)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, false_count)
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    solved = verdicts.total() - verdicts["none"]
    assert solved >= trials.least(97, 100)
    assert verdicts["correct"] >= trials.least(93, 100, of=solved)


@pytest.mark.parametrize("matcher", ["n3", "n4", "n5", "pyramid", "pivot"])
def test_each_matcher_alone_is_never_wrong(matcher: str, trials: Any) -> None:
    """With one false star per list, every single matcher solves nine of ten lists and none wrongly."""
    rng = np.random.default_rng(31)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(60)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 1)
        verdicts[assess(_solve_list(centroids, _work(matcher=matcher)), truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(54, 60)


def test_the_document_acceptance_rule_can_be_selected() -> None:
    """The document's rule accepts a unique five-star pattern without a false-match bound. None of 20 solutions is
    wrong.
    """
    rng = np.random.default_rng(32)
    for _ in range(20):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 0)
        result = _solve_list(centroids, _work(acceptance="document", matcher="n5"))
        assert result.matches is not None
        assert len(result.matches) == 5
        assert np.isnan(result.false_match_probability)
        assert assess(result, truth, CAMERA).verdict.value != "wrong"


@pytest.mark.parametrize(
    ("mode", "false_count"), [(Mode.LOST_IN_SPACE, 0), (Mode.LOST_IN_SPACE, 5), (Mode.TRACKING, 5)]
)
def test_far_mst_frames_are_solved_and_never_wrongly(mode: Mode, false_count: int, trials: Any) -> None:
    """Of rendered frames with all stars to V 6.5, noise and false stars, none is solved wrongly and 24 of 25 are
    solved.
    """
    rng = np.random.default_rng(17 + false_count)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(25)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        spots = [
            FalseStar(*rng.uniform((5, 5), (1274, 1018)), v_mag=rng.uniform(1, LIMIT_MAG)) for _ in range(false_count)
        ]
        frame = render(_stars(6.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=spots)
        result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(24, 25)


@pytest.mark.parametrize("changes", [{"centroider": "mle"}, {"prefilter": "block"}, {"sigma_model": "document"}])
def test_alternative_stages_solve_frames(changes: dict[str, object]) -> None:
    """With maximum likelihood, with the block filter and with the document's σ, at least five of six frames are solved
    and none wrongly.
    """
    rng = np.random.default_rng(18)
    verdicts: Counter[str] = Counter()
    for _ in range(6):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(6.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng)
        result = solve(CHAIN, frame.pixels, _work(**changes))  # type: ignore[arg-type]
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert 6 - verdicts["none"] >= 5


def test_far_mst_pure_noise_lists_are_never_solved(trials: Any) -> None:
    """Lists of 8 and 20 random centroids never give an attitude, in any mode, with a random hint."""
    rng = np.random.default_rng(66)
    for _ in range(trials(30)):
        for count in (8, 20):
            centroids = Centroids.from_pixels(rng.uniform((0, 0), (1279, 1023), (count, 2)))
            for mode in Mode:
                hint = None if mode is Mode.LOST_IN_SPACE else AttitudePrior.from_quaternion(random_quaternion(rng))
                result = _solve_list(centroids, _work(mode, hint))
                assert result.outcome is Outcome.NONE
                assert result.reason


@pytest.mark.parametrize("location", ["north pole", "south pole", "RA 0", "RA 0 and pole"])
def test_fields_at_poles_and_zero_right_ascension_are_solved(location: str) -> None:
    """Fields centred on a pole or on right ascension 0 are solved, lost in space and assisted."""
    ra, dec = {"north pole": (0.3, 90), "south pole": (2.0, -90), "RA 0": (0.0, 0), "RA 0 and pole": (0.0, 78)}[
        location
    ]
    rotation = cam_from_icrs(ra, np.radians(dec), 1.0)
    rng = np.random.default_rng(5)
    centroids, truth = _star_list(rng, rotation, 2, 0.1)
    for mode in (Mode.LOST_IN_SPACE, Mode.ASSISTED):
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode)))
        assert assess(result, truth, CAMERA).verdict.value in ("correct", "imprecise")


def test_far_mst_mirror_images_are_not_solved() -> None:
    """20 mirrored lists, lost in space and assisted, give no attitude."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _star_list(rng, rotation, 0)
        mirrored = replace(centroids, col_px=CAMERA.columns - 1 - centroids.col_px)
        for mode in (Mode.LOST_IN_SPACE, Mode.ASSISTED):
            assert _solve_list(mirrored, _work(mode, _hint(rng, rotation, mode))).outcome is Outcome.NONE


def test_a_wrong_focal_length_gives_no_wrong_attitude() -> None:
    """If the camera's focal length is stated 1 % too long, none of 30 lists gives an attitude wrong by more than 10 px."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _star_list(rng, rotation, 1)
        work = replace(_work(), camera=CAMERA.with_focal_scaled(1.01))
        assert assess(_solve_list(centroids, work), truth, CAMERA, attitude_px=10.0).verdict.value != "wrong"


def test_a_hint_wrong_by_40_degrees_gives_no_attitude() -> None:
    """Assisted mode and tracking with a hint wrong by 40° give none."""
    rng = np.random.default_rng(8)
    for _ in range(10):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _star_list(rng, rotation, 0)
        wrong_attitude = rotation_from_vector(np.array([np.radians(40), 0, 0])) @ rotation
        for mode in (Mode.ASSISTED, Mode.TRACKING):
            result = _solve_list(
                centroids, _work(mode, AttitudePrior.from_quaternion(quaternion_from_matrix(wrong_attitude)))
            )
            assert result.outcome is Outcome.NONE


def test_a_lost_track_is_recovered_near_the_hint() -> None:
    """If the prediction is wrong by 3°, far beyond the radius of the rate match, the n-vertex match solves the frame."""
    rng = np.random.default_rng(9)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, truth = _star_list(rng, rotation, 0)
    wrong_attitude = rotation_from_vector(np.array([0, np.radians(3), 0])) @ rotation
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(quaternion_from_matrix(wrong_attitude)))
    assert "vertex" in CHAIN.match_stars(centroids, work).method
    assert assess(_solve_list(centroids, work), truth, CAMERA).verdict.value == "correct"


def test_two_stars_are_sufficient_for_tracking() -> None:
    """With a complete previous attitude, two stars at the right distance give the attitude."""
    rng = np.random.default_rng(10)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, truth = _star_list(rng, rotation, 0)
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(truth.quaternion))
    result = _solve_list(centroids.take(np.arange(2)), work)
    assert assess(result, truth, CAMERA).verdict.value == "correct"


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_far_mst_reports_too_few_stars(n: int) -> None:
    """Up to three centroids give no attitude in lost-in-space mode, and the reason states how many are needed."""
    centroids, _ = _star_list(np.random.default_rng(11), ORION, 0)
    result = _solve_list(centroids.take(np.arange(n)), _work())
    assert result.outcome is Outcome.NONE
    assert (
        result.reason == "no star found in the frame" if n == 0 else "4 needed in lost in space mode" in result.reason
    )


def test_far_mst_frames_without_usable_stars_give_none() -> None:
    """Blank, saturated, noisy, striped and Moon-lit frames give none with a reason, never an attitude."""
    rng = np.random.default_rng(12)
    dark = np.full((1024, 1280), 24, np.uint16)
    moon, stripes = dark.copy(), dark.copy()
    row, col = np.indices(moon.shape)
    moon[(row - 200) ** 2 + (col - 300) ** 2 < 40**2] = 1023
    stripes[::9] = 800
    frames = {
        "blank": np.zeros_like(dark),
        "saturated": np.full_like(dark, 1023),
        "noise": rng.integers(0, 1024, dark.shape).astype(np.uint16),
        "sparse noise": np.where(rng.random(dark.shape) < 0.2, 800, 24).astype(np.uint16),
        "stripes": stripes,
        "moon": moon,
    }
    for name, frame in frames.items():
        result = solve(CHAIN, frame, _work())
        assert result.outcome is Outcome.NONE, name
        assert result.reason, name


def test_far_mst_filters_hot_pixels() -> None:
    """A frame with three hundred hot pixels is solved correctly."""
    rng = np.random.default_rng(13)
    hot = [HotPixel(int(rng.integers(1280)), int(rng.integers(1024)), 40_000.0) for _ in range(300)]
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng, hot_pixels=hot)
    result = solve(CHAIN, frame.pixels, _work())
    assert assess(result, frame.truth, CAMERA).verdict.value == "correct"


def test_trailed_stars_are_solved_with_a_note() -> None:
    """A frame with stars trailed over 17 px at 4°/s is solved, and a note reports streaks (Huffman 2006 §4.2.2)."""
    rng = np.random.default_rng(14)
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng, rate_rad_s=(np.radians(4.0), 0.0, 0.0))
    result = solve(CHAIN, frame.pixels, _work())
    assert assess(result, frame.truth, CAMERA).verdict.value in ("correct", "imprecise")
    assert any("streaks" in note for note in result.notes)


def test_rotating_the_sky_rotates_the_far_mst_attitude() -> None:
    """If the catalogue is rotated, the same centroids give the same matches and the attitude rotated accordingly."""
    centroids, _ = _star_list(np.random.default_rng(15), ORION, 2)
    before = _solve_list(centroids, _work())
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(6)))
    stars = replace(_stars(LIMIT_MAG), icrs=_stars(LIMIT_MAG).icrs @ turn.T)
    after = _solve_list(centroids, replace(_work(), catalogue=CHAIN.prepare(_bank(stars), PROFILE)))
    assert before.attitude is not None
    assert after.attitude is not None
    assert before.matches is not None
    assert after.matches is not None
    np.testing.assert_array_equal(after.matches.hip, before.matches.hip)
    # The bank stores float32 directions, which are rounded by 6e-8.
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ turn, before.attitude.cam_from_icrs) < 1e-6


def test_a_sequence_is_tracked_with_its_previous_attitudes() -> None:
    """Of twelve frames at 3° per frame, the first is solved lost in space, and from the third on the rate match uses
    the previous attitudes as hints.
    """
    rng = np.random.default_rng(21)
    rotation, step = ORION, rotation_from_vector(np.radians([1.0, -2.8, 0.5]))
    mode, attitudes = Mode.LOST_IN_SPACE, []
    for k in range(12):
        centroids, truth = _star_list(rng, rotation, 1)
        hint = AttitudePrior.from_quaternion(attitudes[0], tuple(attitudes[1:])) if attitudes else None
        work = _work(mode, hint)
        matching = CHAIN.match_stars(centroids, work)
        result = _solve_list(centroids, work)
        assert assess(result, truth, CAMERA).verdict.value in ("correct", "imprecise")
        assert result.attitude is not None
        # The second frame has no rate yet, and 3° is beyond the radius of the rate match, so the n-vertex match solves it.
        assert (matching.method == "rate match") is (k >= 2)
        attitudes.insert(0, result.attitude.quaternion)
        mode, rotation = CHAIN.next_mode(mode, True), step @ rotation
    assert mode is Mode.TRACKING


def test_far_mst_results_are_bit_identical() -> None:
    """Two runs, with and without a clock, give identical bits, even with another frame in between. No state is kept
    between frames.
    """
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, np.random.default_rng(8)).pixels
    ticks = iter(range(100))
    first = solve(CHAIN, frame, _work())
    solve(CHAIN, frame[::-1].copy(), _work())
    second = solve(CHAIN, frame.copy(), _work(), clock=lambda: float(next(ticks)))
    assert first.attitude is not None
    assert second.attitude is not None
    assert first.attitude.quaternion.tobytes() == second.attitude.quaternion.tobytes()
    assert first.attitude.covariance_rad2.tobytes() == second.attitude.covariance_rad2.tobytes()
    assert first.centroids.pixels.tobytes() == second.centroids.pixels.tobytes()


@pytest.mark.parametrize("method", ["q_method", "svd", "foam"])
def test_the_four_attitude_methods_agree(method: str) -> None:
    """q-method, SVD and FOAM give QUEST's attitude within rounding errors. SVD and FOAM calculate the covariance
    differently, and it agrees with QUEST's within 1 % (Huffman 2006 ch. 6).
    """
    centroids, _ = _star_list(np.random.default_rng(16), ORION, 1)
    quest, other = _solve_list(centroids, _work()), _solve_list(centroids, _work(attitude_method=method))
    assert quest.attitude is not None
    assert other.attitude is not None
    assert rotation_angle_rad(quest.attitude.cam_from_icrs, other.attitude.cam_from_icrs) < 1e-12
    np.testing.assert_allclose(quest.attitude.covariance_rad2, other.attitude.covariance_rad2, rtol=0.01)


def test_far_mst_covariance_agrees_with_the_errors() -> None:
    """Over 40 rendered frames, the rms of the cross-boresight error is √2 predicted standard deviations, within 25 %."""
    rng = np.random.default_rng(19)
    squares = []
    for _ in range(40):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        frame = render(_stars(6.0), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng)
        result = solve(CHAIN, frame.pixels, _work())
        if result.attitude is not None:
            squares.append((assess(result, frame.truth, CAMERA).cross_rad / result.attitude.sigma_rad[0]) ** 2)
    assert len(squares) >= 39
    assert np.sqrt(np.mean(squares) / 2) == pytest.approx(1.0, abs=0.25)


def test_far_mst_rejects_invalid_requests() -> None:
    """Tracking without a hint, a frame of another camera and unknown settings are rejected."""
    centroids, _ = _star_list(np.random.default_rng(20), ORION, 0)
    with pytest.raises(BadInput, match="hint"):
        CHAIN.match_stars(centroids, _work(Mode.TRACKING))
    with pytest.raises(BadInput, match="camera"):
        solve(CHAIN, np.zeros((512, 1024), np.uint8), _work())
    with pytest.raises(BadInput, match="matcher"):
        _work(matcher="magic")
    with pytest.raises(BadInput, match="invalid detection parameters"):
        _work(min_area_px=9, max_area_px=8)


def test_far_mst_sources_name_parameters() -> None:
    """SOURCES names only existing parameters, and commanded values are used."""
    names = set(FarMstParameters.__dataclass_fields__)
    assert set(SOURCES) <= names
    parameters = CHAIN.parameters(PROFILE, 0.2, Commanded(30.0, 5, 60, 0.1), Mode.ASSISTED)
    assert (parameters.threshold_dn, parameters.min_area_px, parameters.max_area_px) == (30.0, 5, 60)
    assert parameters.assisted_radius_rad == pytest.approx(CAMERA.half_diagonal_rad + 0.1)
