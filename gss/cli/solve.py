"""``gss solve``: print the attitudes of image files as text or JSON."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR
from gss.cli.input_files import TEXT_BYTES, TLE_BYTES, read_file, read_limited
from gss.cli.instruments import CAMERA_HELP, registry
from gss.cli.lean_numpy import hide_build_tools
from gss.cli.solve_record import as_record, as_text
from gss.domain.angles import Array
from gss.domain.errors import BadInput, GssError, NotFound
from gss.domain.results import Outcome

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.frames.frame_files import ImportedFrame
    from gss.operations.frames.observer import Observer
    from gss.operations.parsing.parse_processes import ParseProcesses

FEW_FILES = 8
"""Up to this number of files, the numpy loops are used: the compiled ones take longer to load than they save."""
SOLVED_EXIT, FAILED_EXIT, BAD_INPUT_EXIT, NO_SOLUTION_EXIT = 0, 1, 2, 3
J2000_UNIX_S = 946_727_935.8
JULIAN_YEAR_S = 365.25 * 86400


def register(subparsers: Commands) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "solve",
        description="Find the attitude of images of the sky (FITS, PNG, TIFF, JPEG). Exit code 0: all solved, "
        "2: bad input, 3: no solution for at least one.",
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="image of the sky")
    camera = parser.add_mutually_exclusive_group(required=True)
    camera.add_argument("--camera", metavar="INSTRUMENT", help=f"calibrated camera: {CAMERA_HELP}")
    camera.add_argument("--fov-deg", type=float, metavar="X", help="horizontal field of view, accurate to about 5 %%")
    camera.add_argument("--blind", action="store_true", help="the field of view is unknown, between 4° and 60°")
    parser.add_argument("--chain", default="reference", metavar="NAME", help="chain to run (default: reference)")
    parser.add_argument(
        "--epoch",
        type=float,
        metavar="YEAR",
        help="Julian year of the star positions (default: the image's date, else now)",
    )
    parser.add_argument(
        "--hint",
        metavar="RA,DEC,ROLL[,RADIUS]",
        help="prior attitude and its uncertainty in degrees (with --camera; 5°)",
    )
    parser.add_argument(
        "--sequence",
        action="store_true",
        help="the files are a sequence: each solution is the hint of the next, and rates are reported (with --camera)",
    )
    parser.add_argument(
        "--interval",
        type=float,
        metavar="S",
        help="seconds between the images of a sequence without time stamps, or with time stamps too coarse to differ",
    )
    parser.add_argument(
        "--truth",
        metavar="RA,DEC,ROLL|FILE",
        help="true attitude in degrees, or a JSON file {file name: [RA, DEC, ROLL]}, or "
        "truth.json of gss render; a wrong result gives exit code 1",
    )
    parser.add_argument(
        "--utc",
        metavar="TIME",
        help="time of the image, ISO 8601 (default: the file's date): corrects aberration",
    )
    parser.add_argument("--tle", metavar="FILE", help="two-line element set of the satellite that carried the camera")
    parser.add_argument(
        "--keep-aberration", action="store_true", help="do not correct aberration even if the time is known"
    )
    parser.add_argument(
        "--exposure", type=float, metavar="S", help="exposure time: the rate is estimated from trailed stars"
    )
    parser.add_argument(
        "--plain",
        action="store_true",
        help="use the numpy loops, as for a few files, even if the compiled ones are ready",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="change a constant of a chain, for example matcher=star_vectors or attitude_method=foam; see docs/chains.md",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, one object per file and line")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Solve each file. The worst outcome determines the exit code."""
    from gss.operations.parsing.parse_processes import ParseProcesses

    if (arguments.hint or arguments.sequence) and arguments.camera is None:
        raise BadInput("a hint or a sequence needs a calibrated camera", expected="--camera PROFILE")
    files, codes = arguments.files, []
    truths = read_truths(arguments.truth, files)
    with ParseProcesses() as parsing, ThreadPoolExecutor(1) as reader:
        reading = reader.submit(_read, files[0], parsing)
        hide_build_tools()
        # The import of the solver takes as long as the first image, and each image as long as the solution before it.
        from gss.operations.clock import stopwatch_s
        from gss.operations.frames.figure_files import users_folder
        from gss.operations.frames.image_sequence import Sequencer
        from gss.operations.frames.solve import Solver
        from gss.operations.frames.solver_cache import SolverCache

        solver = Solver(cache(lambda name: registry().camera(name)), SolverCache(folder=users_folder()), stopwatch_s)
        sequencer = Sequencer(arguments.sequence, arguments.interval, prior(arguments.hint))
        for k, name in enumerate(files):
            image, reading = reading, reader.submit(_read, files[k + 1], parsing) if k + 1 < len(files) else reading
            try:
                codes.append(
                    _solve_image(name, image.result(), arguments, solver, sequencer, truths.get(Path(name).name))
                )
            except GssError as error:
                sequencer.skip()
                print(f"gss: {error.sentences()}", file=sys.stderr)
                codes.append(BAD_INPUT_EXIT if isinstance(error, BadInput | NotFound) else FAILED_EXIT)
    return _worst(codes)


