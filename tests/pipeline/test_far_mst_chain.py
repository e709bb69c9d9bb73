"""The FAR-MST chain: statistics with the real catalogue, where no answer may be wrong, and inputs that must fail."""

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
    """Encode the bank in the on-board format and decode it: float32, as on the device."""
    return decode(encode(stars, distance_table(stars, 0.0, CAMERA.diagonal_rad), "cubestar", "far_mst"), stars.hip)


@lru_cache
def _catalogue() -> FarMstCatalogue:
    prepared = CHAIN.prepare(_bank(_stars(LIMIT_MAG)), PROFILE)
    assert isinstance(prepared, FarMstCatalogue)
    return prepared


@lru_cache
def _parameters(mode: Mode = Mode.LOST_IN_SPACE) -> FarMstParameters:
    made = CHAIN.parameters(PROFILE, None, Commanded(), mode)
    assert isinstance(made, FarMstParameters)
    return made


def _solve_list(centroids: Centroids, work: Work) -> SolveResult:
    matching = CHAIN.match_stars(centroids, work)
    s = CHAIN.calculate_attitude(matching, centroids, work)
    outcome = Outcome.NONE if s.attitude is None else Outcome.SOLVED
    return SolveResult(
        CHAIN.name,
        outcome,
        s.reason,
        work.camera,
        (),
        centroids,
        s.matches,
        s.attitude,
        s.false_match_probability,
    )


def _list(rng: np.random.Generator, rotation: Array, false: int, noise_px: float = 0.2) -> tuple[Centroids, Truth]:
    """Centroids of all catalogue stars in the frame with noise, and false ones, brightest first."""
    truth = truth_of(stars_near(_stars(LIMIT_MAG), CAMERA, rotation), CAMERA, rotation)
    seen = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
    spurious = rng.uniform((-0.5, -0.5), (CAMERA.columns - 0.5, CAMERA.rows - 0.5), (false, 2))
    v_mag = np.concatenate([truth.v_mag, rng.uniform(1, LIMIT_MAG, false)])
    order = np.argsort(v_mag, kind="stable")
    pixels = np.vstack([seen, spurious])[order]
    return Centroids.from_pixels(pixels, 10 ** (-0.4 * v_mag[order]), max(noise_px, 1e-3)), truth


def _work(mode: Mode = Mode.LOST_IN_SPACE, hint: AttitudePrior | None = None, **changes: object) -> Work:
    return Work(CAMERA, _catalogue(), replace(_parameters(mode), **changes), mode, hint)  # type: ignore[arg-type]


def _hint(rng: np.random.Generator, rotation: Array, mode: Mode) -> AttitudePrior | None:
    """Boresight up to 5° off for assisted; for tracking two earlier attitudes of a turn of 10° per frame."""
    if mode is Mode.LOST_IN_SPACE:
        return None
    axis = rng.normal(size=3)
    if mode is Mode.TRACKING:
        step = rotation_from_vector(axis / np.linalg.norm(axis) * np.radians(10))
        before = step.T @ rotation
        return AttitudePrior.from_quaternion(quaternion_from_matrix(before), (quaternion_from_matrix(step.T @ before),))
    axis -= axis @ rotation[2] * rotation[2]
    angle = np.radians(5) * rng.random()
    return AttitudePrior(np.cos(angle) * rotation[2] + np.sin(angle) * axis / np.linalg.norm(axis))


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("false", [0, 1, 5, 10])
def test_far_mst_lists_are_solved_and_never_wrongly(mode: Mode, false: int, trials: Any) -> None:
    """Random attitudes, 0.2 px noise: no wrong answer, 97 % solved, 93 % of those correct."""
    rng = np.random.default_rng(2000 + false)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(100)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, false)
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    solved = verdicts.total() - verdicts["none"]
    assert solved >= trials.least(97, 100)
    assert verdicts["correct"] >= trials.least(93, 100, of=solved)


