"""``gss catalogue``: build a sub-catalogue and its bank image from a star catalogue. Angles on the command line are in
degrees."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from gss.catalogue_tools.build import BuiltCatalogue, build
from gss.catalogue_tools.envelope.attitude import FREE_LAWS, ORBIT_LAWS
from gss.catalogue_tools.onboard import FORMATS
from gss.catalogue_tools.request import METHODS
from gss.catalogue_tools.selection.selection import THINNINGS
from gss.cli import catalogue_files, catalogue_sky, catalogue_upload
from gss.cli.catalogue_files import print_facts
from gss.cli.input_files import TLE_BYTES, read_limited
from gss.cli.instruments import CAMERA_HELP, registry
from gss.cli.instruments import camera as camera_named
from gss.cli.whole_files import write_whole
from gss.domain.errors import BadInput
from gss.operations.catalogues.catalogue_request import CatalogueRequest, build_request
from gss.operations.clock import utc_now
from gss.operations.requests import request_from

if TYPE_CHECKING:
    from gss.cli import Commands, Subparsers


def register(subparsers: Commands) -> None:
    """Add the group to the command line."""
    group = subparsers.add_parser("catalogue")
    commands = group.add_subparsers(dest="catalogue_command", required=True, metavar="COMMAND")
    _register_build(commands)
    catalogue_files.register(commands)
    catalogue_upload.register(commands)


def _register_build(commands: Subparsers) -> None:
    parser = commands.add_parser(
        "build",
        help="select the stars for an orbit and attitude limits; write the distance table and bank image",
        description="Ranges are MIN:MAX in degrees, or one number. Without an orbit the catalogue covers the whole sky.",
    )
    parser.add_argument("--profile", metavar="INSTRUMENT", help=f"{CAMERA_HELP} (default: GSS_INSTRUMENT)")
    parser.add_argument("--format", help=f"{' | '.join(FORMATS)} (default: format of the instrument)")
    parser.add_argument("--inclination-deg", type=_range, help="orbit by elements: inclination, ICRS")
    parser.add_argument(
        "--raan-deg", type=_range, help="orbit by elements: right ascension of the ascending node, ICRS"
    )
    parser.add_argument(
        "--altitude-km", type=float, help="altitude, with elements; the node drifts during the days of use"
    )
    parser.add_argument(
        "--eccentricity",
        type=float,
        help="eccentric orbit, with elements; the altitude is then the semi-major axis minus 6378 km (default 0)",
    )
    parser.add_argument("--perigee-deg", type=float, help="argument of perigee on the first day (default 0)")
    parser.add_argument("--tle", type=Path, metavar="FILE", help="orbit by a two-line element set")
    parser.add_argument("--from", dest="start", metavar="DATE", help="first day of use, UTC (default: today)")
    parser.add_argument("--days", type=float, help="days of use (default 14)")
    parser.add_argument("--pointing", help=f"{' | '.join(ORBIT_LAWS + FREE_LAWS)} (default: zenith)")
    for name in ("roll", "pitch", "yaw"):
        parser.add_argument(
            f"--{name}-deg", type=_range, help=f"limits of {name} (default: limits of the pointing law)"
        )
    for name in ("ra", "dec", "field-roll"):
        parser.add_argument(f"--{name}-deg", type=float, help="inertial pointing")
    parser.add_argument("--off-nadir-deg", type=float, help="off-nadir angle of a target law")
    parser.add_argument(
        "--body-from-cam",
        type=_nine_numbers,
        metavar="R",
        help="mounting matrix: nine numbers by rows, separated by commas (default: matrix of the pointing law)",
    )
    parser.add_argument(
        "--mounting-deg", type=_three_numbers, metavar="X,Y,Z", help="alternative: rotations from body to camera axes"
    )
    parser.add_argument(
        "--method", help=" | ".join(METHODS) + " (Jacobs' steps of 1°, whole_blocks his counts of stars; default exact)"
    )
    parser.add_argument("--margin-deg", type=float, help="widen the field on every side (default 0.5)")
    parser.add_argument("--mag-limit", type=float, help="faint limit in V (default: limit of the camera)")
    parser.add_argument("--bright-limit", type=float, help="bright limit in V (default -2)")
    parser.add_argument("--min-separation-deg", type=float, help="reject stars with closer neighbours")
    parser.add_argument(
        "--brightest-per-field", type=int, help="keep the N brightest stars of each field (default 0: all)"
    )
    parser.add_argument("--thinning", help=f"shape of the fields: {' | '.join(THINNINGS)} of the camera's shape")
    parser.add_argument("--drop-variables", action="store_true", help="reject variable stars")
    parser.add_argument("--pair-min-deg", type=float, help="smallest tabulated distance (default 0.25)")
    parser.add_argument("--pair-max-deg", type=float, help="largest tabulated distance (default: the field's diagonal)")
    catalogue_sky.register(parser)
    parser.add_argument("--epoch", type=float, help="Julian year of the positions (default: middle of use)")
    parser.add_argument("--bank-bytes", type=int, help="capacity of the bank")
    parser.add_argument("--k-vector", action="store_true", help="include a k-vector, an index of the distances")
    parser.add_argument(
        "--reduced-frame",
        type=_frame,
        metavar="WxH[,N[,STEP]]",
        help="add a reduced catalogue: the N (8) brightest stars of frames of W by H degrees, STEP (1) degrees apart",
    )
    parser.add_argument("--name", help="name in the manifest")
    parser.add_argument("--author", default="", help="author in the manifest")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write the image to FILE and the manifest to FILE.json"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the quality report to FILE, .html or .pdf")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run_build)


def run_build(arguments: argparse.Namespace, now: Callable[[], datetime] = utc_now) -> int:
    """Build a catalogue, write its files and print its properties."""
    begin, today = perf_counter(), now()
    spec = request_of(arguments, today)
    request = build_request(spec, camera_named(spec.profile or None), arguments.author, today)
    if request.bank_bytes is None:
        request = replace(request, bank_bytes=registry().bank_bytes(request.profile_name))
    built = build(request, catalogue_sky.source_of(arguments, request))
    if arguments.out is not None:
        write_whole(arguments.out, built.image)
        write_whole(arguments.out.with_name(arguments.out.name + ".json"), built.manifest.as_json().encode())
    if arguments.report is not None:
        catalogue_files.write_report(arguments.report, built)
    funnel = {step.label: -step.stars if step.dropped else step.stars for step in built.selection.funnel}
    facts = {**facts_of(built), "elapsed_s": round(perf_counter() - begin, 3)}
    print_facts({**facts, **({"funnel": funnel} if arguments.json else funnel)}, arguments.json)
    if arguments.out is None and not arguments.json:
        print("Nothing was saved. Use --out FILE to save image and manifest.", file=sys.stderr)
    return 0


def request_of(arguments: argparse.Namespace, today: datetime) -> CatalogueRequest:
    """Return the request of parsed arguments. Raises BadInput."""
    options = {
        "profile": arguments.profile,
        "format": arguments.format,
        "altitude_km": arguments.altitude_km,
        "eccentricity": arguments.eccentricity,
        "perigee_deg": arguments.perigee_deg,
        "start": arguments.start or today.date().isoformat(),
        "days": arguments.days,
        "ra_deg": arguments.ra_deg,
        "dec_deg": arguments.dec_deg,
        "field_roll_deg": arguments.field_roll_deg,
        "off_nadir_deg": arguments.off_nadir_deg,
        "body_from_cam": arguments.body_from_cam,
        "mounting_deg": arguments.mounting_deg,
        "method": arguments.method,
        "margin_deg": arguments.margin_deg,
        "faint_mag": arguments.mag_limit,
        "bright_mag": arguments.bright_limit,
        "min_separation_deg": arguments.min_separation_deg,
        "brightest_per_field": arguments.brightest_per_field,
        "thinning": arguments.thinning,
        "drop_variables": arguments.drop_variables,
        "pair_min_deg": arguments.pair_min_deg,
        "pair_max_deg": arguments.pair_max_deg,
        "epoch_jyear": arguments.epoch,
        "bank_bytes": arguments.bank_bytes,
        "k_vector": arguments.k_vector,
        "reduced": arguments.reduced_frame,
        "name": arguments.name,
    }
    values = options | _orbit(arguments) | _attitude(arguments) | catalogue_sky.values_of(arguments)
    return request_from(CatalogueRequest, {name: value for name, value in values.items() if value is not None})


def facts_of(built: BuiltCatalogue) -> Mapping[str, object]:
    """Return the printed values of a build."""
    manifest, quality = built.manifest, built.quality
    return {
        "name": manifest.name,
        "profile": manifest.profile_name,
        "format": manifest.format_name,
        "stars": len(built.stars),
        "pairs": len(built.distances),
        "valid_from": manifest.valid_from or None,
        "valid_to": manifest.valid_to or None,
        "epoch_jyear": round(manifest.epoch_jyear, 4),
        "worst_field_stars": quality.worst_stars,
        "worst_field_ra_deg": round(float(np.degrees(quality.worst_ra_rad)), 3),
        "worst_field_dec_deg": round(float(np.degrees(quality.worst_dec_rad)), 3),
        "mean_field_stars": round(quality.mean, 3),
        "p_fewer_than_3": quality.p_fewer_than(3),
        "p_fewer_than_5": quality.p_fewer_than(5),
        "candidates_per_query": round(quality.candidates_per_query, 2),
        "candidates_per_star": manifest.quality["candidates_per_star"],
        "fields_searched": quality.searched,
        "blinded_share": round(quality.blinded_share, 5),
        "lifetime_days": manifest.assessment.get("lifetime_days"),
        "corrections": [c["name"] for c in manifest.corrections.get("applied", [])],
        "source": manifest.source_facts.get("name"),
        "screened": manifest.assessment.get("screening", {}).get("counts"),
        "reduced_stars": manifest.counts.get("reduced catalogue"),
        "bytes": len(built.image),
        "bank_bytes": built.plan.bank_bytes,
        "sha256": built.sha256,
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


def _nine_numbers(text: str) -> list[float]:
    return _numbers(text, 9, "nine")


def _three_numbers(text: str) -> list[float]:
    return _numbers(text, 3, "three")


def _numbers(text: str, count: int, count_text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count:
        raise argparse.ArgumentTypeError(f"expected {count_text} numbers separated by commas, got {text!r}")
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


def _orbit(arguments: argparse.Namespace) -> dict[str, object]:
    if arguments.tle is not None:
        if arguments.inclination_deg or arguments.raan_deg or arguments.eccentricity:
            raise BadInput("two orbits given", expected="either --tle or --inclination-deg with --raan-deg")
        try:
            return {"orbit": "tle", "tle": read_limited(arguments.tle, TLE_BYTES).decode("utf-8")}
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput("the TLE file cannot be read", got=f"{arguments.tle}: {error}") from None
    if arguments.inclination_deg is None and arguments.raan_deg is None:
        return {}
    if arguments.inclination_deg is None:
        raise BadInput("the ascending node needs an inclination", expected="--inclination-deg with --raan-deg")
    low, high = arguments.inclination_deg
    return {"orbit": "elements", "inclination_deg": low, "inclination_max_deg": high, "raan_deg": arguments.raan_deg}


def _attitude(arguments: argparse.Namespace) -> dict[str, object]:
    limits = {"roll_deg": arguments.roll_deg, "pitch_deg": arguments.pitch_deg, "yaw_deg": arguments.yaw_deg}
    if (
        arguments.pointing is None
        and arguments.tle is None
        and arguments.inclination_deg is None
        and any(limits.values())
    ):
        raise BadInput(
            "attitude limits without an orbit", hint="add --inclination-deg and --raan-deg, --tle or --pointing"
        )
    return {"pointing": arguments.pointing, **limits}