def _worst(codes: Sequence[int]) -> int:
    return next((c for c in (FAILED_EXIT, BAD_INPUT_EXIT, NO_SOLUTION_EXIT) if c in codes), SOLVED_EXIT)


def _read(name: str, parsing: ParseProcesses) -> ImportedFrame:
    """Read an image file in a child process. Raises BadInput or NotFound."""
    from gss.operations.frames.frame_files import MAX_BYTES, ImportedFrame, read_frame

    data = read_file(name, "an image file", MAX_BYTES)
    return parsing.parse(read_frame, data, name, classes=(ImportedFrame,), subject=name)


def _solve_image(
    name: str, frame: ImportedFrame, arguments: argparse.Namespace, solver: Any, sequencer: Any, truth: Any
) -> int:
    from gss.operations.clock import utc_now
    from gss.operations.frames.image_sequence import truth_record
    from gss.operations.frames.solve import SolveRequest
    from gss.pipeline.chains.options import parse

    taken = frame.taken_at if arguments.utc is None else moment(arguments.utc)
    exposed_at = frame.seen_at if arguments.utc is None else taken
    epoch = arguments.epoch if arguments.epoch is not None else julian_year(taken or utc_now())
    exposure_s = frame.exposure_s if arguments.exposure is None else arguments.exposure
    check_exposure(exposure_s)
    request = SolveRequest(
        chain=arguments.chain,
        profile=arguments.camera,
        fov_rad=None if arguments.fov_deg is None else math.radians(arguments.fov_deg),
        blind=arguments.blind,
        epoch_jyear=round(epoch, 2),
        observer=None if arguments.keep_aberration else _observer(exposed_at, arguments.tle),
        exposure_s=exposure_s,
        fast=False if arguments.plain or len(arguments.files) <= FEW_FILES else None,
        options=tuple(parse(arguments.set).items()),
    )
    result, rate = sequencer.solve(solver, frame.pixels, request, taken)
    record = as_record(name, result)
    if arguments.sequence:
        record["rate"] = rate
    truth_result = None if truth is None else truth_record(result, truth, solver.cache.stars(request.epoch_jyear))
    if truth is not None:
        record["truth"] = truth_result
    print(json.dumps(record, allow_nan=False) if arguments.json else as_text(record))
    if truth_result is not None and truth_result["verdict"] == "wrong":
        return FAILED_EXIT
    return SOLVED_EXIT if result.outcome is Outcome.SOLVED else NO_SOLUTION_EXIT


def _observer(exposed_at: datetime | None, tle: str | None) -> Observer | None:
    """Return the motion of the observer, or None if the time is unknown. Raises BadInput."""
    if exposed_at is None:
        return None
    from gss.operations.frames.observer import observer_at

    return observer_at(exposed_at, _tle(tle))


