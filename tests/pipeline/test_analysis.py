"""Analyses of attitude runs: injected errors are measured, and faults of a run are reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import quaternion_product, turn_between, turned
from gss.pipeline.analysis.integration import noise_equivalent_angle
from gss.pipeline.analysis.sensitivity import detection_limit
from gss.pipeline.analysis.series import AttitudeSeries, check_series
from gss.pipeline.analysis.slew import slew_test
from gss.pipeline.analysis.steady import SIDEREAL_RAD_S, celestial_fixed, earth_fixed
from gss.pipeline.analysis.telemetry import telemetry_statistics
from gss.pipeline.analysis.two_cameras import two_cameras

NOISE_RAD = np.array([9.0, 12.0, 60.0]) * ARCSEC_RAD
POLE = np.array([0.0, 0.0, SIDEREAL_RAD_S])


def run(
    rate_icrs: Array,
    n: int = 300,
    step_s: float = 2.0,
    noise_rad: Array = NOISE_RAD,
    seed: int = 1,
    gap_s: float = 0.0,
    dec_rad: float = -0.59,
) -> AttitudeSeries:
    """Return a run of a camera that rotates at the constant rate ``rate_icrs``, with white noise about its own axes.
    ``gap_s`` is inserted in the middle. ``dec_rad``: declination of the boresight at the start.
    """
    rng = np.random.default_rng(seed)
    times_s = np.arange(n) * step_s
    times_s[n // 2 :] += gap_s
    start = Rotation.from_matrix(cam_from_icrs(6.2, dec_rad, 0.6))
    # The camera rotates right-handed by ω about axes fixed in ICRS, so C(t) = C₀·R(ω t)⁻¹.
    attitude = start * Rotation.from_rotvec(rate_icrs * times_s[:, None]).inv()
    noisy = Rotation.from_rotvec(rng.normal(size=(n, 3)) * noise_rad) * attitude
    covariance = np.broadcast_to(np.diag(noise_rad**2), (n, 3, 3)).copy()
    counts = np.full(n, 12, np.intp)
    return AttitudeSeries(times_s + 1.8e9, noisy.as_quat(), covariance, counts, counts - 2, np.full(n, 0.2))


def with_unsolved(series: AttitudeSeries, rows: list[int]) -> AttitudeSeries:
    """Return the run with the frames in ``rows`` unsolved."""
    quaternion = series.quaternion.copy()
    quaternion[rows] = np.nan
    return replace(series, quaternion=quaternion)


def test_rotation_functions_agree_with_scipy() -> None:
    """Quaternion products, rotation vectors and their inverses agree with scipy for small and large angles."""
    rng = np.random.default_rng(3)
    a, b = Rotation.random(50, rng=rng), Rotation.random(50, rng=rng)
    v = turn_between(a.as_quat(), b.as_quat())
    assert np.allclose((Rotation.from_rotvec(v) * a).as_matrix(), b.as_matrix(), atol=1e-12)
    small = rng.normal(size=(50, 3)) * 1e-9
    assert np.allclose(turn_between(a.as_quat(), turned(a.as_quat(), small)), small, atol=1e-15)
    assert np.allclose(np.abs(quaternion_product(a.as_quat(), b.as_quat())), np.abs((a * b).as_quat()))


def test_an_earth_fixed_run_gives_noise_and_sidereal_rate() -> None:
    """The noise of each axis is within its interval, the rate is the Earth's within four σ, and there is no warning."""
    test = earth_fixed(run(POLE))
    for figures, true in zip(test.body, NOISE_RAD, strict=True):
        assert figures.low_rad < true < figures.high_rad
        assert figures.noise_rad == pytest.approx(true, rel=0.15)
        assert figures.claimed_rad == pytest.approx(true)
    assert (np.abs(test.rate_icrs_rad_s - POLE) < 4 * test.rate_sigma_rad_s).all()
    assert np.linalg.norm(test.rate_icrs_rad_s) == pytest.approx(np.linalg.norm(test.expected_icrs_rad_s), rel=0.01)
    assert test.sky[0].drift_rad_s == pytest.approx(SIDEREAL_RAD_S, rel=0.02)
    assert test.warnings == ()


def test_the_sigma_of_the_ra_drift_is_its_error_near_the_pole() -> None:
    """At 80° declination, the σ of the drift in right ascension agrees with the scatter of the drift."""
    noise_rad = np.full(3, 5 * ARCSEC_RAD)
    figures = [
        earth_fixed(run(POLE, n=12, noise_rad=noise_rad, seed=k, dec_rad=float(np.radians(80)))).sky[0]
        for k in range(60)
    ]
    scatter = np.std([f.drift_rad_s for f in figures])
    assert np.median([f.drift_sigma_rad_s for f in figures]) / scatter == pytest.approx(1, abs=0.25)


