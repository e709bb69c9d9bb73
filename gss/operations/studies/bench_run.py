"""Runs a requested bench calibration, for the server and the command line."""

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
    BenchSecondLens,
    BenchTilt,
)
from gss.operations.studies.night_frames import ProgressCallback, Shot


def run_bench(
    solver: Solver,
    request: BenchCalibration,
    profile: CameraProfile | None,
    shots: Sequence[Shot],
    progress: ProgressCallback,
) -> CalibrationInput:
    """Return the result of the requested method. ``shots``: in the order of ``request.frames``. Raises BadInput."""
    match request:
        case BenchCentre():
            return bench.centre(request.dots_px)
        case BenchSecondLens():
            return bench.second_lens(shots, profile)
        case BenchDarkLaw():
            return bench.dark_law(request.points)
        case BenchCheckerboard():
            across, down = request.corners
            return bench.checkerboard(shots, profile, (across, down), request.square_mm, request.fit_k3)
        case BenchFocus() if request.widths:
            return bench.focus_of_widths(request.widths, request.wished_sigma_px)
    if profile is None:
        raise BadInput("this method needs a camera", expected="a profile", got="none")
    match request:
        case BenchTilt():
            return bench.tilt(request.pairs_px, profile)
        case BenchFocal():
            return bench.focal(solver, shots, profile, progress, request.radius_px)
        case BenchRadial():
            return bench.radial(solver, shots, profile, progress, request.order)
        case BenchFocus():
            return bench.focus(request.positions, shots, profile, progress, request.wished_sigma_px)
    raise BadInput("unknown method of bench calibration", expected=" | ".join(bench.KINDS), got=type(request).__name__)