def prior(text: str | None) -> Any:
    """Return the prior attitude of ``--hint``; None if there is no hint. Raises BadInput."""
    from gss.pipeline.identify.near import BoundedPrior

    if text is None:
        return None
    numbers = angles(text, (3, 4), "RA,DEC,ROLL[,RADIUS] in degrees")
    radius_deg = numbers[3] if len(numbers) == 4 else 5.0
    if not 0 < radius_deg <= 180:
        raise BadInput("radius of the hint is out of range", expected="above 0, at most 180°", got=f"{radius_deg:g}°")
    return BoundedPrior(attitude(numbers), math.radians(radius_deg))


def read_truths(text: str | None, files: Sequence[str]) -> dict[str, Array]:
    """Return the true attitudes by file name. Raises BadInput."""
    if text is None:
        return {}
    if not Path(text).is_file():
        truth = attitude(angles(text, (3,), "RA,DEC,ROLL in degrees, or a JSON file"))
        return {Path(name).name: truth for name in files}
    try:
        rows = json.loads(read_limited(Path(text), TEXT_BYTES))
        angles_of = {name: row["attitude_deg"] if isinstance(row, dict) else row for name, row in rows.items()}
        truths = {str(name): attitude(_three_angles(row)) for name, row in angles_of.items()}
    except (ValueError, TypeError, KeyError, AttributeError, UnicodeDecodeError) as error:
        raise BadInput(
            "unreadable truth",
            expected="{file name: [RA, DEC, ROLL]} in degrees, or truth.json of gss render",
            got=str(error),
        ) from error
    if missing := [name for name in files if Path(name).name not in truths]:
        raise BadInput("the truth lacks an image", expected="the name of each image", got=f"no {Path(missing[0]).name}")
    return truths


def _three_angles(row: Sequence[float]) -> list[float]:
    numbers = [float(v) for v in row]
    if len(numbers) != 3 or not all(math.isfinite(v) for v in numbers):
        raise ValueError(f"{row}")
    return numbers


def check_exposure(exposure_s: float | None) -> None:
    """Raise BadInput for an exposure time that no camera has."""
    from gss.operations.frames.frame_files import MAX_EXPOSURE_S

    if exposure_s is not None and not 0 < exposure_s <= MAX_EXPOSURE_S:
        expected = f"more than 0, at most {MAX_EXPOSURE_S:g} s"
        raise BadInput("exposure is out of range", expected=expected, got=f"{exposure_s:g} s")


def angles(text: str, counts: tuple[int, ...], expected: str) -> list[float]:
    """Return numbers separated by commas. Raises BadInput."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts or not all(math.isfinite(v) for v in numbers):
        raise BadInput("unreadable angles", expected=expected, got=text)
    return numbers


def attitude(angles_deg: Sequence[float]) -> Array:
    """Return the (3, 3) attitude cam_from_icrs of right ascension, declination and roll. Raises BadInput."""
    from gss.domain.frames import cam_from_icrs

    ra, dec, roll = angles_deg[:3]
    if not -90 <= dec <= 90:
        raise BadInput("declination is out of range", expected="−90° – 90°", got=f"{dec:g}°")
    return cam_from_icrs(math.radians(ra), math.radians(dec), math.radians(roll))


def moment(text: str) -> datetime:
    """Return an ISO 8601 time, in UTC if it has no time zone. Raises BadInput."""
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("unreadable time", expected="ISO 8601, such as 2026-11-21T18:05:00Z", got=text) from None
    low, high = EPOCH_RANGE_JYEAR
    # Outside this range, the Earth's motion and the proper motions are not accurate, and dates overflow.
    if not low <= time.year < high:
        raise BadInput("time is out of range", expected=f"the years {low:g} to {high:g}", got=text[:40])
    return time if time.tzinfo is not None else time.replace(tzinfo=UTC)


def _tle(name: str | None) -> str | None:
    if name is None:
        return None
    return read_file(name, "a two-line element set", TLE_BYTES).decode("ascii", "replace")


def julian_year(time: datetime) -> float:
    """Return the Julian epoch of a time. Leap seconds and TT − UTC are neglected, because their effect on proper motion
    is negligible."""
    return 2000.0 + (time.timestamp() - J2000_UNIX_S) / JULIAN_YEAR_S
