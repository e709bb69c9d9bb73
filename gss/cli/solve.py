"""``gss solve``: attitudes of image files, as text or JSON."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

import numpy as np

from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR
from gss.cli.input_files import TEXT_BYTES, TLE_BYTES, read_file, read_limited
from gss.cli.instruments import CAMERA_HELP, registry
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput, GssError, NotFound
from gss.domain.results import Outcome, SolveResult, Turning
from gss.operations.frames.sequence import RateRecord, TruthRecord

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.parsing.parse_processes import ParseProcesses

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
    camera.add_argument("--fov-deg", type=float, metavar="X", help="horizontal field of view, known to about 5 %%")
    camera.add_argument("--blind", action="store_true", help="field of view unknown, between 4° and 60°")
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
        "--interval", type=float, metavar="S", help="seconds between the images of a sequence without time stamps"
    )
    parser.add_argument(
        "--truth",
        metavar="RA,DEC,ROLL|FILE",
        help="true attitude in degrees, or a JSON file {file name: [RA, DEC, ROLL]}; a wrong answer gives exit code 1",
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
    parser.add_argument("--plain", action="store_true", help="use numpy only, even if the extra [fast] is installed")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a constant of a system's chain, such as matcher=star_vectors or attitude_method=foam; see docs/chains.md",
    )
    parser.add_argument("--json", action="store_true", help="print JSON, one object per file and line")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Solve each file; the worst outcome determines the exit code."""
    from gss.operations.clock import stopwatch_s
    from gss.operations.frames.figure_files import users_folder
    from gss.operations.frames.image_sequence import Sequencer
    from gss.operations.frames.solve import Solver
    from gss.operations.frames.solver_cache import SolverCache
    from gss.operations.parsing.parse_processes import ParseProcesses

    if (arguments.hint or arguments.sequence) and arguments.camera is None:
        raise BadInput("a hint or a sequence needs a calibrated camera", expected="--camera PROFILE")
    solver = Solver(registry().camera, SolverCache(folder=users_folder()), stopwatch_s)
    sequencer = Sequencer(arguments.sequence, arguments.interval, prior(arguments.hint))
    truths = read_truths(arguments.truth, arguments.files)
    codes = []
    with ParseProcesses() as parsing:
        for name in arguments.files:
            try:
                codes.append(_one(name, arguments, parsing, solver, sequencer, truths.get(Path(name).name)))
            except GssError as error:
                print(f"gss: {error.sentences()}", file=sys.stderr)
                codes.append(BAD_INPUT_EXIT if isinstance(error, BadInput | NotFound) else FAILED_EXIT)
    return _worst(codes)


def _worst(codes: Sequence[int]) -> int:
    return next((c for c in (FAILED_EXIT, BAD_INPUT_EXIT, NO_SOLUTION_EXIT) if c in codes), SOLVED_EXIT)


def _one(
    name: str, arguments: argparse.Namespace, parsing: ParseProcesses, solver: Any, sequencer: Any, truth: Any
) -> int:
    from gss.operations.clock import utc_now
    from gss.operations.frames.frame_files import LONGEST_EXPOSURE_S, MAX_BYTES, ImportedFrame, read_frame
    from gss.operations.frames.image_sequence import truth_record
    from gss.operations.frames.observer import observer_at
    from gss.operations.frames.solve import SolveRequest
    from gss.pipeline.chains.options import parse

    frame = parsing.parse(
        read_frame, read_file(name, "an image file", MAX_BYTES), name, classes=(ImportedFrame,), subject=name
    )
    taken = frame.taken_at if arguments.utc is None else _moment(arguments.utc)
    exposed_at = frame.seen_at if arguments.utc is None else taken
    epoch = arguments.epoch if arguments.epoch is not None else julian_year(taken or utc_now())
    exposure_s = frame.exposure_s if arguments.exposure is None else arguments.exposure
    if exposure_s is not None and not 0 < exposure_s <= LONGEST_EXPOSURE_S:
        expected = f"more than 0, at most {LONGEST_EXPOSURE_S:g} s"
        raise BadInput("exposure is out of range", expected=expected, got=f"{exposure_s:g} s")
    request = SolveRequest(
        chain=arguments.chain,
        profile=arguments.camera,
        fov_rad=None if arguments.fov_deg is None else math.radians(arguments.fov_deg),
        blind=arguments.blind,
        epoch_jyear=round(epoch, 2),
        observer=None
        if exposed_at is None or arguments.keep_aberration
        else observer_at(exposed_at, _tle(arguments.tle)),
        exposure_s=exposure_s,
        fast=False if arguments.plain else None,
        options=tuple(parse(arguments.set).items()),
    )
    result, rate = sequencer.solve(solver, frame.pixels, request, taken)
    record = as_record(name, result)
    if arguments.sequence:
        record["rate"] = rate
    judged = None if truth is None else truth_record(result, truth, solver.cache.stars(request.epoch_jyear))
    if truth is not None:
        record["truth"] = judged
    print(json.dumps(record, allow_nan=False, ensure_ascii=False) if arguments.json else as_text(record))
    if judged is not None and judged["verdict"] == "wrong":
        return FAILED_EXIT
    return SOLVED_EXIT if result.outcome is Outcome.SOLVED else NO_SOLUTION_EXIT


