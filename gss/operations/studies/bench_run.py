"""Runs a bench calibration as requested; used by both the server and the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gss.domain.errors import BadInput
from gss.domain.profiles import CameraProfile
from gss.operations.frames.solve import Solver
from gss.operations.studies import bench
from gss.operations.studies.calibrate import Found
from gss.operations.studies.calibration_requests import BenchCalibration
from gss.operations.studies.night_frames import Shot, Tell

WISHED_SIGMA_PX = 0.45
ORDER = 3


def run_bench(
    solver: Solver, wanted: BenchCalibration, known: CameraProfile | None, shots: Sequence[Shot], tell: Tell
) -> Found:
    """Return the result of the method. ``shots`` in the order of ``wanted.frame_ids``. Raises BadInput."""
    options = dict(wanted.options)

    def camera() -> CameraProfile:
        if known is None:
            raise BadInput("this method needs a camera", expected="a profile", got="none")
        return known

    def board() -> Found:
        if not {"corners", "square_mm"} <= set(options):
            raise BadInput("which board?", expected="inner corners across and down, and the side of a square")
        across, down = options["corners"]
        fit_k3 = bool(options.get("fit_k3", False))
        return bench.checkerboard(shots, known, (int(across), int(down)), float(options["square_mm"]), fit_k3)

    def focus() -> Found:
        wished = float(options.get("wished_sigma_px", WISHED_SIGMA_PX))
        if wanted.rows:
            return bench.focus_of_widths(wanted.rows, wished)
        return bench.focus(wanted.positions, shots, camera(), tell, wished)

    makers: dict[str, Callable[[], Found]] = {
        "bench-centre": lambda: bench.centre(wanted.rows),
        "bench-tilt": lambda: bench.tilt(wanted.rows, camera()),
        "bench-focal": lambda: bench.focal(solver, shots, camera(), tell, options.get("radius_px")),
        "bench-radial": lambda: bench.radial(solver, shots, camera(), tell, int(options.get("order", ORDER))),
        "bench-checkerboard": board,
        "bench-dark-law": lambda: bench.dark_law(wanted.rows),
        "bench-focus": focus,
    }
    return makers[wanted.kind]()
