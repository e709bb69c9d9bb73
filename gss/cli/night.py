"""``gss calibrate`` and ``gss analyse``: calibrate a camera or analyse a night from image files."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gss.cli.input_files import read_limited
from gss.cli.instruments import CAMERA_HELP, camera, registry
from gss.cli.whole_files import write_whole
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.operations.clock import utc_now

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.frames.frame_files import ImportedFrame
    from gss.operations.report.parts import Report
    from gss.operations.studies.calibrate import CalibrationInput
    from gss.operations.studies.night_frames import Shot

UNTIMED_EPOCH = datetime(2026, 7, 1, tzinfo=UTC)
"""Epoch for images without a time. An arbitrary epoch is sufficient, because only the intervals between images have an
effect and proper motion is small."""

REPORT_KINDS = (".pdf", ".html", ".json")


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser(
        "calibrate",
        description="From frames of stars, or with --darks from dark frames (FITS, PNG, TIFF, JPEG). Exit code 0: done, "
        "2: bad input.",
    )
    parser.add_argument("files", nargs="+", metavar="FRAME", help="image of stars, or dark frame with --darks")
    parser.add_argument("--camera", metavar="INSTRUMENT", help=f"{CAMERA_HELP}; without it frames are solved blind")
    parser.add_argument("--fov-deg", type=float, metavar="X", help="width of the field of a camera without a profile")
    parser.add_argument(
        "--model",
        action="append",
        default=[],
        metavar="NAME",
        help="lens model, repeatable; several models are compared (default: all)",
    )
    parser.add_argument("--darks", action="store_true", help="the files are dark frames of one exposure")
    parser.add_argument(
        "--flats",
        nargs="+",
        default=[],
        metavar="FRAME",
        help="flat fields in pairs of the same illumination (with --darks)",
    )
    add_observer(parser)
    add_report_file(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run_calibrate)
    parser = subparsers.add_parser(
        "analyse",
        description="earth-fixed, celestial-fixed, slew, sensitivity, nea, spatial or two-cameras. Exit code 0: done, "
        "2: bad input.",
    )
    parser.add_argument("kind", help="kind of analysis")
    parser.add_argument("files", nargs="+", metavar="FRAME", help="frames of one camera")
    parser.add_argument("--camera", metavar="INSTRUMENT", required=True, help=CAMERA_HELP)
    parser.add_argument("--chain", default="reference", metavar="NAME", help="chain to run (default: reference)")
    parser.add_argument("--rate", type=float, metavar="DEG_S", help="commanded rate of a slew, degrees per second")
    parser.add_argument("--interval", type=float, metavar="S", help="seconds between images without a time stamp")
    parser.add_argument("--exposure", type=float, metavar="S", help="exposure of images without this information")
    parser.add_argument("--second", nargs="+", default=[], metavar="FRAME", help="frames of the second camera")
    parser.add_argument("--second-camera", metavar="PROFILE", help="profile of the second camera (default: the same)")
    add_observer(parser)
    add_report_file(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run_analyse)


def add_observer(parser: argparse.ArgumentParser) -> None:
    """Add the option for the observer's motion."""
    help_text = "do not correct aberration even if the time is known (for frames rendered without aberration)"
    parser.add_argument("--keep-aberration", action="store_true", help=help_text)


def add_report_file(p: argparse.ArgumentParser, *more: str, text: str = "") -> None:
    """Add the option ``--out``. ``more``: additional suffixes, described by ``text``. An unknown suffix is rejected
    before the work starts."""
    kinds = (*REPORT_KINDS, *more)

    def report_file(name: str) -> Path:
        path = Path(name)
        if path.suffix not in kinds:
            raise argparse.ArgumentTypeError(f"unknown report format: {name}; expected {' | '.join(kinds)}")
        return path

    p.add_argument("--out", type=report_file, metavar="FILE", help=f"write the report: .pdf, .html or .json{text}")


def run_calibrate(arguments: argparse.Namespace) -> int:
    """Calibrate, then write and print the result."""
    from gss.operations.frames.solve import Solver
    from gss.operations.studies.calibrate import check_models, from_darks, from_stars

    profile = camera(arguments.camera) if arguments.camera else None
    check_models(arguments.model)
    shots = shots_of(arguments.files, None, None, keep_aberration=arguments.keep_aberration)
    if arguments.darks or arguments.flats:
        if profile is None:
            raise BadInput("no camera given for the dark frames", expected="--camera PROFILE")
        if len(arguments.flats) % 2:
            raise BadInput("flat fields come in pairs", expected="an even number", got=str(len(arguments.flats)))
        flats = shots_of(arguments.flats, None, None)
        result = from_darks(shots, [flats[k : k + 2] for k in range(0, len(flats), 2)], profile, show_progress)
    else:
        fov = None if arguments.fov_deg is None else math.radians(arguments.fov_deg)
        result = from_stars(
            Solver(registry().camera), shots, profile, show_progress, models=arguments.model, fov_rad=fov
        )
    output_calibration(arguments, result, profile, Path(arguments.files[0]).name)
    return 0


def output_calibration(
    arguments: argparse.Namespace, calibration: CalibrationInput, profile: CameraProfile | None, name: str
) -> None:
    """Write and print the result of a calibration."""
    from gss.operations.studies.calibration_sheet import calibration_sheet
    from gss.store.models import Calibration

    row = Calibration(
        id=0,
        profile=profile.name if profile else "foreign",
        kind=calibration.kind,
        name=name,
        created=utc_now(),
        author="",
        tool="",
        request={},
        values=calibration.values,
        result=calibration.result,
        note="",
    )
    output_report(
        arguments,
        calibration_sheet(row),
        {"kind": calibration.kind, "values": calibration.values, "result": calibration.result},
    )