@pytest.mark.parametrize("matcher", ["n3", "n4", "n5", "pyramid"])
def test_each_matcher_alone_is_never_wrong(matcher: str, trials: Any) -> None:
    """Lists with one false star: none wrong, nine of ten solved, by every matcher on its own."""
    rng = np.random.default_rng(31)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(60)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 1)
        verdicts[assess(_solve_list(centroids, _work(matcher=matcher)), truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(54, 60)


def test_the_documents_own_acceptance_can_be_chosen() -> None:
    """A unique five-star pattern is accepted without a bound: five matches; its results are correct where the bound accepts."""
    rng = np.random.default_rng(32)
    for _ in range(20):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 0)
        result = _solve_list(centroids, _work(acceptance="document", matcher="n5"))
        assert result.matches is not None
        assert len(result.matches) == 5
        assert np.isnan(result.false_match_probability)
        assert assess(result, truth, CAMERA).verdict.value != "wrong"


@pytest.mark.parametrize(("mode", "false"), [(Mode.LOST_IN_SPACE, 0), (Mode.LOST_IN_SPACE, 5), (Mode.TRACKING, 5)])
def test_far_mst_frames_are_solved_and_never_wrongly(mode: Mode, false: int, trials: Any) -> None:
    """Rendered frames with all stars to V 6.5, noise and false stars: none wrong, 24 of 25 solved."""
    rng = np.random.default_rng(17 + false)
    verdicts: Counter[str] = Counter()
    for _ in range(trials(25)):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        spots = [FalseStar(*rng.uniform((5, 5), (1274, 1018)), v_mag=rng.uniform(1, LIMIT_MAG)) for _ in range(false)]
        frame = render(_stars(6.5), CAMERA, SENSOR, rotation, SENSOR.exposure_s, rng, false_stars=spots)
        result = solve(CHAIN, frame.pixels, _work(mode, _hint(rng, rotation, mode)))
        verdicts[assess(result, frame.truth, CAMERA).verdict.value] += 1
    assert verdicts["wrong"] == 0
    assert verdicts.total() - verdicts["none"] >= trials.least(24, 25)


@pytest.mark.parametrize("changes", [{"centroider": "mle"}, {"prefilter": "block"}, {"sigma_model": "document"}])
def test_other_stages_solve_frames_too(changes: dict[str, object]) -> None:
    """Maximum likelihood, the block filter and the document's σ: six frames each, none wrong, at least five solved."""
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
    """Random centroids, 8 and 20 of them, in every mode with a random hint never give an attitude."""
    rng = np.random.default_rng(66)
    for _ in range(trials(30)):
        for count in (8, 20):
            centroids = Centroids.from_pixels(rng.uniform((0, 0), (1279, 1023), (count, 2)))
            for mode in Mode:
                hint = None if mode is Mode.LOST_IN_SPACE else AttitudePrior.from_quaternion(random_quaternion(rng))
                result = _solve_list(centroids, _work(mode, hint))
                assert result.outcome is Outcome.NONE
                assert result.reason


@pytest.mark.parametrize("place", ["north pole", "south pole", "RA 0", "RA 0 and pole"])
def test_poles_and_the_origin_of_right_ascension_are_ordinary_places(place: str) -> None:
    """Centred on a pole or on RA = 0 the chain solves correctly, lost and assisted."""
    ra, dec = {"north pole": (0.3, 90), "south pole": (2.0, -90), "RA 0": (0.0, 0), "RA 0 and pole": (0.0, 78)}[place]
    rotation = cam_from_icrs(ra, np.radians(dec), 1.0)
    rng = np.random.default_rng(5)
    centroids, truth = _list(rng, rotation, 2, 0.1)
    for mode in (Mode.LOST_IN_SPACE, Mode.ASSISTED):
        result = _solve_list(centroids, _work(mode, _hint(rng, rotation, mode)))
        assert assess(result, truth, CAMERA).verdict.value in ("correct", "imprecise")


def test_far_mst_mirror_images_are_not_solved() -> None:
    """20 mirrored lists, lost in space and assisted, give no attitude."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _list(rng, rotation, 0)
        mirrored = replace(centroids, col_px=CAMERA.columns - 1 - centroids.col_px)
        for mode in (Mode.LOST_IN_SPACE, Mode.ASSISTED):
            assert _solve_list(mirrored, _work(mode, _hint(rng, rotation, mode))).outcome is Outcome.NONE


def test_a_focal_length_one_per_cent_off_is_never_wrong() -> None:
    """30 lists seen by a camera 1 % longer than it says: no attitude more than a few pixels off."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, truth = _list(rng, rotation, 1)
        off = replace(_work(), camera=CAMERA.with_focal_scaled(1.01))
        assert assess(_solve_list(centroids, off), truth, CAMERA, attitude_px=10.0).verdict.value != "wrong"


def test_a_hint_to_the_wrong_sky_gives_no_attitude() -> None:
    """Assisted or tracking with a hint 40° off ends as none, never with an attitude elsewhere."""
    rng = np.random.default_rng(8)
    for _ in range(10):
        rotation = matrix_from_quaternion(random_quaternion(rng))
        centroids, _ = _list(rng, rotation, 0)
        wrong = rotation_from_vector(np.array([np.radians(40), 0, 0])) @ rotation
        for mode in (Mode.ASSISTED, Mode.TRACKING):
            result = _solve_list(centroids, _work(mode, AttitudePrior.from_quaternion(quaternion_from_matrix(wrong))))
            assert result.outcome is Outcome.NONE


def test_a_lost_track_is_found_again_near_the_hint() -> None:
    """Three degrees off the prediction, far beyond the rate match's radius, the n-vertex match takes over."""
    rng = np.random.default_rng(9)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, truth = _list(rng, rotation, 0)
    moved = rotation_from_vector(np.array([0, np.radians(3), 0])) @ rotation
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(quaternion_from_matrix(moved)))
    assert "vertex" in CHAIN.match_stars(centroids, work).method
    assert assess(_solve_list(centroids, work), truth, CAMERA).verdict.value == "correct"


