"""Performance sheet: each error, injected alone into star lists, is found in its own row and within its interval."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_from_vector,
    turn_between,
    turned,
)
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.attitude import svd
from gss.pipeline.sheet.collect import star_sightings
from gss.pipeline.sheet.heads import ReferenceInput, reference_errors
from gss.pipeline.sheet.noise import allan_deviation
from gss.pipeline.sheet.rows import share_figure
from gss.pipeline.sheet.sheet import PerformanceSheet, SheetInput, performance_sheet
from gss.pipeline.sheet.spatial import StarSightings, rotation_effect, spatial_errors
from gss.pipeline.sheet.trials import Trials

CAMERA = Camera.from_fov(640, 480, float(np.radians(15.0)))
NOISE_PX = 0.03


@dataclass
class Unit:
    """Errors of a synthetic star tracker. ``field_px``: cubic distortion that remains at the corner; ``wave_px``:
    amplitude of the error periodic in a pixel; ``fixed_px``: constant error of each pixel; ``noise_px``: noise of one
    star.
    """

    field_px: float = 0.0
    wave_px: float = 0.0
    fixed_px: float = 0.0
    noise_px: float = NOISE_PX
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(5))

    def __post_init__(self) -> None:
        chip = np.random.default_rng(99)
        self.pixels = chip.normal(size=(CAMERA.rows, CAMERA.columns, 2)) * self.fixed_px

    def error(self, true_px: Array) -> Array:
        """Return the (k, 2) systematic error at the true positions."""
        u = (true_px - np.array([CAMERA.columns, CAMERA.rows]) / 2) / (CAMERA.columns / 2)
        distortion = self.field_px * u * (u**2).sum(axis=1, keepdims=True) + self.field_px * np.column_stack(
            [u[:, 1] ** 2, 0 * u[:, 0]]
        )
        wave = self.wave_px * np.sin(2 * np.pi * true_px)
        nearest_px = np.rint(true_px).astype(int)
        return distortion + wave + self.pixels[nearest_px[:, 1], nearest_px[:, 0]]


def measure_stars(unit: Unit, attitudes: list[Array]) -> tuple[AttitudeSeries, StarSightings]:
    """Measure the stars at each attitude and fit the attitude to them."""
    stars = load_stars(6.5)
    frame, pixels, residual, hip, fitted, covariance = [], [], [], [], [], []
    for k, attitude in enumerate(attitudes):
        in_view = stars.icrs @ attitude[2] > np.cos(CAMERA.half_diagonal_rad)
        icrs = stars.icrs[in_view]
        true_px = CAMERA.project(icrs @ attitude.T)
        inside = CAMERA.contains(true_px, 3)
        true_px, icrs = true_px[inside], icrs[inside]
        measured = true_px + unit.error(true_px) + unit.noise_px * unit.rng.normal(size=true_px.shape)
        fit = svd(CAMERA.unproject(measured), icrs)
        frame += [k] * len(true_px)
        pixels.append(measured)
        residual.append(measured - CAMERA.project(icrs @ fit.T))
        hip.append(stars.hip[in_view][inside])
        fitted.append(quaternion_from_matrix(fit))
        covariance.append(np.eye(3) * 1e-10)
    n = len(attitudes)
    moved_px = np.arccos(np.clip([a[2] @ b[2] for a, b in pairwise(attitudes)], -1, 1)) / CAMERA.pixel_rad
    block = np.r_[0, np.cumsum(np.cumsum(moved_px) // 5 != np.r_[0, np.cumsum(moved_px)[:-1] // 5])].astype(np.intp)
    ones = np.ones(n, np.intp)
    series = AttitudeSeries(
        np.arange(n) * 1.0, np.array(fitted), np.array(covariance), ones * 9, ones * 9, np.full(n, 0.1)
    )
    stars_seen = StarSightings(
        np.array(frame, np.intp),
        np.concatenate(pixels),
        np.concatenate(residual),
        np.ones(len(frame)),
        np.concatenate(hip),
        block,
    )
    return series, stars_seen


def scan_attitudes(count: int, seed: int = 3) -> list[Array]:
    """Return random attitudes, each followed by two more in steps of a fiftieth of a pixel about both axes."""
    rng = np.random.default_rng(seed)
    attitudes = []
    for _ in range(count):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        attitudes += [
            rotation_from_vector(CAMERA.pixel_rad * 0.02 * k * np.array([1.0, 1.0, 0.0])) @ attitude for k in range(3)
        ]
    return attitudes


def sheet_of(unit: Unit, count: int = 60) -> PerformanceSheet:
    """Return the sheet of a scan measured by the unit."""
    series, stars = measure_stars(unit, scan_attitudes(count))
    return performance_sheet(SheetInput(CAMERA, series, stars), np.random.default_rng(1))


def expected_rad(unit: Unit, count: int = 60) -> Array:
    """Return the (3,) rms attitude error that the systematic errors of a unit cause, without noise."""
    attitudes = scan_attitudes(count)
    with_error, _ = measure_stars(replace(unit, noise_px=0.0), attitudes)
    rotation_rad = turn_between(np.array([quaternion_from_matrix(c) for c in attitudes]), with_error.quaternion)
    return np.asarray((rotation_rad - rotation_rad.mean(axis=0)).std(axis=0))


CASES = {
    "field": Unit(field_px=0.5),
    "wave": Unit(wave_px=0.05),
    "fixed": Unit(fixed_px=0.05),
    "none": Unit(),
}


@pytest.fixture(scope="module")
def sheets() -> dict[str, PerformanceSheet]:
    """Return the sheet of each case."""
    return {name: sheet_of(replace(unit, rng=np.random.default_rng(5))) for name, unit in CASES.items()}


Sheets = dict[str, PerformanceSheet]


def test_a_field_error_appears_in_its_row(sheets: Sheets) -> None:
    """Distortion that calibration did not remove appears as the attitude error that it causes, and not as an error
    within the pixel.
    """
    sheet, truth = sheets["field"], expected_rad(CASES["field"])
    for axis, true in zip("xyz", truth, strict=True):
        figure = sheet.row("field-of-view").figure(axis)
        assert figure.low <= true <= figure.high
        assert sheet.row("pixel").figure(f"periodic {axis}").low == 0
    assert sheet.row("pixel").figure("one star, fixed").low == 0


def test_rejected_stars_are_part_of_the_field_error() -> None:
    """A chain that rejects residuals above a limit keeps the stars whose noise cancels the error of the lens. With the
    rejected stars at weight 0, the error of a star is found; without them it is too small by more than its interval."""
    unit = Unit(field_px=0.3)
    _, stars = measure_stars(unit, scan_attitudes(60))
    true = spatial_errors(stars, CAMERA, np.random.default_rng(1)).field_star
    accepted = np.linalg.norm(stars.residual_px, axis=1) < 0.12
    with_rejected = replace(stars, weight=accepted.astype(float))
    names = ("frame", "pixels", "residual_px", "weight", "hip")
    without = replace(stars, **{name: getattr(stars, name)[accepted] for name in names})
    complete, truncated = (spatial_errors(s, CAMERA, np.random.default_rng(1)) for s in (with_rejected, without))
    # The error of the accepted stars, from the fit to all stars, is compared with the true error at these stars.
    off = unit.error((stars.pixels - stars.residual_px)[accepted])
    effect = rotation_effect(CAMERA, stars.pixels[accepted]).reshape(-1, 3)
    left = off.ravel() - effect @ np.linalg.lstsq(effect, off.ravel(), rcond=None)[0]
    expected = float(np.sqrt(np.mean(left**2)))
    assert complete.field_star.low_px <= expected <= complete.field_star.high_px
    assert truncated.field_star.high_px < expected < true.value_px
    assert truncated.sightings < complete.sightings


def test_detections_near_a_single_star_are_added() -> None:
    """Detections that the chain did not identify are added with weight 0 if exactly one star and no other detection is
    near them."""
    stars = load_stars(6.5)
    attitude = matrix_from_quaternion(random_quaternion(np.random.default_rng(8)))
    in_view = np.flatnonzero(stars.icrs @ attitude[2] > np.cos(CAMERA.half_diagonal_rad))
    places = CAMERA.project(stars.icrs[in_view] @ attitude.T)
    inside = CAMERA.contains(places, 5)
    in_view, places = in_view[inside], places[inside]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e3 * np.eye(len(places))
    alone = np.flatnonzero(apart.min(axis=1) > 20)
    rng = np.random.default_rng(9)
    noise = 0.03 * rng.normal(size=(len(alone), 2))
    noise[0], noise[1], noise[2] = (0.3, 0.0), (3.0, 0.0), (0.2, 0.0)
    pixels = np.concatenate([places[alone] + noise, places[alone[2:3]] + (3.0, 0.0)])
    n, m = len(pixels), np.arange(3, len(alone), dtype=np.int32)
    ones, area = np.ones(n), np.full(n, 9, np.int32)
    spots = Centroids(pixels[:, 0], pixels[:, 1], ones, ones, area, 0.03 * ones)
    matches = Matches(m, stars.hip[in_view[alone[m]]].astype(np.int32), np.ones(len(m)), noise[m])
    fit = Attitude(quaternion_from_matrix(attitude), np.eye(3) * 1e-10)
    solved = SolveResult("reference", Outcome.SOLVED, "", CAMERA, (), spots, matches, fit, 0.0)
    seen = star_sightings([solved], CAMERA, [stars])
    assert seen is not None
    added = np.flatnonzero(seen.weight == 0)
    assert seen.hip[added].tolist() == [int(stars.hip[in_view[alone[0]]])]
    assert seen.residual_px[added[0]] == pytest.approx((0.3, 0.0), abs=1e-9)
    plain = star_sightings([solved], CAMERA)
    assert plain is not None
    assert len(plain) == len(m)


def test_an_error_periodic_in_a_pixel_appears_in_its_row(sheets: Sheets) -> None:
    """The periodic error of a centroid formula appears with its amplitude, and not as an error over the field."""
    sheet, truth = sheets["wave"], expected_rad(CASES["wave"])
    for axis, true in zip("xyz", truth, strict=True):
        figure = sheet.row("pixel").figure(f"periodic {axis}")
        assert figure.low <= true <= figure.high
        assert sheet.row("field-of-view").figure(axis).low == 0
    star = sheet.row("pixel").figure("one star, fixed")
    assert star.low <= CASES["wave"].wave_px / np.sqrt(2) <= star.high


def test_a_fixed_pattern_appears_in_its_row(sheets: Sheets) -> None:
    """A constant error of each pixel is found from stars that return to the same pixels, and appears neither as a field
    error nor as a periodic error.
    """
    sheet = sheets["fixed"]
    star = sheet.row("pixel").figure("one star, fixed")
    assert star.low <= CASES["fixed"].fixed_px <= star.high
    assert sheet.row("pixel").figure("one star, periodic").low == 0
    assert sheet.row("field-of-view").figure("one star").low == 0


def test_noise_alone_gives_no_spatial_error(sheets: Sheets) -> None:
    """Without spatial errors, the intervals of all spatial figures include zero."""
    for key in ("field-of-view", "pixel"):
        assert all(f.low == 0 for f in sheets["none"].row(key).figures)


def test_temporal_noise_is_found(sheets: Sheets) -> None:
    """The noise of one attitude is found from consecutive frames, with and without a field error. A row without enough
    pointings states what it needs.
    """
    count = 90
    attitudes = [rotation_from_vector(CAMERA.pixel_rad * 0.02 * k * np.array([1.0, 0, 0])) for k in range(count)]
    for unit in (Unit(), Unit(field_px=0.5)):
        series, stars = measure_stars(unit, attitudes)
        clean, _ = measure_stars(replace(unit, noise_px=0.0), attitudes)
        truth = turn_between(clean.quaternion, series.quaternion).std(axis=0)
        sheet = performance_sheet(SheetInput(CAMERA, series, stars), np.random.default_rng(1))
        row = sheet.row("temporal-noise")
        assert all(row.figure(a).low <= t <= row.figure(a).high for a, t in zip("xyz", truth, strict=True))
        assert not sheet.row("field-of-view").measured
        assert "pointings" in sheet.row("field-of-view").needs


def test_allan_deviation_of_white_noise_decreases_with_the_root_of_time() -> None:
    """For independent values, the Allan deviation is their σ at the shortest time and half of it at four times that
    time.
    """
    noise = np.random.default_rng(1).normal(size=(4000, 3))
    times_s, allan = allan_deviation(noise, 2.0)
    assert times_s[0] == 2.0
    assert allan[0] == pytest.approx(1.0, abs=0.05)
    assert allan[2] == pytest.approx(0.5, abs=0.05)


ERRORS = {"bias": 20 * ARCSEC_RAD, "thermal": 2 * ARCSEC_RAD, "date": 0.05, "aberration": 1.0}


def reference_input(injected: str) -> ReferenceInput:
    """Return a camera with one error and its true attitudes, over an orbit with oscillating rates and temperatures."""
    rng = np.random.default_rng(8)
    n = 480
    times_s = np.arange(n) * 12.0
    rate = np.radians(0.3) * np.sin(2 * np.pi * times_s / 900)[:, None] * np.array([0.6, 0.8, 0.0])
    attitude = [np.array([0.1, 0.2, 0.3, 0.9]) / np.linalg.norm([0.1, 0.2, 0.3, 0.9])]
    for k in range(n - 1):
        attitude.append(turned(attitude[-1], -0.5 * (rate[k] + rate[k + 1]) * 12.0))
    true = np.array(attitude)
    temperature_c = 20 + 8 * np.sin(2 * np.pi * times_s / 5700)
    velocity = 1e-4 * np.column_stack(
        [np.cos(2 * np.pi * times_s / 5600), np.sin(2 * np.pi * times_s / 5600), 0.2 + 0 * times_s]
    )
    error_rad = 1 * ARCSEC_RAD * rng.normal(size=(n, 3))
    axis = np.array([1.0, -1.0, 0.5])
    if injected == "bias":
        error_rad = error_rad + ERRORS["bias"] * axis
    if injected == "thermal":
        error_rad = error_rad + ERRORS["thermal"] * axis * (temperature_c - temperature_c.mean())[:, None]
    if injected == "date":
        error_rad = error_rad - ERRORS["date"] * rate
    if injected == "aberration":
        velocity_cam = np.einsum("nij,nj->ni", np.array([matrix_from_quaternion(q) for q in true]), velocity)
        error_rad = error_rad + np.cross(np.array([0.0, 0, 1.0]), velocity_cam)
    ones, covariance = np.ones(n, np.intp), np.full((n, 3, 3), 1e-11)
    camera = AttitudeSeries(
        times_s,
        np.array([turned(q, d) for q, d in zip(true, error_rad, strict=True)]),
        covariance,
        ones,
        ones,
        np.ones(n),
    )
    reference = AttitudeSeries(times_s, true, covariance, ones, ones, np.ones(n))
    block = np.arange(n, dtype=np.intp) // 12
    return ReferenceInput(
        camera, reference, block, np.array([0, 0, 0, 1.0]), temperature_c, velocity, true_reference=True
    )


@pytest.mark.parametrize("injected", ERRORS)
def test_errors_against_a_reference_are_separated(injected: str) -> None:
    """Bias, thermo-elastic, date and aberration errors each appear in their own row and in no other."""
    errors = reference_errors(reference_input(injected), np.random.default_rng(2))
    axis = np.array([1.0, -1.0, 0.5])
    truth = {
        "bias": ERRORS["bias"] * axis * (injected == "bias"),
        "thermal": ERRORS["thermal"] * axis * (injected == "thermal"),
        "date": np.array([ERRORS["date"] * (injected == "date")]),
        "aberration": np.array([ERRORS["aberration"] * (injected == "aberration")]),
    }
    fits = {"bias": errors.bias, "thermal": errors.thermal, "date": errors.date_s, "aberration": errors.aberration}
    for name, true in truth.items():
        fit = fits[name]
        assert fit is not None
        width = fit.high - fit.low
        # Eight intervals of 95 % are tested, so the limit is wider than half an interval.
        assert (np.abs(fit.value - true) <= 0.9 * width + 1e-12).all(), name


def test_rows_without_data_state_what_they_need() -> None:
    """Rows that need other data, such as a second head, are not measured and state the data that they need."""
    sheet = sheet_of(Unit(), 12)
    for key in ("bias", "thermo-elastic", "aberration", "date", "end-of-life", "robustness"):
        row = sheet.row(key)
        assert not row.measured
        assert row.needs


def test_trials_give_shares_with_intervals() -> None:
    """Acquisition counts correct, false and missing attitudes. If none of twenty is false, the upper bound of their
    share is still above zero.
    """
    series, stars = measure_stars(Unit(), scan_attitudes(4))
    sheet_input = SheetInput(CAMERA, series, stars, acquisition=Trials("at rest", 20, 19, 0, np.full(19, 1e-5)))
    row = performance_sheet(sheet_input, np.random.default_rng(1)).row("acquisition")
    assert row.figure("correct").value == 0.95
    assert row.figure("false").value == 0
    assert row.figure("false").high > 0.1
    assert row.figure("none") == share_figure("none", 1, 20)


def test_too_few_pointings_are_rejected() -> None:
    """Stars from too few pointings are rejected, because they cannot show errors that vary over the detector."""
    _, stars = measure_stars(Unit(), scan_attitudes(2))
    with pytest.raises(BadInput, match="too few stars"):
        spatial_errors(stars, CAMERA, np.random.default_rng(1))