def test_a_celestially_fixed_camera_has_no_rate() -> None:
    """The celestial-fixed test expects no rate. A run at the sidereal rate fails it, and a run without rate fails the
    Earth-fixed test.
    """
    assert celestial_fixed(run(np.zeros(3))).warnings == ()
    severe = [w for w in celestial_fixed(run(POLE)).warnings if w.severe]
    assert [w.code for w in severe] == ["moved"]
    assert [w.code for w in earth_fixed(run(np.zeros(3))).warnings if w.severe] == ["moved"]


def test_missing_and_wrong_attitudes_do_not_affect_the_figures() -> None:
    """Unsolved frames keep their rows. A wrong attitude is excluded and counted."""
    series = with_unsolved(run(POLE), [10, 11, 200])
    series.quaternion[50] = turned(series.quaternion[50], np.array([0.01, 0.0, 0.0]))
    test = earth_fixed(series)
    assert test.solved == 297
    assert np.isnan(test.deviation_rad[[10, 11, 200]]).all()
    assert np.flatnonzero(test.strays).tolist() == [50]
    assert test.body[0].low_rad < NOISE_RAD[0] < test.body[0].high_rad
    assert "strays" in {w.code for w in test.warnings}


def test_a_moved_mount_and_a_clock_jump_are_reported() -> None:
    """A step of the attitude, a gap between frames and a step of the clock each give a warning."""
    series = run(POLE)
    moved = replace(series, quaternion=series.quaternion.copy())
    moved.quaternion[150:] = turned(moved.quaternion[150:], np.array([60 * ARCSEC_RAD, 0.0, 0.0]))
    assert "jump" in {w.code for w in earth_fixed(moved).warnings}
    assert "gaps" in {w.code for w in check_series(run(POLE, gap_s=100.0))}
    clock_jump = replace(series, times_s=series.times_s.copy())
    clock_jump.times_s[150:] += 30.0
    assert {"jump", "moved"} & {w.code for w in earth_fixed(clock_jump).warnings}


def test_too_few_attitudes_or_equal_times_are_rejected() -> None:
    """At least five attitudes with different times are required."""
    series = run(POLE, n=8)
    with pytest.raises(BadInput, match="too few"):
        earth_fixed(with_unsolved(series, [0, 1, 2, 3]))
    with pytest.raises(BadInput, match="same time"):
        earth_fixed(replace(series, times_s=np.full(8, 5.0)))


def test_the_rate_of_a_slew_is_measured() -> None:
    """The commanded rate of 0.1333°/s is measured within four σ. A different command gives a warning; invalid rates are
    rejected.
    """
    rate = np.radians(0.1333) * np.array([0.6, 0.8, 0.0])
    test = slew_test(run(rate, n=120, step_s=1.0), float(np.radians(0.1333)))
    assert abs(test.mean_speed_rad_s - np.radians(0.1333)) < 4 * test.mean_sigma_rad_s + 1e-9
    assert test.ratio == pytest.approx(1, abs=0.01)
    assert test.claimed_rad_s == pytest.approx(float(np.sqrt(2 * np.mean(NOISE_RAD**2))), rel=1e-3)
    assert test.warnings == ()
    assert {w.code for w in slew_test(run(rate, n=120, step_s=1.0), 0.003).warnings} == {"rate"}
    with pytest.raises(BadInput, match="rate"):
        slew_test(run(rate), 0.0)
    with pytest.raises(BadInput, match="too far"):
        slew_test(run(rate), 3.0)


SLEW_RAD_S = float(np.radians(0.1333))


def slew_run(n: int, noise_rad: float, jitter_rad: float, rng: np.random.Generator) -> AttitudeSeries:
    """Return a slew about one axis with one frame per second, white attitude noise, and independent errors of the
    rotation from frame to frame."""
    angle = np.cumsum(SLEW_RAD_S + jitter_rad * rng.normal(size=n))
    axis = np.array([0.6, 0.8, 0.0])
    attitude = Rotation.from_rotvec(rng.normal(size=(n, 3)) * noise_rad) * Rotation.from_rotvec(-angle[:, None] * axis)
    covariance = np.broadcast_to(np.eye(3) * noise_rad**2, (n, 3, 3)).copy()
    counts = np.full(n, 12, np.intp)
    return AttitudeSeries(np.arange(n) * 1.0, attitude.as_quat(), covariance, counts, counts, np.full(n, 0.2))


