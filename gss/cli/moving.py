"""``gss moving``: objects that move against the stars in a sequence of frames."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from gss.cli.input_files import TEXT_BYTES, read_file
from gss.cli.instruments import CAMERA_HELP, camera, registry
from gss.cli.night import add_observer, add_report_file, shots_of, show_progress, write_report
from gss.domain.errors import BadInput
from gss.operations.clock import utc_now

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the command."""
    p = subparsers.add_parser(
        "moving",
        description="Links light sources without a star over the frames and prints positions with their errors, magnitudes and "
        "rates. Two-line elements and the planets give the names. Exit code 0: done, 2: bad input.",
    )
    p.add_argument("files", nargs="+", metavar="FRAME", help="frames of one sequence")
    p.add_argument("--camera", metavar="INSTRUMENT", required=True, help=CAMERA_HELP)
    p.add_argument("--chain", default="reference", metavar="NAME", help="chain to run (default: reference)")
    p.add_argument("--objects", metavar="FILE", help="two-line elements of the objects that may be in view")
    p.add_argument("--orbit", metavar="FILE", help="orbit of the spacecraft with the camera: TLE, OMM or OEM")
    p.add_argument("--site", metavar="LAT,LON,M", help="place of a camera on the ground: degrees and metres")
    p.add_argument("--rate", type=float, default=2.0, metavar="DEG_S", help="largest rate searched for (default: 2)")
    p.add_argument("--interval", type=float, metavar="S", help="seconds between images without a time stamp")
    p.add_argument("--exposure", type=float, metavar="S", help="exposure of images without this information")
    add_observer(p)
    add_report_file(p, ".tdm", text="; .tdm: CCSDS TDM")
    p.add_argument("--json", action="store_true", help="print one JSON object")
    p.set_defaults(run=run)


def run(a: argparse.Namespace) -> int:
    """Find the objects, write and print them."""
    from gss.operations.frames.solve import Solver
    from gss.operations.requests import request_from
    from gss.operations.studies.analyse import run_frames
    from gss.operations.studies.analysis_requests import MovingRequest
    from gss.operations.studies.moving_objects import moving_objects

    # Files have no ids yet; the numbers only let the request check itself.
    request = request_from(
        MovingRequest,
        {
            "kind": "moving",
            "profile": a.camera,
            "frame_ids": list(range(1, len(a.files) + 1)),
            "chain": a.chain,
            "objects": _text(a.objects, "two-line elements"),
            "orbit": _text(a.orbit, "an orbit file"),
            "site": None if a.site is None else _numbers(a.site),
            "top_rate_deg_s": a.rate,
        },
    )
    profile, solver = camera(a.camera), Solver(registry().camera)
    shots = shots_of(a.files, a.interval, a.exposure, a.keep_aberration)
    outcome = moving_objects(
        solver,
        run_frames(solver, shots, profile, a.chain, lambda share, text: show_progress(share / 2, text)),
        objects=request.objects,
        place=request.place,
        top_rate_rad_s=request.top_rate_rad_s,
        created=utc_now(),
        progress=show_progress,
    )
    whole = json.dumps(outcome.figures, ensure_ascii=False, allow_nan=False)
    write_report(a, outcome.report, whole, {".tdm": str(outcome.figures["tdm"]).encode})
    return 0


def _text(name: str | None, kind: str) -> str:
    """Return the content of a file, "" without one."""
    return "" if name is None else read_file(name, kind, TEXT_BYTES).decode("utf-8", "replace")


def _numbers(text: str) -> list[float]:
    try:
        return [float(v) for v in text.split(",")]
    except ValueError:
        raise BadInput("the site is not three numbers", expected="latitude,longitude,height", got=text) from None
