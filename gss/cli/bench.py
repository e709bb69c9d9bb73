"""``gss bench``: calibrate one part of a camera from bench measurements or a few frames."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.input_files import TEXT_BYTES, read_limited
from gss.cli.instruments import CAMERA_HELP, registry
from gss.cli.instruments import camera as camera_of
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.studies.calibration_requests import BenchCalibration

TABLE = "CSV file of numbers; lines that do not start with a number are ignored"


def register(subparsers: Commands) -> None:
    """Add the command and its methods."""
    from gss.cli.night import add_report_file

    p = subparsers.add_parser(
        "bench",
        description="Methods of Jacobs 1995 ch. 6 and Erlank 2013 §5.4. Exit code 0: done, 2: bad input.",
    )
    methods = p.add_subparsers(dest="method", required=True, metavar="METHOD")

    def method(name: str, description: str, camera: bool = True) -> argparse.ArgumentParser:
        parser = methods.add_parser(name, help=description, description=description)
        parser.add_argument("--camera", metavar="INSTRUMENT", required=camera, help=CAMERA_HELP)
        add_report_file(parser)
        parser.add_argument("--json", action="store_true", help="print one JSON object")
        parser.set_defaults(run=run_bench_command)
        return parser

    q = method("dots", "optical centre from positions of one dot while the camera rotates about its axis", camera=False)
    q.add_argument("file", metavar="FILE.csv", help=f"col,row at each rotation. {TABLE}")
    q = method("second-lens", "principal point from pictures through a second lens that faces the camera", camera=False)
    q.add_argument("files", nargs="+", metavar="IMAGE", help="pictures of the circle of light")
    q = method("tilt", "tilt of the detector from positions of two dots while the camera rotates")
    q.add_argument("file", metavar="FILE.csv", help=f"inner col,row, outer col,row at each rotation. {TABLE}")
    q = method("focal-pairs", "focal length from pairs of stars near the optical centre")
    q.add_argument("files", nargs="+", metavar="FRAME", help="frames of stars")
    q.add_argument("--radius", type=float, metavar="PX", help="distance from the centre (default: half of the field)")
    _add_observer_option(q)
    q = method("radial", "polynomial of lens aberration from stars around a star near the optical centre")
    q.add_argument("files", nargs="+", metavar="FRAME", help="frames of stars")
    q.add_argument("--order", type=int, default=3, help="order of the polynomial, 1 to 4 (default 3)")
    _add_observer_option(q)
    q = method("checkerboard", "focal length, centre and distortion from pictures of a checkerboard", camera=False)
    q.add_argument("files", nargs="+", metavar="IMAGE", help="pictures of the board, three or more")
    q.add_argument("--corners", required=True, metavar="9x6", help="inner corners across and down")
    q.add_argument("--square-mm", type=float, required=True, metavar="MM", help="side of a square")
    q.add_argument("--k3", action="store_true", help="also fit the third radial coefficient")
    q = method("dark-law", "dark current as a function of temperature", camera=False)
    q.add_argument("file", metavar="FILE.csv", help=f"temperature in °C, electrons per second. {TABLE}")
    q = method("focus", "best setting of the lens from pictures of stars at several settings, or from their widths")
    q.add_argument("files", nargs="*", metavar="FRAME", help="pictures of stars, one or more at each setting")
    q.add_argument("--at", metavar="A,B,…", help="focus setting of each picture")
    q.add_argument("--widths", metavar="FILE.csv", help=f"instead of pictures: setting, σ in px. {TABLE}")
    q.add_argument("--wished-sigma", type=float, default=0.45, metavar="PX", help="required width (default 0.45)")


def _add_observer_option(parser: argparse.ArgumentParser) -> None:
    from gss.cli.night import add_observer

    add_observer(parser)


def run_bench_command(arguments: argparse.Namespace) -> int:
    """Run the method, write the result and print it."""
    from gss.cli.night import output_calibration, shots_of, show_progress
    from gss.operations.frames.solve import Solver
    from gss.operations.studies.bench_run import run_bench

    profile = camera_of(arguments.camera) if arguments.camera else None
    files: Sequence[str] = getattr(arguments, "files", [])
    bench_request = _request(arguments, profile.name if profile else "", len(files))
    shots = shots_of(files, None, None, getattr(arguments, "keep_aberration", True))
    result = run_bench(Solver(registry().camera), bench_request, profile, shots, show_progress)
    name = Path(files[0] if files else getattr(arguments, "file", None) or arguments.widths).name
    output_calibration(arguments, result, profile, name)
    return 0


def _request(arguments: argparse.Namespace, camera: str, pictures: int) -> BenchCalibration:
    """Return the request. The files are numbered from 1, because they have no frame ids. Raises BadInput."""
    from gss.operations.requests import request_from
    from gss.operations.studies import calibration_requests as requests

    models: dict[str, type[BenchCalibration]] = {
        "dots": requests.BenchCentre,
        "second-lens": requests.BenchSecondLens,
        "tilt": requests.BenchTilt,
        "dark-law": requests.BenchDarkLaw,
        "focal-pairs": requests.BenchFocal,
        "radial": requests.BenchRadial,
        "checkerboard": requests.BenchCheckerboard,
        "focus": requests.BenchFocus,
    }
    kind = {"dots": "bench-centre", "focal-pairs": "bench-focal"}.get(arguments.method, f"bench-{arguments.method}")
    values: dict[str, object] = {"kind": kind, "profile": camera}
    if pictures:
        values["frame_ids"] = list(range(1, pictures + 1))
    if arguments.method in ("dots", "tilt", "dark-law"):
        values[requests.MEASURED[kind]] = read_rows(arguments.file)
    elif arguments.method == "focal-pairs":
        values["radius_px"] = arguments.radius
    elif arguments.method == "radial":
        values["order"] = arguments.order
    elif arguments.method == "checkerboard":
        values |= {"corners": _corners(arguments.corners), "square_mm": arguments.square_mm, "fit_k3": arguments.k3}
    elif arguments.method == "focus":
        if bool(arguments.widths) == bool(pictures):
            raise BadInput("a focus run needs images with --at, or --widths", expected="one of the two")
        values["widths"] = read_rows(arguments.widths) if arguments.widths else []
        values["positions"] = _numbers((arguments.at or "").split(","), "--at") if pictures else []
        values["wished_sigma_px"] = arguments.wished_sigma
    return request_from(models[arguments.method], values)


def _corners(text: str) -> list[int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.strip().isdigit() for p in parts):
        raise BadInput("unreadable number of corners", expected="inner corners across x down, such as 9x6", got=text)
    return [int(parts[0]), int(parts[1])]


def read_rows(name: str) -> list[list[float]]:
    """Return the rows of numbers of a CSV file. Raises BadInput, which names the invalid line."""
    try:
        text = read_limited(Path(name), TEXT_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput("the file cannot be read", got=f"{name}: {error}") from None
    rows = []
    for number, cells in enumerate(csv.reader(text.splitlines()), 1):
        if cells and _begins_with_number(cells[0]):
            rows.append(_numbers(cells, f"{name} line {number}"))
    return rows


def _begins_with_number(cell: str) -> bool:
    return cell.strip()[:1] in set("+-.0123456789") and bool(cell.strip())


def _numbers(cells: Sequence[str], where: str) -> list[float]:
    try:
        return [float(c) for c in cells]
    except ValueError:
        raise BadInput(f"{where} is not a row of numbers", got=",".join(cells)[:80]) from None
