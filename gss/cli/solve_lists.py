"""``gss solve-lists``: print the attitudes of lists of measured stars as text or JSON."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR
from gss.cli.input_files import TEXT_BYTES, read_file
from gss.cli.instruments import registry
from gss.cli.solve import NO_SOLUTION_EXIT, SOLVED_EXIT
from gss.domain.errors import BadInput
from gss.domain.results import Outcome

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.domain.camera import Camera
    from gss.operations.frames.measured_lists import ListResult

MAX_SIGMA_PX = 20.0


def register(subparsers: Commands) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "solve-lists",
        description="Find the attitude of each list of measured stars in a file, without a prior attitude. "
        "Exit code 0: all solved, 2: bad input, 3: no solution for at least one.",
    )
    parser.add_argument(
        "file",
        metavar="FILE",
        help=".npz with the arrays col_px, row_px, flux and first (offset of each list, then the number of stars), or .csv "
        "with the columns list, col_px, row_px and flux",
    )
    parser.add_argument(
        "--camera",
        metavar="NAME|FILE",
        required=True,
        help="instrument name (gss instrument list) or a camera file of an instrument package (camera.yaml)",
    )
    parser.add_argument("--no-distortion", action="store_true", help="the positions are already free of distortion")
    parser.add_argument(
        "--sigma-px",
        type=float,
        metavar="PX",
        default=0.2,
        help="standard deviation of a position per axis (default: 0.2)",
    )
    parser.add_argument("--epoch", type=float, metavar="YEAR", help="Julian year of the star positions (default: now)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Solve every list of the file."""
    from gss.cli.solve import julian_year
    from gss.operations.clock import processor_s, utc_now
    from gss.operations.frames.measured_list_files import MAX_LIST_BYTES, StarLists, read_star_lists
    from gss.operations.frames.measured_lists import StarListSolver, list_result, without_distortion
    from gss.operations.frames.solver_cache import SolverCache
    from gss.operations.parsing.parse_processes import ParseProcesses

    if not 0 < arguments.sigma_px <= MAX_SIGMA_PX:
        expected = f"more than 0, at most {MAX_SIGMA_PX:g}"
        raise BadInput("--sigma-px is out of range", expected=expected, got=f"{arguments.sigma_px:g}")
    low, high = EPOCH_RANGE_JYEAR
    epoch = round(julian_year(utc_now()), 2) if arguments.epoch is None else arguments.epoch
    if not low <= epoch <= high:
        raise BadInput("--epoch is out of range", expected=f"the years {low:g} to {high:g}", got=f"{epoch:g}")
    camera, faint_limit_mag = _camera(arguments.camera)
    if arguments.no_distortion:
        camera = without_distortion(camera)
    data = read_file(arguments.file, "a file of star lists", MAX_LIST_BYTES)
    name = Path(arguments.file).name
    with ParseProcesses() as parsing:
        lists = parsing.parse(read_star_lists, data, name, classes=(StarLists,), subject=name)
    solver = StarListSolver(camera, faint_limit_mag, epoch, SolverCache(), processor_s)
    results = [list_result(*solution) for solution in solver.solve(lists, arguments.sigma_px)]
    if arguments.json:
        record = {"file": arguments.file, "camera": arguments.camera, "epoch_jyear": epoch}
        print(json.dumps(record | {"results": [r.as_json() for r in results]}, allow_nan=False))
    else:
        print(_as_text(results))
    return SOLVED_EXIT if all(r.outcome is Outcome.SOLVED for r in results) else NO_SOLUTION_EXIT


def _camera(name: str) -> tuple[Camera, float]:
    """Return the camera of an instrument or of a camera file, and its magnitude limit. Raises BadInput and NotFound."""
    from gss.instruments.package import read_camera_file

    if name in registry().names() or not (Path(name).suffix or Path(name).exists()):
        profile = registry().camera(name)
        return profile.camera, profile.sensor.faint_limit_mag
    file = read_camera_file(Path(name).name, read_file(name, "a camera file", TEXT_BYTES))
    return file.camera(), file.limits.faintest.value


def _as_text(results: list[ListResult]) -> str:
    lines = []
    for number, result in enumerate(results):
        if result.outcome is not Outcome.SOLVED:
            lines.append(f"{number}: no solution, {result.reason}")
            continue
        ra, dec, roll = (math.degrees(a) for a in result.ra_dec_roll_rad)
        lines.append(f"{number}: RA {ra:.5f}°  Dec {dec:+.5f}°  roll {roll:.4f}°, {result.matched} stars identified")
        lines += [f"  {note}" for note in result.notes]
    solved = sum(r.outcome is Outcome.SOLVED for r in results)
    median_ms = sorted(r.processor_ms for r in results)[len(results) // 2]
    lines.append(f"{solved} of {len(results)} lists solved, median {median_ms:.2f} ms of processor time")
    return "\n".join(lines)
