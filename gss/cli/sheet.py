"""``gss sheet``: create the performance sheet of a unit from its frames, or of a simulated unit."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from gss.cli.instruments import CAMERA_HELP, camera, registry
from gss.cli.night import add_observer, add_report_file, shots_of, show_progress, write_report
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.studies.night_frames import Shot


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "sheet",
        description="Accuracy in the terms of ECSS-E-ST-60-20C: bias, spatial errors, noise, acquisition and more, each with "
        "interval, method and conditions. A row without data states which data it needs. Exit code 0: done, 2: bad input.",
    )
    parser.add_argument("files", nargs="*", metavar="FRAME", help="frames of the unit in order of time")
    parser.add_argument("--camera", metavar="INSTRUMENT", help=CAMERA_HELP)
    parser.add_argument("--simulate", action="store_true", help="render the frames of a simulated unit instead")
    parser.add_argument(
        "--chain",
        default="",
        metavar="NAME",
        help="chain to run (default: the chain of the unit, or reference if it has none)",
    )
    parser.add_argument(
        "--second", nargs="+", default=[], metavar="FRAME", help="frames of a second head, taken at the same times"
    )
    parser.add_argument("--second-camera", metavar="INSTRUMENT", help="camera of the second head (default: the same)")
    parser.add_argument(
        "--mounting", metavar="X,Y,Z,W", help="quaternion from the second head to the camera, from ground alignment"
    )
    parser.add_argument("--interval", type=float, metavar="S", help="seconds between images without a time stamp")
    parser.add_argument("--exposure", type=float, metavar="S", help="exposure of images without this information")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed of intervals and simulated frames (default: 1)"
    )
    add_observer(parser)
    add_report_file(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--schema", action="store_true", help="print the JSON schema of the sheet and stop")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Create the sheet, then write and print it."""
    if arguments.schema:
        from pydantic import TypeAdapter

        from gss.operations.studies.sheet_record import SheetValues

        print(json.dumps(TypeAdapter(SheetValues).json_schema(), indent=1, ensure_ascii=False))
        return 0
    from gss.operations.frames.solve import Solver
    from gss.operations.requests import request_from
    from gss.operations.studies.analyse import chain_for, run_frames
    from gss.operations.studies.analysis_requests import SheetRequest
    from gss.operations.studies.sheet_frames import sheet_of_frames, sheet_of_simulation

    if not arguments.camera:
        raise BadInput("no camera given", expected="--camera INSTRUMENT")
    mounting = None if arguments.mounting is None else _numbers(arguments.mounting)
    # Files have no ids, but the request requires ids.
    request = request_from(
        SheetRequest,
        {
            "kind": "sheet",
            "profile": arguments.camera,
            "simulated": arguments.simulate,
            "frame_ids": list(range(1, len(arguments.files) + 1)),
            "chain": arguments.chain,
            "other_profile": (arguments.second_camera or arguments.camera) if arguments.second else "",
            "other_ids": list(range(1, len(arguments.second) + 1)),
            "mounting": mounting,
            "seed": arguments.seed,
        },
    )
    profile, solver = camera(arguments.camera), Solver(registry().camera)
    if request.simulated:
        chain = chain_for(arguments.chain, profile)
        sheet = sheet_of_simulation(solver, profile, chain, arguments.seed, show_progress)
    else:
        chain = chain_for(arguments.chain, profile)
        first = run_frames(solver, _shots(arguments, arguments.files), profile, chain, show_progress)
        other = camera(arguments.second_camera) if arguments.second_camera else profile
        second = (
            run_frames(
                solver, _shots(arguments, arguments.second), other, chain_for(arguments.chain, other), show_progress
            )
            if arguments.second
            else None
        )
        sheet = sheet_of_frames(
            solver, first, second=second, mounting=tuple(mounting) if mounting else None, seed=arguments.seed
        )
    write_report(arguments, sheet.report, json.dumps(sheet.figures, ensure_ascii=False, allow_nan=False))
    return 0


def _shots(arguments: argparse.Namespace, files: list[str]) -> list[Shot]:
    return shots_of(files, arguments.interval, arguments.exposure, arguments.keep_aberration)


def _numbers(text: str) -> list[float]:
    try:
        return [float(v) for v in text.split(",")]
    except ValueError:
        raise BadInput("the mounting is not four numbers", expected="X,Y,Z,W", got=text) from None
