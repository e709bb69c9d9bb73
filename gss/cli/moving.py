"""``gss moving``: detect objects that move relative to the stars in a sequence of frames."""

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
    parser = subparsers.add_parser(
        "moving",
        description="Links light sources without a star over the frames and prints positions with their errors, magnitudes and "
        "rates. Objects are identified with two-line elements and planet positions. Exit code 0: done, 2: bad input.",
    )
    parser.add_argument("files", nargs="+", metavar="FRAME", help="frames of one sequence")
    parser.add_argument("--camera", metavar="INSTRUMENT", required=True, help=CAMERA_HELP)
    parser.add_argument("--chain", default="reference", metavar="NAME", help="chain to run (default: reference)")
    parser.add_argument("--objects", metavar="FILE", help="two-line elements of objects that can be in view")
    parser.add_argument("--orbit", metavar="FILE", help="orbit of the spacecraft with the camera: TLE, OMM or OEM")
    parser.add_argument("--site", metavar="LAT,LON,M", help="position of a camera on the ground: degrees and metres")
    parser.add_argument(
        "--rate", type=float, default=2.0, metavar="DEG_S", help="largest rate of the search (default: 2)"
    )
    parser.add_argument("--interval", type=float, metavar="S", help="seconds between images without a time stamp")
    parser.add_argument("--exposure", type=float, metavar="S", help="exposure of images without this information")
    add_observer(parser)
    add_report_file(parser, ".tdm", text="; .tdm: CCSDS TDM")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Detect the objects, then write and print the report."""
    from gss.operations.frames.solve import Solver
    from gss.operations.requests import request_from
    from gss.operations.studies.analyse import run_frames
    from gss.operations.studies.analysis_requests import MovingRequest
    from gss.operations.studies.moving_objects import moving_objects

    # Files have no ids, but the request requires ids.
    request = request_from(
        MovingRequest,
        {
            "kind": "moving",
            "profile": arguments.camera,
            "frame_ids": list(range(1, len(arguments.files) + 1)),
            "chain": arguments.chain,
            "objects": _text(arguments.objects, "two-line elements"),
            "orbit": _text(arguments.orbit, "an orbit file"),
            "site": None if arguments.site is None else _numbers(arguments.site),
            "top_rate_deg_s": arguments.rate,
        },
    )
    profile, solver = camera(arguments.camera), Solver(registry().camera)
    shots = shots_of(arguments.files, arguments.interval, arguments.exposure, arguments.keep_aberration, timed=True)
    outcome = moving_objects(
        solver,
        run_frames(solver, shots, profile, arguments.chain, lambda share, text: show_progress(share / 2, text)),
        objects=request.objects,
        place=request.place,
        top_rate_rad_s=request.top_rate_rad_s,
        created=utc_now(),
        progress=show_progress,
    )
    content = json.dumps(outcome.figures, ensure_ascii=False, allow_nan=False)
    write_report(arguments, outcome.report, content, {".tdm": str(outcome.figures["tdm"]).encode})
    return 0


def _text(name: str | None, kind: str) -> str:
    """Return the content of a file; "" if no file is given."""
    return "" if name is None else read_file(name, kind, TEXT_BYTES).decode("utf-8", "replace")


def _numbers(text: str) -> list[float]:
    try:
        return [float(v) for v in text.split(",")]
    except ValueError:
        raise BadInput("the site is not three numbers", expected="latitude,longitude,height", got=text) from None
