"""Creates the performance sheet from frames of a unit or of a simulated unit."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.operations.frames.solve import Solver
from gss.operations.studies.analyse import AnalysisResult, AnalysisRun, subject_of
from gss.operations.studies.night_frames import ProgressCallback
from gss.operations.studies.sheet_record import SheetSource, as_sheet_record, sheet_report
from gss.operations.studies.sheet_simulation import simulated_input
from gss.pipeline.sheet.collect import pointing_blocks, star_sightings
from gss.pipeline.sheet.heads import ReferenceInput
from gss.pipeline.sheet.sheet import SheetInput, performance_sheet

NEAR_S = 600.0
"""Maximum distance in seconds between a frame and the nearest packet for the interpolation of temperature."""


def sheet_of_frames(
    run: AnalysisRun,
    *,
    second: AnalysisRun | None = None,
    mounting: tuple[float, ...] | None = None,
    temperature: tuple[Array, Array] | None = None,
    seed: int = 1,
) -> AnalysisResult:
    """Return the performance sheet of solved frames. ``second``: frames of a second head; ``mounting``: quaternion
    camera from second head; ``temperature``: Unix seconds and °C of the unit."""
    profile, series = run.profile, run.series
    # The shots are in the same order as the series, which is sorted by time.
    observers = [s.observer for s in run.shots]
    reference = None
    if second is not None:
        velocity = None
        if all(o is not None for o in observers):
            velocity = np.array([o.velocity_c for o in observers if o is not None])
        reference = ReferenceInput(
            series,
            second.series,
            pointing_blocks(series.quaternion, profile.camera),
            None if mounting is None else np.array(mounting) / np.linalg.norm(mounting),
            None if temperature is None else temperature_at(series.times_s, *temperature),
            velocity,
        )
    sheet_input = SheetInput(profile.camera, series, star_sightings(run.results, profile.camera), reference)
    chain = next((r.chain for r in run.results if r is not None), "")
    return _sheet(
        sheet_input, profile, SheetSource(profile.name, profile.title, chain, "frames", subject_of(run), seed)
    )


def sheet_of_simulation(
    solver: Solver, profile: CameraProfile, chain: str, seed: int, progress: ProgressCallback
) -> AnalysisResult:
    """Return the performance sheet of a simulated unit."""
    sheet_input = simulated_input(solver, profile, chain, seed, progress)
    subject = f"simulated unit of {profile.name}, {len(sheet_input.series)} frames, seed {seed}, chain {chain}"
    return _sheet(sheet_input, profile, SheetSource(profile.name, profile.title, chain, "simulated", subject, seed))


def _sheet(sheet_input: SheetInput, profile: CameraProfile, source: SheetSource) -> AnalysisResult:
    sheet = performance_sheet(sheet_input, np.random.default_rng([source.seed, 64]))
    return AnalysisResult("sheet", sheet_report(sheet, source, profile.camera), as_sheet_record(sheet, source))


def temperature_at(times_s: Array, at_s: Array, celsius: Array) -> Array | None:
    """Return the (n,) temperatures at (n,) times; None if a time has no packet within NEAR_S."""
    temperatures_c = temperature_near(times_s, at_s, celsius)
    return temperatures_c if np.isfinite(temperatures_c).all() else None


def temperature_near(times_s: Array, at_s: Array, celsius: Array) -> Array:
    """Return the (n,) temperatures at (n,) times; NaN for times without a packet within NEAR_S."""
    if not len(at_s):
        return np.full(len(times_s), np.nan)
    index = np.clip(np.searchsorted(at_s, times_s), 1, max(1, len(at_s) - 1))
    last = np.minimum(index, len(at_s) - 1)
    gap = np.minimum(np.abs(at_s[last] - times_s), np.abs(at_s[index - 1] - times_s))
    return np.where(gap <= NEAR_S, np.interp(times_s, at_s, celsius), np.nan)