@pytest.mark.parametrize(
    ("n", "noise_arcsec", "jitter_arcsec"), [(30, 20, 0), (100, 20, 0), (100, 1, 20), (100, 20, 5)]
)
def test_the_sigma_of_the_mean_rate_is_its_error(n: int, noise_arcsec: float, jitter_arcsec: float) -> None:
    """The σ of the mean rate of a slew agrees with the scatter of the mean rate, for attitude noise, whose errors
    cancel from interval to interval, for rate errors, which do not, and for both."""
    rng = np.random.default_rng(4)
    tests = [
        slew_test(slew_run(n, noise_arcsec * ARCSEC_RAD, jitter_arcsec * ARCSEC_RAD, rng), SLEW_RAD_S)
        for _ in range(200)
    ]
    scatter = np.std([t.mean_speed_rad_s for t in tests])
    assert 0.7 < np.median([t.mean_sigma_rad_s for t in tests]) / scatter < 1.4


def test_a_gap_of_more_than_half_a_turn_does_not_change_the_mean_rate() -> None:
    """An interval over which the camera turns too far to determine the direction is excluded. At least four other
    intervals are required."""
    rate = float(np.radians(1.0))
    series = run(np.array([rate, 0.0, 0.0]), n=40, step_s=10.0, gap_s=200.0)
    test = slew_test(series, rate)
    assert abs(test.mean_speed_rad_s - rate) < 5 * test.mean_sigma_rad_s < 0.001 * rate
    assert len(test.rate_rad_s) == len(test.times_s) == 38
    with pytest.raises(BadInput, match="too far"):
        slew_test(run(np.array([rate, 0.0, 0.0]), n=5, step_s=10.0, gap_s=200.0), rate)


def test_attitudes_without_a_slew_give_severe_warnings() -> None:
    """Random attitudes give severe warnings about the rate, the axes and the scatter. A true slew that differs from its
    command gives only one about the rate.
    """
    series = run(POLE, n=40, step_s=1.0)
    random_attitudes = replace(series, quaternion=Rotation.random(40, random_state=4).as_quat())
    slew = slew_test(random_attitudes, float(np.radians(0.5)))
    assert {w.code for w in slew.warnings if w.severe} >= {"rate", "axes", "scatter"}
    true_slew = run(np.array([0.0, np.radians(0.1333), 0.0]), n=40, step_s=1.0)
    assert {w.code for w in slew_test(true_slew, float(np.radians(0.2))).warnings if w.severe} == {"rate"}
    assert not any(w.severe for w in slew_test(true_slew, float(np.radians(0.1333))).warnings)


def test_the_detection_limit_is_found() -> None:
    """A detection probability that falls logistically at V 5.2 gives that limit within four σ. If 30 % of the stars are
    never detected, a warning states the ceiling. Without a limit in the data, an error is raised.
    """
    rng = np.random.default_rng(5)
    v = rng.uniform(2, 7, 4000)
    p = 1 / (1 + np.exp((v - 5.2) / 0.15))
    limit = detection_limit(v, rng.random(4000) < p)
    assert abs(limit.mag_50 - 5.2) < 4 * limit.sigma_50 < 0.2
    assert limit.mag_90 == pytest.approx(5.2 - 0.15 * np.log(9), abs=0.1)
    assert limit.stars.sum() == 4000
    clouded = detection_limit(v, rng.random(4000) < 0.7 * p)
    assert clouded.ceiling == pytest.approx(0.7, abs=0.05)
    assert "ceiling" in {w.code for w in clouded.warnings}
    with pytest.raises(BadInput, match="limit"):
        detection_limit(v, np.ones(4000, bool))


@pytest.mark.parametrize("ceiling", [1.0, 0.65])
def test_the_sigma_of_the_detection_limit_is_its_error(ceiling: float) -> None:
    """The σ of the magnitude at which half of the stars are detected agrees with its scatter, also if a part of the
    bright stars is missed."""
    rng = np.random.default_rng(9)
    limits = []
    for _ in range(200):
        v = rng.uniform(2, 8, 1500)
        limits.append(detection_limit(v, rng.random(1500) < ceiling / (1 + np.exp(3 * (v - 5.5)))))
    ratio = np.median([m.sigma_50 for m in limits]) / np.std([m.mag_50 for m in limits])
    assert ratio == pytest.approx(1, abs=0.18)


def test_noise_decreases_with_integration_time() -> None:
    """Noise proportional to 1/√t gives an exponent of −0.5. A run that is too short is excluded with a warning; one run
    is not enough for a curve.
    """
    runs = {
        t: run(POLE, n=200, noise_rad=NOISE_RAD / np.sqrt(t / 0.1), seed=k) for k, t in enumerate((0.1, 0.2, 0.4, 0.8))
    }
    curve = noise_equivalent_angle({**runs, 1.6: run(POLE, n=3)})
    assert abs(curve.exponent + 0.5) < 4 * curve.exponent_sigma < 0.3
    assert [w.code for w in curve.warnings] == ["short-run"]
    with pytest.raises(BadInput, match="for a curve"):
        noise_equivalent_angle({0.1: runs[0.1]})


