"""``gss sheet``: create the performance sheet of a unit from its frames or telemetry, or of a simulated unit."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.instruments import CAMERA_HELP, camera, registry
from gss.cli.night import add_observer, add_report_file, shots_of, show_progress, write_report
from gss.cli.temperatures import add_temperatures, read_temperatures
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.studies.analyse import AnalysisResult
    from gss.operations.studies.analysis_requests import SheetRequest
    from gss.operations.studies.night_frames import Shot

MOST_IDS = 5000


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "sheet",
        description="Accuracy in the terms of ECSS-E-ST-60-20C: bias, spatial errors, noise, acquisition and more, each with "
        "interval, method and conditions. A row without data states which data it needs. Exit code 0: done, 2: bad input.",
    )
    parser.add_argument("files", nargs="*", metavar="FRAME", help="frames of the unit in order of time")
    parser.add_argument("--camera", metavar="INSTRUMENT", help=CAMERA_HELP)
    parser.add_argument(
        "--data", type=Path, help="data folder of a server (GSS_DATA), for the options --stored and --contact"
    )
    parser.add_argument(
        "--stored",
        type=_ids,
        metavar="IDS",
        help="stored frames, for example 1-60,75; the temperatures come from the stored telemetry",
    )
    parser.add_argument("--second-stored", type=_ids, metavar="IDS", help="stored frames of a second head")
    parser.add_argument(
        "--contact",
        type=int,
        metavar="N",
        help="attitudes and star lists in the telemetry of a contact instead of frames",
    )
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
    add_temperatures(parser)
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

        print(json.dumps(TypeAdapter(SheetValues).json_schema(), indent=1))
        return 0
    if not arguments.camera:
        raise BadInput("no camera given", expected="--camera INSTRUMENT")
    if arguments.stored or arguments.contact is not None:
        sheet = _of_store(arguments)
    elif arguments.simulate:
        sheet = _simulated(arguments)
    else:
        sheet = _of_files(arguments)
    write_report(arguments, sheet.report, json.dumps(sheet.figures, ensure_ascii=False, allow_nan=False))
    return 0


def _of_store(arguments: argparse.Namespace) -> AnalysisResult:
    """Compute the sheet from stored frames or telemetry, with the same functions as the page. The server can run."""
    from gss.cli.records import services_of

    if arguments.files or arguments.second:
        raise BadInput("stored frames and files cannot be combined", expected="--stored or files")
    request = _request(arguments, arguments.stored or [], arguments.second_stored or [])
    services = services_of(arguments)
    return services.studies.analyses.sheet(request, lambda done, total, text: show_progress(done / total, text))


def _simulated(arguments: argparse.Namespace) -> AnalysisResult:
    from gss.operations.frames.solve import Solver
    from gss.operations.studies.analyse import chain_for
    from gss.operations.studies.sheet_frames import sheet_of_simulation

    _request(arguments, [], [])
    profile, solver = camera(arguments.camera), Solver(registry().camera)
    return sheet_of_simulation(solver, profile, chain_for(arguments.chain, profile), arguments.seed, show_progress)


def _of_files(arguments: argparse.Namespace) -> AnalysisResult:
    from gss.operations.frames.solve import Solver
    from gss.operations.studies.analyse import chain_for, run_frames
    from gss.operations.studies.sheet_frames import sheet_of_frames

    # Files have no ids, but the request requires ids.
    ids = [list(range(1, len(files) + 1)) for files in (arguments.files, arguments.second)]
    request = _request(arguments, *ids)
    temperature = read_temperatures(arguments.temperatures)
    profile, solver = camera(arguments.camera), Solver(registry().camera)
    chain = chain_for(arguments.chain, profile)
    first = run_frames(solver, _shots(arguments, arguments.files), profile, chain, show_progress)
    second = None
    if arguments.second:
        other = camera(request.other_profile)
        other_chain = chain_for(arguments.chain, other)
        second = run_frames(solver, _shots(arguments, arguments.second), other, other_chain, show_progress)
    mounting = None if request.mounting is None else tuple(request.mounting)
    return sheet_of_frames(
        solver, first, second=second, mounting=mounting, temperature=temperature, seed=arguments.seed
    )


def _request(arguments: argparse.Namespace, ids: list[int], other_ids: list[int]) -> SheetRequest:
    """Return the validated request of the arguments."""
    from gss.operations.requests import request_from
    from gss.operations.studies.analysis_requests import SheetRequest

    values = {
        "kind": "sheet",
        "profile": arguments.camera,
        "simulated": arguments.simulate,
        "contact": arguments.contact,
        "frame_ids": ids,
        "chain": arguments.chain,
        "other_profile": (arguments.second_camera or arguments.camera) if other_ids else "",
        "other_ids": other_ids,
        "mounting": None if arguments.mounting is None else _numbers(arguments.mounting),
        "seed": arguments.seed,
    }
    return request_from(SheetRequest, values)


def _ids(text: str) -> list[int]:
    """Return the numbers of a list of numbers and ranges, for example 1-60,75."""
    ids: list[int] = []
    for part in text.split(","):
        low, _, high = part.partition("-")
        if not (low.isdecimal() and (high or low).isdecimal()) or int(high or low) - int(low) >= MOST_IDS:
            raise argparse.ArgumentTypeError(f"expected numbers and ranges, for example 1-60,75; got {text}")
        ids += range(int(low), int(high or low) + 1)
    return ids


def _shots(arguments: argparse.Namespace, files: list[str]) -> list[Shot]:
    return shots_of(files, arguments.interval, arguments.exposure, arguments.keep_aberration, timed=True)


def _numbers(text: str) -> list[float]:
    try:
        return [float(v) for v in text.split(",")]
    except ValueError:
        raise BadInput("the mounting is not four numbers", expected="X,Y,Z,W", got=text) from None
