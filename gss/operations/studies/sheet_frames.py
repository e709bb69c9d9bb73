"""Creates the performance sheet from frames of a unit or of a simulated unit."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.operations.clock import processor_s
from gss.operations.frames.measured_list_files import StarLists
from gss.operations.frames.measured_lists import StarListSolver
from gss.operations.frames.solve import Solver
from gss.operations.studies.analyse import AnalysisResult, AnalysisRun, subject_of
from gss.operations.studies.night_frames import ProgressCallback
from gss.operations.studies.reported import temperature_at
from gss.operations.studies.sensor_health import Surroundings, health_frames
from gss.operations.studies.sheet_record import SheetSource, as_sheet_record, sheet_report
from gss.operations.studies.sheet_simulation import simulated_input
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.sheet.ageing import ageing_of
from gss.pipeline.sheet.collect import pointing_blocks, star_sightings
from gss.pipeline.sheet.heads import ReferenceInput
from gss.pipeline.sheet.sheet import SheetInput, performance_sheet

ON_BOARD = "of the unit, on board"
"""Chain of attitudes that the unit reported."""


def sheet_of_frames(
    solver: Solver,
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
    frames = health_frames(solver, run, Surroundings())
    sheet_input = SheetInput(
        profile.camera,
        series,
        star_sightings(run.results, profile.camera, [f.stars for f in frames]),
        reference,
        ageing=ageing_of(frames, profile.sensor, np.random.default_rng([seed, 65])),
    )
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


def sheet_of_telemetry(
    solver: Solver,
    profile: CameraProfile,
    series: AttitudeSeries,
    lists: StarLists | None,
    subject: str,
    *,
    epoch_jyear: float,
    seed: int,
) -> AnalysisResult:
    """Return the performance sheet of attitudes that a sensor reported. The spatial errors are those of its star
    lists, which the ground solves; None if the sensor reported no star lists."""
    sightings = None
    if lists is not None:
        star_solver = StarListSolver(
            profile.camera, profile.sensor.faint_limit_mag, epoch_jyear, solver.cache, processor_s
        )
        sightings = star_sightings([result for result, _ in star_solver.solve(lists)], profile.camera)
    sheet_input = SheetInput(profile.camera, series, sightings)
    return _sheet(sheet_input, profile, SheetSource(profile.name, profile.title, ON_BOARD, "telemetry", subject, seed))


def _sheet(sheet_input: SheetInput, profile: CameraProfile, source: SheetSource) -> AnalysisResult:
    sheet = performance_sheet(sheet_input, np.random.default_rng([source.seed, 64]))
    return AnalysisResult("sheet", sheet_report(sheet, source, profile.camera), as_sheet_record(sheet, source))