def test_the_sigma_of_the_noise_is_its_error() -> None:
    """The relative σ of the noise agrees with the scatter of the rms of differences between consecutive frames, and the
    σ of the exponent follows from it."""
    n, exposures_s = 20, np.array([0.1, 0.4])
    curve = noise_equivalent_angle({float(t): run(POLE, n=n, seed=k) for k, t in enumerate(exposures_s)})
    steps = np.diff(np.random.default_rng(6).normal(size=(3000, n, 2)), axis=1)
    across = np.sqrt(np.mean(steps**2, axis=(1, 2)))
    assert curve.relative_sigma == pytest.approx(across.std() / across.mean(), rel=0.1)
    expected = np.sqrt(2) * curve.relative_sigma[0] / np.ptp(np.log(exposures_s))
    assert curve.exponent_sigma == pytest.approx(expected, rel=1e-6)


def test_two_cameras_give_their_mounting() -> None:
    """The mounting is found within its error, and the difference is consistent with both covariances. A drift gives a
    warning; runs without common times are rejected.
    """
    first = run(POLE, seed=1)
    mounting = Rotation.from_rotvec([0.3, -1.1, 0.4])
    second = run(POLE, seed=2)
    second = replace(second, quaternion=(mounting * Rotation.from_quat(second.quaternion)).as_quat())
    result = two_cameras(first, second)
    error_rad = (Rotation.from_quat(result.second_from_first) * mounting.inv()).magnitude()
    assert error_rad < 4 * np.sqrt(2) * np.linalg.norm(NOISE_RAD) / np.sqrt(300)
    assert result.pairs == 300
    assert result.chi == pytest.approx(1, abs=0.15)
    assert result.warnings == ()
    elapsed_s = second.times_s - second.times_s[0]
    drifting = replace(second, quaternion=turned(second.quaternion, np.outer(elapsed_s, [0.5 * ARCSEC_RAD, 0, 0])))
    assert "drift" in {w.code for w in two_cameras(first, drifting).warnings}
    with pytest.raises(BadInput, match="together"):
        two_cameras(first, replace(second, times_s=second.times_s + 1.0))


def test_a_drift_between_two_cameras_is_reported_for_short_runs() -> None:
    """For ten pairs, the σ of the drift is its error and not increased by the drift, a drift of 15 σ gives a warning, and
    the scatter agrees with correct covariances.
    """
    drift_rad_s, step_s = 15 * ARCSEC_RAD / 60, 60.0
    drifts, sigmas, chi2, warned = [], [], [], 0
    for seed in range(150):
        first, second = (run(POLE, n=10, step_s=step_s, seed=2 * seed + k) for k in range(2))
        chi2.append(two_cameras(first, second).chi ** 2)
        elapsed_s = second.times_s - second.times_s[0]
        drifting = turned(second.quaternion, np.outer(elapsed_s, [drift_rad_s, 0, 0]))
        result = two_cameras(first, replace(second, quaternion=drifting))
        drifts.append(result.axes[0].drift_rad_s)
        sigmas.append(result.axes[0].drift_sigma_rad_s)
        warned += "drift" in {w.code for w in result.warnings}
    assert np.mean(drifts) == pytest.approx(drift_rad_s, rel=0.05)
    assert np.sqrt(np.mean(np.square(sigmas))) / np.std(drifts) == pytest.approx(1, abs=0.15)
    assert warned > 140
    assert np.mean(chi2) == pytest.approx(1, abs=0.08)


def test_few_pairs_without_a_drift_give_no_drift_warning() -> None:
    """The probability of a false warning is below 0.1 % for five pairs."""
    warned = 0
    for seed in range(300):
        first, second = (run(POLE, n=5, step_s=60.0, seed=2 * seed + k) for k in range(2))
        warned += "drift" in {w.code for w in two_cameras(first, second).warnings}
    assert warned <= 2


def test_noise_is_measured_on_a_moving_satellite() -> None:
    """From the attitudes of a steadily rotating camera, the noise of each axis is measured within 15 %. Availability
    and outages are counted.
    """
    moving = run(np.array([1e-3, 2e-3, -5e-4]), n=600, step_s=1.0)
    figures = telemetry_statistics(with_unsolved(moving, list(range(100, 130))))
    assert np.allclose(figures.noise_rad, NOISE_RAD, rtol=0.15)
    assert np.median(figures.rate_rad_s) == pytest.approx(float(np.linalg.norm([1e-3, 2e-3, -5e-4])), rel=0.02)
    assert figures.availability == pytest.approx(570 / 600)
    assert figures.longest_outage_s == pytest.approx(31.0)