def test_two_stars_are_enough_while_tracking_far_mst() -> None:
    """With a full attitude before, two stars at the right distance give the attitude."""
    rng = np.random.default_rng(10)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    centroids, truth = _list(rng, rotation, 0)
    work = _work(Mode.TRACKING, AttitudePrior.from_quaternion(truth.quaternion))
    result = _solve_list(centroids.take(np.arange(2)), work)
    assert assess(result, truth, CAMERA).verdict.value == "correct"


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_far_mst_too_few_stars_say_so(n: int) -> None:
    """Up to three centroids give no attitude when lost, and the reason says it."""
    centroids, _ = _list(np.random.default_rng(11), ORION, 0)
    result = _solve_list(centroids.take(np.arange(n)), _work())
    assert result.outcome is Outcome.NONE
    assert (
        result.reason == "no star found in the frame" if n == 0 else "4 needed in lost in space mode" in result.reason
    )


def test_far_mst_hopeless_frames_are_quietly_none() -> None:
    """Blank, saturated, all-noise, striped and Moon-lit frames end as none with a reason, never with an attitude."""
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


def test_far_mst_hot_pixels_do_not_disturb() -> None:
    """Three hundred hot pixels are filtered away and the frame is solved correctly."""
    rng = np.random.default_rng(13)
    hot = [HotPixel(int(rng.integers(1280)), int(rng.integers(1024)), 40_000.0) for _ in range(300)]
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng, hot_pixels=hot)
    result = solve(CHAIN, frame.pixels, _work())
    assert assess(result, frame.truth, CAMERA).verdict.value == "correct"


def test_a_rotating_camera_is_solved_with_a_note_on_exposure() -> None:
    """At 4°/s, 17 px of smear, the frame is solved and a note reports streaks (Huffman 2006 §4.2.2)."""
    rng = np.random.default_rng(14)
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, rng, rate_rad_s=(np.radians(4.0), 0.0, 0.0))
    result = solve(CHAIN, frame.pixels, _work())
    assert assess(result, frame.truth, CAMERA).verdict.value in ("correct", "imprecise")
    assert any("streaks" in note for note in result.notes)


def test_turning_the_sky_turns_far_mst() -> None:
    """With the whole catalogue turned the same centroids give the attitude turned back, same matches."""
    centroids, _ = _list(np.random.default_rng(15), ORION, 2)
    before = _solve_list(centroids, _work())
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(6)))
    stars = replace(_stars(LIMIT_MAG), icrs=_stars(LIMIT_MAG).icrs @ turn.T)
    after = _solve_list(centroids, replace(_work(), catalogue=CHAIN.prepare(_bank(stars), PROFILE)))
    assert before.attitude is not None
    assert after.attitude is not None
    assert before.matches is not None
    assert after.matches is not None
    np.testing.assert_array_equal(after.matches.hip, before.matches.hip)
    # float32 directions of the bank differ by 6e-8
    assert rotation_angle_rad(after.attitude.cam_from_icrs @ turn, before.attitude.cam_from_icrs) < 1e-6