def prior(text: str | None) -> Any:
    """Return the prior attitude of ``--hint``, None without one."""
    from gss.pipeline.identify.near import BoundedPrior

    if text is None:
        return None
    numbers = angles(text, (3, 4), "RA,DEC,ROLL[,RADIUS] in degrees")
    radius_deg = numbers[3] if len(numbers) == 4 else 5.0
    if not 0 < radius_deg <= 180:
        raise BadInput("radius of the hint is out of range", expected="above 0, at most 180°", got=f"{radius_deg:g}°")
    return BoundedPrior(attitude(numbers), math.radians(radius_deg))


def read_truths(text: str | None, files: Sequence[str]) -> dict[str, Array]:
    """Return true attitudes by file name."""
    if text is None:
        return {}
    if not Path(text).is_file():
        truth = attitude(angles(text, (3,), "RA,DEC,ROLL in degrees, or a JSON file"))
        return {Path(name).name: truth for name in files}
    try:
        rows = json.loads(read_limited(Path(text), TEXT_BYTES))
        return {str(name): attitude([float(v) for v in row]) for name, row in rows.items()}
    except (ValueError, TypeError, AttributeError, UnicodeDecodeError) as error:
        raise BadInput(
            "unreadable truth", expected="{file name: [RA, DEC, ROLL]} in degrees", got=str(error)
        ) from error


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


def _moment(text: str) -> datetime:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("unreadable time", expected="ISO 8601, such as 2026-11-21T18:05:00Z", got=text) from None
    low, high = EPOCH_RANGE_JYEAR
    # Outside this range neither the Earth's motion nor proper motions are known, and the calendar overflows.
    if not low <= moment.year < high:
        raise BadInput("time is out of range", expected=f"the years {low:g} to {high:g}", got=text[:40])
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)


def _tle(name: str | None) -> str | None:
    if name is None:
        return None
    return read_file(name, "a two-line element set", TLE_BYTES).decode("ascii", "replace")


def julian_year(moment: datetime) -> float:
    """Return the Julian epoch of a time. Leap seconds and TT − UTC are neglected: they are far too small to affect
    proper motion."""
    return 2000.0 + (moment.timestamp() - J2000_UNIX_S) / JULIAN_YEAR_S


class TurningRecord(TypedDict):
    """Rate from the trails of a frame about camera x, y, z."""

    deg_s: list[float]
    sigma_deg_s: list[float]
    speed_deg_s: float
    sign_known: bool
    stars: int


class SolveRecord(TypedDict):
    """Result of an image as a JSON object; missing values are null. ``rate``: since the previous image of a sequence;
    ``truth``: against the true attitude."""

    file: str
    chain: str
    outcome: str
    reason: str
    ra_deg: float | None
    dec_deg: float | None
    roll_deg: float | None
    quaternion: list[float] | None
    sigma_arcsec: float | None
    sigma_roll_arcsec: float | None
    matched: int
    centroids: int
    false_match_probability: float | None
    fov_deg: list[float] | None
    residual_rms_px: float | None
    turning: TurningRecord | None
    aberration_arcsec: float | None
    versions: dict[str, str]
    timing_ms: dict[str, float]
    notes: list[str]
    rate: NotRequired[RateRecord | None]
    truth: NotRequired[TruthRecord | None]


