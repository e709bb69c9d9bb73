"""``gss catalogue``: build a sub-catalogue and its bank image from the real sky. Angles on the command line are in degrees."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from gss.catalogue_tools.build import BuiltCatalogue, build
from gss.catalogue_tools.envelope.attitude import FREE_LAWS, ORBIT_LAWS
from gss.catalogue_tools.onboard import FORMATS
from gss.catalogue_tools.request import METHODS
from gss.catalogue_tools.selection.selection import THINNINGS
from gss.cli import catalogue_files, catalogue_sky, catalogue_upload
from gss.cli.catalogue_files import print_facts, write_file
from gss.cli.input_files import TLE_BYTES, read_limited
from gss.cli.instruments import CAMERA_HELP
from gss.cli.instruments import camera as camera_named
from gss.domain.errors import BadInput
from gss.operations.catalogues.catalogue_request import CatalogueRequest, build_request
from gss.operations.clock import utc_now
from gss.operations.requests import request_from

if TYPE_CHECKING:
    from gss.cli import Commands, Subparsers

# Makes argparse accept values such as -10:10 as numbers instead of unknown options.
NEGATIVE_RANGE = re.compile(r"^-[\d.][\d.eE+:,-]*$")


def register(subparsers: Commands) -> None:
    """Add the group to the command line."""
    group = subparsers.add_parser("catalogue")
    commands = group.add_subparsers(dest="catalogue_command", required=True, metavar="COMMAND")
    _register_build(commands)
    catalogue_files.register(commands)
    catalogue_upload.register(commands)


def _register_build(commands: Subparsers) -> None:
    p = commands.add_parser(
        "build",
        help="select the stars for an orbit and attitude limits; write the distance table and bank image",
        description="Ranges are MIN:MAX in degrees, or one number. Without an orbit the catalogue is the whole sky.",
    )
    p._negative_number_matcher = NEGATIVE_RANGE
    p.add_argument("--profile", metavar="INSTRUMENT", help=f"{CAMERA_HELP} (default: GSS_INSTRUMENT)")
    p.add_argument("--format", help=f"{' | '.join(FORMATS)} (default: the instrument's own)")
    p.add_argument("--inclination-deg", type=_range, help="orbit by elements: inclination, ICRS")
    p.add_argument("--raan-deg", type=_range, help="orbit by elements: right ascension of the ascending node, ICRS")
    p.add_argument("--altitude-km", type=float, help="altitude, with elements; the node drifts during the days of use")
    p.add_argument("--tle", type=Path, metavar="FILE", help="orbit by a two-line element set")
    p.add_argument("--from", dest="start", metavar="DATE", help="first day of use, UTC (default: today)")
    p.add_argument("--days", type=float, help="days of use (default 14)")
    p.add_argument("--pointing", help=f"{' | '.join(ORBIT_LAWS + FREE_LAWS)} (default: zenith)")
    for name in ("roll", "pitch", "yaw"):
        p.add_argument(f"--{name}-deg", type=_range, help=f"limits of {name} (default: usual limits of the law)")
    for name in ("ra", "dec", "field-roll"):
        p.add_argument(f"--{name}-deg", type=float, help="inertial pointing")
    p.add_argument("--off-nadir-deg", type=float, help="off-nadir angle of a target law")
    p.add_argument(
        "--body-from-cam",
        type=_nine,
        metavar="R",
        help="mounting matrix: nine numbers by rows, separated by commas (default: that of the pointing law)",
    )
    p.add_argument(
        "--mounting-deg", type=_three, metavar="X,Y,Z", help="alternative: rotations from body to camera axes"
    )
    p.add_argument("--method", help=" | ".join(METHODS) + " (Jacobs' steps of 1°; default exact)")
    p.add_argument("--margin-deg", type=float, help="widen the field on every side (default 0.5)")
    p.add_argument("--mag-limit", type=float, help="faint limit in V (default: the camera's)")
    p.add_argument("--bright-limit", type=float, help="bright limit in V (default -2)")
    p.add_argument("--min-separation-deg", type=float, help="reject stars with closer neighbours")
    p.add_argument("--brightest-per-field", type=int, help="keep the N brightest of each field (default 0: all)")
    p.add_argument("--thinning", help=f"shape of the fields: {' | '.join(THINNINGS)} of the camera's shape")
    p.add_argument("--drop-variables", action="store_true", help="reject variable stars")
    p.add_argument("--pair-min-deg", type=float, help="smallest tabulated distance (default 0.25)")
    p.add_argument("--pair-max-deg", type=float, help="largest tabulated distance (default: the field's diagonal)")
    catalogue_sky.register(p)
    p.add_argument("--epoch", type=float, help="Julian year of the positions (default: middle of use)")
    p.add_argument("--bank-bytes", type=int, help="capacity of the bank")
    p.add_argument("--k-vector", action="store_true", help="include a k-vector, an index of the distances")
    p.add_argument(
        "--reduced-frame",
        type=_frame,
        metavar="WxH[,N[,STEP]]",
        help="the N (8) brightest of every frame of W by H degrees, STEP (1) degrees apart, as a reduced catalogue",
    )
    p.add_argument("--name", help="name in the manifest")
    p.add_argument("--author", default="", help="author in the manifest")
    p.add_argument("--out", type=Path, metavar="FILE", help="write the image here and the manifest to FILE.json")
    p.add_argument("--report", type=Path, metavar="FILE", help="write the quality report here, .html or .pdf")
    p.add_argument("--json", action="store_true", help="print one JSON object")
    p.set_defaults(run=run_build)


def run_build(arguments: argparse.Namespace, now: Callable[[], datetime] = utc_now) -> int:
    """Build, write and print."""
    begin, today = perf_counter(), now()
    spec = request_of(arguments, today)
    request = build_request(spec, camera_named(spec.profile or None), arguments.author, today)
    built = build(request, catalogue_sky.source_of(arguments, request))
    if arguments.out is not None:
        write_file(arguments.out, built.image)
        write_file(arguments.out.with_name(arguments.out.name + ".json"), built.manifest.as_json().encode())
    if arguments.report is not None:
        catalogue_files.write_report(arguments.report, built)
    facts = facts_of(built) | {"elapsed_s": round(perf_counter() - begin, 3)}
    print_facts(facts if arguments.json else facts | facts.pop("funnel"), arguments.json)
    if arguments.out is None and not arguments.json:
        print("nothing was saved. Use --out FILE to save image and manifest", file=sys.stderr)
    return 0


def request_of(a: argparse.Namespace, today: datetime) -> CatalogueRequest:
    """Return the request of parsed arguments. Raises BadInput."""
    options = {
        "profile": a.profile,
        "format": a.format,
        "altitude_km": a.altitude_km,
        "start": a.start or today.date().isoformat(),
        "days": a.days,
        "ra_deg": a.ra_deg,
        "dec_deg": a.dec_deg,
        "field_roll_deg": a.field_roll_deg,
        "off_nadir_deg": a.off_nadir_deg,
        "body_from_cam": a.body_from_cam,
        "mounting_deg": a.mounting_deg,
        "method": a.method,
        "margin_deg": a.margin_deg,
        "faint_mag": a.mag_limit,
        "bright_mag": a.bright_limit,
        "min_separation_deg": a.min_separation_deg,
        "brightest_per_field": a.brightest_per_field,
        "thinning": a.thinning,
        "drop_variables": a.drop_variables,
        "pair_min_deg": a.pair_min_deg,
        "pair_max_deg": a.pair_max_deg,
        "epoch_jyear": a.epoch,
        "bank_bytes": a.bank_bytes,
        "k_vector": a.k_vector,
        "reduced": a.reduced_frame,
        "name": a.name,
    }
    values = options | _orbit(a) | _attitude(a) | catalogue_sky.values_of(a)
    return request_from(CatalogueRequest, {name: value for name, value in values.items() if value is not None})


def facts_of(built: BuiltCatalogue) -> dict[str, Any]:
    """Return the values that a build prints."""
    m, q = built.manifest, built.quality
    return {
        "name": m.name,
        "profile": m.profile_name,
        "format": m.format_name,
        "stars": len(built.stars),
        "pairs": len(built.distances),
        "valid_from": m.valid_from or None,
        "valid_to": m.valid_to or None,
        "epoch_jyear": round(m.epoch_jyear, 4),
        "worst_field_stars": q.worst_stars,
        "worst_field_ra_deg": round(float(np.degrees(q.worst_ra_rad)), 3),
        "worst_field_dec_deg": round(float(np.degrees(q.worst_dec_rad)), 3),
        "mean_field_stars": round(q.mean, 3),
        "p_fewer_than_3": q.p_fewer_than(3),
        "p_fewer_than_5": q.p_fewer_than(5),
        "candidates_per_query": round(q.candidates_per_query, 2),
        "candidates_per_star": m.quality["candidates_per_star"],
        "fields_searched": q.searched,
        "blinded_share": round(q.blinded_share, 5),
        "lifetime_days": m.assessment.get("lifetime_days"),
        "corrections": [c["name"] for c in m.corrections.get("applied", [])],
        "source": m.source_facts.get("name"),
        "screened": m.assessment.get("screening", {}).get("counts"),
        "reduced_stars": m.counts.get("reduced catalogue"),
        "bytes": len(built.image),
        "bank_bytes": built.plan.bank_bytes,
        "sha256": built.sha256,
        "funnel": {step.label: -step.stars if step.dropped else step.stars for step in built.selection.funnel},
    }


def _range(text: str) -> list[float]:
    """Parse ``MIN:MAX`` or one number, degrees."""
    parts = text.split(":")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or len(values) != len(parts):
        raise argparse.ArgumentTypeError(f"expected MIN:MAX or one number in degrees, got {text!r}")
    return [values[0], values[-1]]


def _nine(text: str) -> list[float]:
    return _numbers(text, 9, "nine")


def _three(text: str) -> list[float]:
    return _numbers(text, 3, "three")


def _numbers(text: str, count: int, word: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise argparse.ArgumentTypeError(f"expected {word} numbers with commas, got {text!r}")
    return values


def _frame(text: str) -> dict[str, float]:
    sides, *steps = text.split(",")
    names = ("width_deg", "height_deg", "brightest", "step_deg")
    try:
        sizes = [float(side) for side in sides.split("x")]
        counts = [int(steps[0])] if steps else []
        values = [*sizes, *counts, *(float(step) for step in steps[1:])]
    except ValueError:
        sizes, values = [], []
    if len(sizes) != 2 or len(values) > len(names):
        raise argparse.ArgumentTypeError(f"expected WxH, WxH,N or WxH,N,STEP, got {text!r}")
    return dict(zip(names, values, strict=False))


def _orbit(a: argparse.Namespace) -> dict[str, object]:
    if a.tle is not None:
        if a.inclination_deg or a.raan_deg:
            raise BadInput("two orbits given", expected="either --tle or --inclination-deg with --raan-deg")
        try:
            return {"orbit": "tle", "tle": read_limited(a.tle, TLE_BYTES).decode("utf-8")}
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput("the TLE file cannot be read", got=f"{a.tle}: {error}") from None
    if a.inclination_deg is None and a.raan_deg is None:
        return {}
    if a.inclination_deg is None:
        raise BadInput("the ascending node needs an inclination", expected="--inclination-deg with --raan-deg")
    low, high = a.inclination_deg
    return {"orbit": "elements", "inclination_deg": low, "inclination_max_deg": high, "raan_deg": a.raan_deg}


def _attitude(a: argparse.Namespace) -> dict[str, object]:
    limits = {"roll_deg": a.roll_deg, "pitch_deg": a.pitch_deg, "yaw_deg": a.yaw_deg}
    if a.pointing is None and a.tle is None and a.inclination_deg is None and any(limits.values()):
        raise BadInput("attitude limits without an orbit", hint="--inclination-deg and --raan-deg, --tle or --pointing")
    return {"pointing": a.pointing, **limits}
