"""Runs a bench calibration as requested; used by both the server and the command line."""

from __future__ import annotations

from collections.abc import Sequence

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.operations.frames.solve import Solver
from gss.operations.studies import bench
from gss.operations.studies.calibrate import CalibrationInput
from gss.operations.studies.calibration_requests import (
    BenchCalibration,
    BenchCentre,
    BenchCheckerboard,
    BenchDarkLaw,
    BenchFocal,
    BenchFocus,
    BenchRadial,
    BenchTilt,
)
from gss.operations.studies.night_frames import ProgressCallback, Shot


def run_bench(
    solver: Solver,
    wanted: BenchCalibration,
    known: CameraProfile | None,
    shots: Sequence[Shot],
    progress: ProgressCallback,
) -> CalibrationInput:
    """Return the result of the method. ``shots`` in the order of ``wanted.frames``. Raises BadInput."""
    match wanted:
        case BenchCentre():
            return bench.centre(wanted.dots_px)
        case BenchDarkLaw():
            return bench.dark_law(wanted.points)
        case BenchCheckerboard():
            across, down = wanted.corners
            return bench.checkerboard(shots, known, (across, down), wanted.square_mm, wanted.fit_k3)
        case BenchFocus() if wanted.widths:
            return bench.focus_of_widths(wanted.widths, wanted.wished_sigma_px)
    if known is None:
        raise BadInput("this method needs a camera", expected="a profile", got="none")
    match wanted:
        case BenchTilt():
            return bench.tilt(wanted.pairs_px, known)
        case BenchFocal():
            return bench.focal(solver, shots, known, progress, wanted.radius_px)
        case BenchRadial():
            return bench.radial(solver, shots, known, progress, wanted.order)
        case BenchFocus():
            return bench.focus(wanted.positions, shots, known, progress, wanted.wished_sigma_px)
    raise BadInput("unknown method of the bench", expected=" | ".join(bench.KINDS), got=type(wanted).__name__)