def run_analyse(arguments: argparse.Namespace) -> int:
    """Analyse the frames, then write and print the report."""
    from gss.operations.frames.solve import Solver
    from gss.operations.studies.analyse import FRAME_KINDS, TIMED_KINDS, analyse, check_kind, run_frames

    profile = camera(arguments.camera)
    commanded = None if arguments.rate is None else math.radians(arguments.rate)
    if arguments.kind not in FRAME_KINDS:
        raise BadInput("unknown analysis of frames", expected=" | ".join(FRAME_KINDS), got=arguments.kind)
    check_kind(arguments.kind, commanded, len(arguments.second))
    solver, timed = Solver(registry().camera), arguments.kind in TIMED_KINDS

    def run(files: Sequence[str], camera: CameraProfile) -> Any:
        return run_frames(
            solver,
            shots_of(files, arguments.interval, arguments.exposure, arguments.keep_aberration, timed=timed),
            camera,
            arguments.chain,
            show_progress,
        )

    second = (
        run(arguments.second, camera(arguments.second_camera) if arguments.second_camera else profile)
        if arguments.second
        else None
    )
    outcome = analyse(arguments.kind, solver, run(arguments.files, profile), second=second, commanded_rad_s=commanded)
    output_report(arguments, outcome.report, {"kind": outcome.kind, "figures": outcome.figures})
    return 0


def shots_of(
    files: Sequence[str],
    interval_s: float | None,
    exposure_s: float | None,
    keep_aberration: bool = False,
    *,
    timed: bool = False,
) -> list[Shot]:
    """Return image files as shots. ``interval_s``: interval of the files instead of their times. Raises BadInput, which
    names the file that cannot be read or, with ``timed`` and without an interval, states no time."""
    from gss.operations.frames.observer import observer_at
    from gss.operations.studies.night_frames import Shot

    shots = []
    for k, (name, frame) in enumerate(zip(files, _frames(files), strict=True)):
        taken = frame.taken_at
        observer = None if frame.seen_at is None or keep_aberration else observer_at(frame.seen_at)
        if taken is None and interval_s is None and timed:
            raise BadInput(
                "frames with an unknown time of exposure cannot be used",
                expected="files that state their time (DATE-OBS or EXIF)",
                got=Path(name).name,
            )
        if taken is None or interval_s is not None:
            taken = UNTIMED_EPOCH + timedelta(seconds=(interval_s or 0.0) * k)
        exposure = frame.exposure_s if frame.exposure_s is not None else exposure_s
        pixels = partial(_identity, frame.pixels)
        shots.append(Shot(Path(name).name, taken, exposure, frame.bits, pixels, observer=observer))
    return shots


def _frames(files: Sequence[str]) -> Iterator[ImportedFrame]:
    """Yield the frames of the files, one at a time."""
    from gss.operations.frames.frame_files import MAX_BYTES, ImportedFrame, read_frame
    from gss.operations.parsing.parse_processes import ParseProcesses

    with ParseProcesses() as parsing:
        for name in files:
            try:
                data = read_limited(Path(name), MAX_BYTES)
            except OSError as error:
                raise BadInput("the file cannot be read", got=f"{name}: {error.strerror}") from None
            yield parsing.parse(read_frame, data, name, classes=(ImportedFrame,), subject=name)


def _identity(pixels: Any) -> Any:
    return pixels


def show_progress(share: float, text: str) -> None:
    """Show progress on a terminal."""
    if sys.stderr.isatty():
        print(f"\r{100 * share:3.0f} % {text:<60}", end="" if share < 1 else "\n", file=sys.stderr, flush=True)


def output_report(arguments: argparse.Namespace, report: Report, content: dict[str, object]) -> None:
    """Write a report and its content to the file of ``--out``, and print it."""
    content_json = json.dumps({**content, "report": report.as_dict()}, ensure_ascii=False, allow_nan=False)
    write_report(arguments, report, content_json)


def write_report(
    arguments: argparse.Namespace,
    report: Report,
    content_json: str,
    extra_files: Mapping[str, Callable[[], bytes]] | None = None,
) -> None:
    """Write a report to the file of ``--out`` and print it.

    ``content_json``: content of the report as JSON; ``extra_files``: functions for additional file formats, by suffix.
    """
    from gss.operations.report.html import as_html
    from gss.operations.report.pdf import as_pdf

    if sys.stderr.isatty():
        print(file=sys.stderr)
    if arguments.out is not None:
        writers: dict[str, Callable[[], bytes]] = {
            ".json": content_json.encode,
            ".html": lambda: as_html(report).encode(),
            ".pdf": lambda: as_pdf(report, utc_now()),
            **(extra_files or {}),
        }
        write_whole(arguments.out, writers[arguments.out.suffix]())
    print(content_json if arguments.json else as_text(report))


def as_text(report: Report) -> str:
    """Return the report as text: figures and tables, without drawings."""
    lines = [report.title, report.subtitle, ""]
    lines += [f"{'SEVERE' if n.severe else 'note'}: {n.text}. {n.hint}" for n in report.notes]
    for section in report.sections:
        lines += ["", section.title]
        width = max((len(f.label) for f in section.facts), default=0)
        lines += [f"  {f.label:<{width}}  {f.value} {f.unit} {f.note}".rstrip() for f in section.facts]
        for table in section.tables:
            widths = [max(len(r[k]) for r in [table.columns, *table.rows]) for k in range(len(table.columns))]
            rows = [table.columns, *table.rows]
            lines += ["  " + "  ".join(f"{c:<{w}}" for c, w in zip(r, widths, strict=True)).rstrip() for r in rows]
    return "\n".join(lines)
