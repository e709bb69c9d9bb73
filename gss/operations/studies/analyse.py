"""Analyses the frames of a night or the attitudes of a contact, for the server and the command line."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.results import SolveResult
from gss.domain.words import counted
from gss.operations.frames.solve import Solver
from gss.operations.report.parts import Report
from gss.operations.studies import analysis_sheets as sheets
from gss.operations.studies.night_frames import ProgressCallback, Shot, apparent_stars, request_of
from gss.pipeline.analysis.integration import noise_equivalent_angle
from gss.pipeline.analysis.sensitivity import detection_limit
from gss.pipeline.analysis.series import AttitudeSeries, series_of
from gss.pipeline.analysis.slew import slew_test
from gss.pipeline.analysis.steady import celestial_fixed, earth_fixed
from gss.pipeline.analysis.telemetry import telemetry_statistics
from gss.pipeline.analysis.two_cameras import two_cameras
from gss.pipeline.calibration.plain_values import as_record
from gss.pipeline.chains import reference

KINDS = (
    "earth-fixed",
    "celestial-fixed",
    "slew",
    "sensitivity",
    "nea",
    "spatial",
    "two-cameras",
    "telemetry",
)
FRAME_KINDS = KINDS[:-1]
TIMED_KINDS = ("earth-fixed", "celestial-fixed", "slew", "nea", "two-cameras", "sheet")
"""Kinds of analyses of frames that compare the attitudes over time."""
DEEPER_MAG = 4.0
"""Stars are searched for up to this number of magnitudes below the profile's limit, so that the range includes the true
limit."""
FOUND_PX = 2.5
EDGE_PX = 8.0


@dataclass(frozen=True)
class AnalysisResult:
    """Result of an analysis. ``figures``: values of the report for programs, in radians, seconds and pixels, with the
    names of the pipeline."""

    kind: str
    report: Report
    figures: Mapping[str, Any]


@dataclass(frozen=True)
class AnalysisRun:
    """Shots of one camera with their results, in order of time. A result is None if the shot could not be processed."""

    shots: list[Shot]
    results: list[SolveResult | None]
    profile: CameraProfile

    @property
    def series(self) -> AttitudeSeries:
        """Attitudes over time."""
        return series_of([s.taken.timestamp() for s in self.shots], self.results)


def check_kind(kind: str, commanded_rad_s: float | None, other_count: int) -> None:
    """Raise BadInput if the kind does not exist or an argument that it requires is missing."""
    if kind not in KINDS:
        raise BadInput("unknown analysis", expected=" | ".join(KINDS), got=kind)
    if kind == "slew" and not (commanded_rad_s is not None and 0 < commanded_rad_s < math.radians(20)):
        got = "none" if commanded_rad_s is None else f"{math.degrees(commanded_rad_s):g}°/s"
        raise BadInput("a slew test needs the commanded rate", expected="above 0, below 20°/s", got=got)
    if (kind == "two-cameras") != (other_count > 0):
        raise BadInput(
            "frames of a second camera are missing or cannot be used",
            expected="a second camera for two-cameras, and only for this analysis",
            got=counted(other_count, "frame"),
        )


def chain_for(chain: str, profile: CameraProfile) -> str:
    """Return the given chain. If it is empty, return the chain of the unit, or the reference chain if it has none."""
    return chain or profile.chain or reference.NAME


def run_frames(
    solver: Solver, shots: Sequence[Shot], profile: CameraProfile, chain: str, progress: ProgressCallback
) -> AnalysisRun:
    """Run a chain on every shot. A shot of another camera counts as not solved. Raises BadInput if no shot is
    solved."""
    ordered = sorted(shots, key=lambda s: (s.taken, s.name))
    results: list[SolveResult | None] = []
    reason = ""
    for k, shot in enumerate(ordered):
        progress(k / len(ordered), f"{shot.name}, {k + 1} of {len(ordered)}")
        try:
            results.append(solver.solve(shot.pixels(), request_of(shot, profile, None, chain)))
        except BadInput as error:
            results.append(None)
            reason = reason or str(error)
    if not any(r is not None and r.attitude is not None for r in results):
        first_reason = next((r.reason for r in results if r is not None), reason)
        raise BadInput(
            "no frame could be solved",
            expected="frames of stars",
            got=first_reason,
            hint="check that the frames were taken with this camera",
        )
    return AnalysisRun(ordered, results, profile)


def analyse(
    kind: str,
    solver: Solver,
    run: AnalysisRun,
    *,
    second: AnalysisRun | None = None,
    commanded_rad_s: float | None = None,
) -> AnalysisResult:
    """Return the analysis of a run. Raises BadInput."""
    check_kind(kind, commanded_rad_s, 0 if second is None else len(second.shots))
    makers: dict[str, Callable[[], AnalysisResult]] = {
        "earth-fixed": lambda: _steady(kind, run),
        "celestial-fixed": lambda: _steady(kind, run),
        "slew": lambda: _slew(run, commanded_rad_s or 0.0),
        "sensitivity": lambda: _sensitivity(run, solver),
        "nea": lambda: _nea(run),
        "spatial": lambda: _spatial(run),
        "two-cameras": lambda: _two(run, second or run),
    }
    return makers[kind]()


def analyse_telemetry(series: AttitudeSeries, subject: str) -> AnalysisResult:
    """Analyse performance from attitudes alone, without frames. ``subject``: subtitle of the report."""
    statistics = telemetry_statistics(series)
    return AnalysisResult("telemetry", sheets.telemetry(statistics, series, subject), dict(as_record(statistics)))


def _steady(kind: str, run: AnalysisRun) -> AnalysisResult:
    series = run.series
    statistics = earth_fixed(series) if kind == "earth-fixed" else celestial_fixed(series)
    return AnalysisResult(kind, sheets.steady(kind, statistics, series, subject_of(run)), dict(as_record(statistics)))


def _slew(run: AnalysisRun, commanded_rad_s: float) -> AnalysisResult:
    slew = slew_test(run.series, commanded_rad_s)
    return AnalysisResult("slew", sheets.slew(slew, run.series, subject_of(run)), dict(as_record(slew)))


def _sensitivity(run: AnalysisRun, solver: Solver) -> AnalysisResult:
    v_mag: list[Array] = []
    detected: list[NDArray[np.bool_]] = []
    for shot, result in zip(run.shots, run.results, strict=True):
        if result is None or result.attitude is None:
            continue
        v, hit = detected_stars(result, solver, shot, run.profile.sensor.faint_limit_mag + DEEPER_MAG)
        v_mag.append(v)
        detected.append(hit)
    limit = detection_limit(np.concatenate(v_mag), np.concatenate(detected))
    return AnalysisResult(
        "sensitivity", sheets.sensitivity(limit, run.profile, subject_of(run)), dict(as_record(limit))
    )


def detected_stars(
    result: SolveResult, solver: Solver, shot: Shot, faintest_mag: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the magnitudes of the catalogue stars on the detector up to ``faintest_mag``, and for each star whether a
    centroid was detected at its predicted position. A star close to a brighter star is excluded, because a centroid
    near it could belong to the brighter star."""
    assert result.attitude is not None  # noqa: S101 - the caller has checked it
    stars = apparent_stars(solver, shot).brighter_than(faintest_mag)
    cam = stars.icrs @ result.attitude.cam_from_icrs.T
    ahead = cam[:, 2] > math.cos(result.camera.diagonal_rad / 2 + 0.02)
    pixels = np.full((len(stars), 2), np.nan)
    pixels[ahead] = result.camera.project(cam[ahead])
    limit = np.array([result.camera.columns, result.camera.rows]) - 0.5 - EDGE_PX
    on_detector = ahead & ((pixels > EDGE_PX - 0.5) & (pixels < limit)).all(axis=1)
    spots = result.centroids.pixels
    star_pixels, v = pixels[on_detector], stars.v_mag[on_detector]
    gap = np.linalg.norm(star_pixels[:, None] - star_pixels[None, :], axis=2)
    np.fill_diagonal(gap, np.inf)
    isolated = ~((gap < 2 * FOUND_PX) & (v[None, :] <= v[:, None])).any(axis=1)
    if not len(spots):
        return v[isolated], np.zeros(int(isolated.sum()), bool)
    nearest_px = np.linalg.norm(star_pixels[:, None] - spots[None, :], axis=2).min(axis=1)
    return v[isolated], np.asarray(nearest_px[isolated] <= FOUND_PX)