def as_record(name: str, result: SolveResult) -> SolveRecord:
    """Return one result as a JSON object; missing values are null."""
    record: SolveRecord = {
        "file": name,
        "chain": result.chain,
        "outcome": str(result.outcome),
        "reason": result.reason,
        "ra_deg": None,
        "dec_deg": None,
        "roll_deg": None,
        "quaternion": None,
        "sigma_arcsec": None,
        "sigma_roll_arcsec": None,
        "matched": 0 if result.matches is None else len(result.matches),
        "centroids": len(result.centroids),
        "false_match_probability": _finite(result.false_match_probability),
        "fov_deg": None,
        "residual_rms_px": _finite(result.residual_rms_px),
        "turning": None if result.turning is None else turning_record(result.turning),
        "aberration_arcsec": None if result.velocity_c is None else math.hypot(*result.velocity_c) / ARCSEC_RAD,
        "versions": dict(result.versions),
        "timing_ms": {stage: round(1e3 * s, 3) for stage, s in result.timing_s.items()},
        "notes": list(result.notes),
    }
    if result.attitude is not None:
        ra, dec, roll = result.attitude.ra_dec_roll_rad
        cross, about = result.attitude.sigma_rad
        record |= {
            "ra_deg": round(math.degrees(ra), 7),
            "dec_deg": round(math.degrees(dec), 7),
            "roll_deg": round(math.degrees(roll), 6),
            "quaternion": [float(q) for q in result.attitude.quaternion],
            "sigma_arcsec": _finite(cross / ARCSEC_RAD),
            "sigma_roll_arcsec": _finite(about / ARCSEC_RAD),
            "fov_deg": [round(math.degrees(f), 5) for f in result.camera.fov_rad],
        }
    return record


def turning_record(turning: Turning) -> TurningRecord:
    """Return the rate of a trailed frame in degrees per second about camera x, y, z."""
    return {
        "deg_s": [math.degrees(v) for v in turning.vector_rad_s],
        "sigma_deg_s": [math.degrees(v) for v in turning.sigma_rad_s],
        "speed_deg_s": math.degrees(turning.speed_rad_s),
        "sign_known": turning.sign_known,
        "stars": turning.stars,
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def as_text(record: SolveRecord) -> str:
    """Return the result as a few lines of text."""
    total_ms = sum(record["timing_ms"].values())
    if record["outcome"] != str(Outcome.SOLVED):
        return (
            f"{record['file']}: no solution. {record['reason']}\n  {record['centroids']} stars found, {total_ms:.0f} ms"
        )
    fov = " x ".join(f"{f:.3f}°" for f in record["fov_deg"] or ())
    sigma = (
        ""
        if record["sigma_arcsec"] is None
        else f" ± {record['sigma_arcsec']:.1f}″ per axis, roll ± {record['sigma_roll_arcsec']:.0f}″"
    )
    chance = "unknown" if record["false_match_probability"] is None else f"{record['false_match_probability']:.1e}"
    residual = "unknown" if record["residual_rms_px"] is None else f"{record['residual_rms_px']:.2f} px"
    lines = [
        f"{record['file']}: RA {record['ra_deg']:.5f}°  Dec {record['dec_deg']:+.5f}°  roll {record['roll_deg']:.4f}°{sigma}",
        f"  {record['matched']} of {record['centroids']} stars identified, residual {residual}, "
        f"field of view {fov}, false-match probability {chance}",
        f"  {record['chain']} chain, {total_ms:.0f} ms",
    ]
    rate = record.get("rate")
    if rate is not None:
        x, y, z = rate["deg_s"]
        lines.append(f"  turns at {rate['speed_deg_s']:.5f}°/s: {x:+.5f} {y:+.5f} {z:+.5f} about x, y, z")
    turning = record["turning"]
    if turning is not None:
        x, y, z = turning["deg_s"]
        a, b, c = turning["sigma_deg_s"]
        sign = "" if turning["sign_known"] else " (or the opposite: a trail has no direction)"
        lines.append(
            f"  {turning['stars']} trails: turned at {turning['speed_deg_s']:.4f}°/s during the exposure: {x:+.4f} ± {a:.4f}, "
            f"{y:+.4f} ± {b:.4f}, {z:+.4f} ± {c:.4f} about x, y, z{sign}"
        )
    truth = record.get("truth")
    if truth is not None:
        lines.append(f"  {truth['verdict']}: {truth['error_arcsec']:.1f}″ off, roll {truth['error_roll_arcsec']:+.0f}″")
    return "\n".join(lines + [f"  {note}" for note in record["notes"]])
