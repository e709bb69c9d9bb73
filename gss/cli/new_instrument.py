"""``gss instrument new --from-frames``: create an instrument package from photographs of the night sky."""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gss.cli.input_files import read_limited
from gss.cli.instruments import registry
from gss.domain.errors import BadInput, Conflict, NotFound

if TYPE_CHECKING:
    from gss.instruments.package_source import Files
    from gss.operations.frames.frame_files import ImportedFrame
    from gss.operations.studies.photograph_package import PhotographPackage
    from gss.operations.studies.photographs import PhotographRow

RANGE = re.compile(r"([0-9.]+)\.\.([0-9.]+)")


def add_arguments(new: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    new.add_argument("name", metavar="NAME")
    new.add_argument(
        "--from",
        dest="model",
        metavar="INSTRUMENT",
        help="instrument to copy; with --from-frames everything except its camera",
    )
    new.add_argument(
        "--from-frames",
        dest="photographs",
        nargs="+",
        type=Path,
        metavar="PATH",
        help="folder of photographs of the night sky, or the files (FITS, PNG, TIFF, JPEG); better 20 than 3",
    )
    new.add_argument("--into", type=Path, default=Path(), metavar="FOLDER", help="parent folder (default: here)")
    new.add_argument("--title", default="", help="title of the instrument")
    new.add_argument("--fov-deg", metavar="MIN..MAX", help="range of the horizontal field of view (default: 4..60)")
    new.add_argument("--pixel-um", type=float, metavar="UM", help="size of a pixel (default: as the files state)")
    new.add_argument("--focal-mm", type=float, metavar="MM", help="nominal focal length (default: as the files state)")
    new.add_argument("--f-number", type=float, metavar="N", help="aperture (default: as the files state)")
    new.add_argument("--exposure", type=float, metavar="S", help="exposure of files that do not state it")
    new.add_argument("--date", metavar="YYYY-MM-DD", help="date of files that do not state it (default: now)")
    new.add_argument(
        "--no-atmosphere",
        action="store_true",
        help="photographs from space or simulated: no uncertainty for refraction",
    )
    new.add_argument("--json", action="store_true", help="print the result of --from-frames as one JSON object")


def run_photographs(arguments: argparse.Namespace) -> int:
    """Solve the photographs, calibrate the camera, and write the package."""
    from gss.cli.night import show_progress
    from gss.operations.clock import stopwatch_s, utc_now
    from gss.operations.frames.figure_files import users_folder
    from gss.operations.frames.solve import Solver
    from gss.operations.frames.solver_cache import SolverCache
    from gss.operations.requests import request_from
    from gss.operations.studies.new_instrument import check_new_name, model_of, record_of
    from gss.operations.studies.new_instrument_requests import PhotographOptions
    from gss.operations.studies.photograph_package import make_package

    low, high = _fov(arguments.fov_deg)
    options = request_from(
        PhotographOptions,
        {
            "name": arguments.name,
            "title": arguments.title,
            "model": arguments.model or "",
            "fov_min_deg": low,
            "fov_max_deg": high,
            "pixel_um": arguments.pixel_um,
            "focal_mm": arguments.focal_mm,
            "f_number": arguments.f_number,
            "exposure_s": arguments.exposure,
            "date": arguments.date,
            "atmosphere": not arguments.no_atmosphere,
        },
    )
    instruments, folder = registry(arguments.data), arguments.into / arguments.name
    check_new_name(instruments, options.name)
    _check_free(folder)
    model = model_of(instruments, options)
    photographs, unreadable = _photographs(_files(arguments.photographs))
    solver = Solver(instruments.camera, SolverCache(folder=users_folder()))
    package = make_package(solver, photographs, unreadable, options, model, utc_now(), stopwatch_s, show_progress)
    show_progress(1.0, "")
    write_new(folder, package.files)
    print(
        json.dumps(record_of(package), ensure_ascii=False, allow_nan=False)
        if arguments.json
        else as_text(package, folder)
    )
    return 0


def _fov(text: str | None) -> tuple[float | None, float | None]:
    if text is None:
        return None, None
    match = RANGE.fullmatch(text.strip())
    try:
        return (float(match[1]), float(match[2])) if match else (float(text) / 1.1, float(text) * 1.1)
    except ValueError:
        raise BadInput("unreadable field of view", expected="MIN..MAX in degrees, such as 8..15", got=text) from None


def _check_free(folder: Path) -> None:
    if folder.exists():
        raise Conflict("the folder exists already", got=str(folder), hint="choose another name or --into")


def write_new(folder: Path, files: Files) -> Path:
    """Write a package to a new folder and return the folder. On an error nothing is written. Raises Conflict if the
    folder exists, BadInput if it cannot be written."""
    from gss.instruments.package_source import write_folder

    _check_free(folder)
    temporary: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".new-", dir=folder.parent))
        write_folder(temporary / "package", files)
        (temporary / "package").rename(folder)
    except OSError as error:
        raise BadInput("the package cannot be written", got=f"{folder}: {error.strerror}") from None
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
    return folder