def _nea(run: AnalysisRun) -> AnalysisResult:
    groups: dict[float, list[int]] = {}
    for k, shot in enumerate(run.shots):
        if shot.exposure_s is not None:
            groups.setdefault(shot.exposure_s, []).append(k)
    if not groups:
        raise BadInput("no frame states its exposure time", hint="import frames whose header has EXPTIME")
    runs = {
        t: replace(run, shots=[run.shots[k] for k in at], results=[run.results[k] for k in at]).series
        for t, at in groups.items()
    }
    nea = noise_equivalent_angle(runs)
    return AnalysisResult("nea", sheets.nea(nea, subject_of(run)), dict(as_record(nea)))


def _spatial(run: AnalysisRun) -> AnalysisResult:
    pixels, residual = [], []
    for result in run.results:
        if result is not None and result.matches is not None and result.attitude is not None:
            weighted = result.matches.weight > 0
            pixels.append(result.centroids.pixels[result.matches.centroid[weighted]])
            residual.append(result.matches.residual_px[weighted])
    pixels_px, residual_px = np.concatenate(pixels), np.concatenate(residual)
    report, figures = sheets.spatial(pixels_px, residual_px, run.profile.camera, subject_of(run))
    return AnalysisResult("spatial", report, figures)


def _two(first: AnalysisRun, second: AnalysisRun) -> AnalysisResult:
    comparison = two_cameras(first.series, second.series)
    subject = f"{subject_of(first)}, and {subject_of(second)}"
    return AnalysisResult("two-cameras", sheets.two_cameras(comparison, subject), dict(as_record(comparison)))


def subject_of(run: AnalysisRun) -> str:
    """Return the subtitle of a report: frames, camera, time span and chain."""
    first, last = run.shots[0].taken, run.shots[-1].taken
    version = run.profile.sources.get("calibration", "")
    camera = f"{run.profile.name}, {version}" if version else run.profile.name
    chain = next((r.chain for r in run.results if r is not None), "")
    last_text = f"{last:%H:%M:%S}Z" if last.date() == first.date() else f"{last:%Y-%m-%d %H:%M:%S}Z"
    span = f"{first:%Y-%m-%d %H:%M:%S}Z to {last_text}"
    if not all(shot.time_known for shot in run.shots):
        span = "time unknown"
    return f"{counted(len(run.shots), 'frame')} of {camera}, {span}, chain {chain}"