def test_a_sequence_is_tracked_through_its_own_attitudes() -> None:
    """Twelve frames at 3° per frame: the first lost in space, the rest by rate match from the hints of the answers before."""
    rng = np.random.default_rng(21)
    rotation, step = ORION, rotation_from_vector(np.radians([1.0, -2.8, 0.5]))
    mode, answers = Mode.LOST_IN_SPACE, []
    for k in range(12):
        centroids, truth = _list(rng, rotation, 1)
        hint = AttitudePrior.from_quaternion(answers[0], tuple(answers[1:])) if answers else None
        work = _work(mode, hint)
        matching = CHAIN.match_stars(centroids, work)
        result = _solve_list(centroids, work)
        assert assess(result, truth, CAMERA).verdict.value in ("correct", "imprecise")
        assert result.attitude is not None
        # The first step has no rate yet and 3° is beyond the radius: the figure match helps out.
        assert (matching.method == "rate match") is (k >= 2)
        answers.insert(0, result.attitude.quaternion)
        mode, rotation = CHAIN.next_mode(mode, True), step @ rotation
    assert mode is Mode.TRACKING


def test_far_mst_gives_the_same_bits_twice() -> None:
    """Two runs, with and without a clock, agree in every bit: nothing is kept between frames."""
    frame = render(_stars(6.5), CAMERA, SENSOR, ORION, SENSOR.exposure_s, np.random.default_rng(8)).pixels
    ticks = iter(range(100))
    a = solve(CHAIN, frame, _work())
    solve(CHAIN, frame[::-1].copy(), _work())
    b = solve(CHAIN, frame.copy(), _work(), clock=lambda: float(next(ticks)))
    assert a.attitude is not None
    assert b.attitude is not None
    assert a.attitude.quaternion.tobytes() == b.attitude.quaternion.tobytes()
    assert a.attitude.covariance_rad2.tobytes() == b.attitude.covariance_rad2.tobytes()
    assert a.centroids.pixels.tobytes() == b.centroids.pixels.tobytes()


@pytest.mark.parametrize("method", ["q_method", "svd", "foam"])
def test_the_four_attitude_methods_agree(method: str) -> None:
    """q-method, SVD and FOAM give QUEST's attitude to rounding. SVD and FOAM have separate expressions of the covariance,
    which agree with QUEST's within 1 % (Huffman 2006 ch. 6).
    """
    centroids, _ = _list(np.random.default_rng(16), ORION, 1)
    quest, other = _solve_list(centroids, _work()), _solve_list(centroids, _work(attitude_method=method))
    assert quest.attitude is not None
    assert other.attitude is not None
    assert rotation_angle_rad(quest.attitude.cam_from_icrs, other.attitude.cam_from_icrs) < 1e-12
    np.testing.assert_allclose(quest.attitude.covariance_rad2, other.attitude.covariance_rad2, rtol=0.01)


def test_far_mst_covariance_is_the_scatter() -> None:
    """Over 40 rendered frames the errors across the boresight, in predicted standard deviations, have rms √2 within 25 %."""
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


def test_far_mst_broken_contracts_are_refused() -> None:
    """Tracking without a hint, a frame of another camera and unknown settings are BadInput."""
    centroids, _ = _list(np.random.default_rng(20), ORION, 0)
    with pytest.raises(BadInput, match="hint"):
        CHAIN.match_stars(centroids, _work(Mode.TRACKING))
    with pytest.raises(BadInput, match="camera"):
        solve(CHAIN, np.zeros((512, 1024), np.uint8), _work())
    with pytest.raises(BadInput, match="matcher"):
        _work(matcher="magic")
    with pytest.raises(BadInput, match="invalid detection parameters"):
        _work(min_area_px=9, max_area_px=8)


def test_every_far_mst_constant_has_a_source() -> None:
    """What SOURCES names are parameters, and the commanded values arrive."""
    names = set(FarMstParameters.__dataclass_fields__)
    assert set(SOURCES) <= names
    made = CHAIN.parameters(PROFILE, 0.2, Commanded(30.0, 5, 60, 0.1), Mode.ASSISTED)
    assert (made.threshold_dn, made.min_area_px, made.max_area_px) == (30.0, 5, 60)
    assert made.assisted_radius_rad == pytest.approx(CAMERA.half_diagonal_rad + 0.1)
