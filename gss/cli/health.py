"""``gss health``: analyse the health of a sensor from frames of a mission."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from gss.cli.input_files import TEXT_BYTES, read_file
from gss.cli.instruments import CAMERA_HELP, camera, registry
from gss.cli.night import add_observer, add_report_file, shots_of, show_progress, write_report
from gss.cli.temperatures import add_temperatures, read_temperatures

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "health",
        description="Report trends of focal length, centre, distortion, focus and sensitivity with jumps and a forecast, warm "
        "pixels with onset and annealing, dark level and radiation hits. Needs 30 frames or more over weeks to years; any attitude "
        "is suitable. Exit code 0: done, 2: bad input.",
    )
    parser.add_argument("files", nargs="+", metavar="FRAME", help="frames of one camera with their times in the files")
    parser.add_argument("--camera", metavar="INSTRUMENT", required=True, help=CAMERA_HELP)
    parser.add_argument("--chain", default="reference", metavar="NAME", help="chain to run (default: reference)")
    parser.add_argument(
        "--orbit", metavar="FILE", help="orbit of the spacecraft for the radiation map: TLEs, OMM or OEM"
    )
    add_temperatures(parser)
    parser.add_argument(
        "--exposure", type=float, metavar="S", help="exposure time of images whose files do not state it"
    )
    add_observer(parser)
    add_report_file(parser, ".csv", text="; .csv: warm pixels")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Analyse the frames, then write and print the report."""
    from gss.operations.frames.solve import Solver
    from gss.operations.requests import request_from
    from gss.operations.studies.analyse import run_frames
    from gss.operations.studies.analysis_requests import HealthRequest
    from gss.operations.studies.sensor_health import (
        Surroundings,
        bad_pixel_table,
        orbit_within,
        places_below,
        sensor_health,
    )

    orbit = (
        ""
        if arguments.orbit is None
        else read_file(arguments.orbit, "an orbit file", TEXT_BYTES).decode("utf-8", "replace")
    )
    # Files have no ids, but the request requires ids.
    request = request_from(
        HealthRequest,
        {
            "kind": "health",
            "profile": arguments.camera,
            "frame_ids": list(range(1, len(arguments.files) + 1)),
            "chain": arguments.chain,
            "orbit": orbit,
        },
    )
    temperatures = read_temperatures(arguments.temperatures)
    profile, solver = camera(arguments.camera), Solver(registry().camera)
    shots = shots_of(arguments.files, None, arguments.exposure, arguments.keep_aberration, timed=True)
    solved = run_frames(solver, shots, profile, arguments.chain, lambda share, text: show_progress(share / 2, text))
    surroundings = Surroundings(temperatures, places_below(orbit_within(request.trajectories)))
    outcome = sensor_health(solver, solved, surroundings, lambda share, text: show_progress(0.5 + share / 2, text))
    content = json.dumps(outcome.figures, ensure_ascii=False, allow_nan=False)
    write_report(arguments, outcome.report, content, {".csv": lambda: bad_pixel_table(outcome.figures)})
    return 0