def _files(paths: list[Path]) -> list[Path]:
    """Return the given files and the files in the given folders, without hidden files and duplicates. Raises NotFound,
    BadInput."""
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            files += sorted(p for p in path.iterdir() if p.is_file() and not p.name.startswith("."))
        elif path.is_file():
            files.append(path)
        else:
            raise NotFound("no such file or folder", expected="photographs of the night sky", got=str(path))
    unique = list(dict.fromkeys(files))
    if not unique:
        raise BadInput("the folder has no files", expected="photographs of the night sky", got=str(paths[0]))
    return unique


def _photographs(files: list[Path]) -> tuple[list[Any], list[PhotographRow]]:
    """Return the readable photographs, and a row with the reason for each unreadable file."""
    from gss.cli.night import UNTIMED_EPOCH
    from gss.operations.frames.observer import observer_at
    from gss.operations.studies.night_frames import Shot
    from gss.operations.studies.photographs import Photograph, PhotographRow

    photographs, unreadable = [], []
    for name, frame in _read(files):
        if isinstance(frame, BadInput):
            unreadable.append(
                PhotographRow(name, False, f"{frame.message}; got {frame.got}" if frame.got else frame.message)
            )
            continue
        observer = None if frame.seen_at is None else observer_at(frame.seen_at)
        taken = frame.taken_at or UNTIMED_EPOCH
        shot = Shot(name, taken, frame.exposure_s, frame.bits, frame.pixels.view, observer=observer)
        photographs.append(Photograph(shot, frame.source))
    return photographs, unreadable


def _read(files: list[Path]) -> Iterator[tuple[str, ImportedFrame | BadInput]]:
    from gss.operations.frames.frame_files import MAX_BYTES, ImportedFrame, read_frame
    from gss.operations.parsing.parse_processes import ParseProcesses

    counts = {path.name: sum(p.name == path.name for p in files) for path in files}
    with ParseProcesses() as parsing:
        for path in files:
            name = path.name if counts[path.name] == 1 else str(path)
            try:
                data = read_limited(path, MAX_BYTES)
                yield name, parsing.parse(read_frame, data, name, classes=(ImportedFrame,), subject=name)
            except OSError as error:
                yield name, BadInput("the file cannot be read", got=str(error.strerror))
            except BadInput as error:
                yield name, error


def as_text(package: PhotographPackage, folder: Path) -> str:
    """Return the result as text: photographs, measured numbers, warnings and the next step."""
    width = max(len(row.name) for row in package.rows)
    lines = []
    for row in package.rows:
        if row.used:
            lines.append(f"{row.name:<{width}}  used: {row.matched} stars, {row.rms_px or math.nan:.2f} px")
        else:
            lines.append(f"{row.name:<{width}}  not used: {row.reason}")
    lines.append("")
    for number in package.instrument.camera.numbers():
        if number.sigma is not None:
            mark = " (chosen)" if number.chosen else ""
            lines.append(f"{number.name:<16} {number.values[0]:.10g} ± {number.sigma:.2g} {number.unit}{mark}")
    lines += ["", *(f"note: {text}" for text in package.warnings), *([""] if package.warnings else []), package.summary]
    lines.append(f"{folder}: see camera.yaml for every number; install it with: gss instrument add {folder}")
    return "\n".join(lines)
