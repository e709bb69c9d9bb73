"""``gss catalogue``: build a sub-catalogue and its bank image from the real sky. Angles on the command line are in degrees."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from gss.catalogue_tools.build import BuiltCatalogue, build
from gss.catalogue_tools.envelope.attitude import FREE_LAWS, ORBIT_LAWS, AttitudeLimits
from gss.catalogue_tools.envelope.orbits import Range
from gss.catalogue_tools.onboard import FORMATS, own_format
from gss.catalogue_tools.request import METHODS, BuildRequest, ElementsOrbit, TleOrbit
from gss.catalogue_tools.selection.selection import THINNINGS, Rules
from gss.catalogue_tools.tables.terms import altitude_m, mounting_of
from gss.cli import catalogue_files, catalogue_sky, catalogue_upload
from gss.cli.catalogue_files import print_facts, write_file
from gss.cli.input_files import TLE_BYTES, read_limited
from gss.domain.bank_tables import ReducedFrame
from gss.domain.errors import BadInput
from gss.domain.profiles import PROFILES, profile

if TYPE_CHECKING:
    from gss.cli import Commands, Subparsers

# Makes argparse accept values such as -10:10 as numbers instead of unknown options.
NEGATIVE_RANGE = re.compile(r"^-[\d.][\d.eE+:,-]*$")
# Default limits of roll, pitch and yaw in degrees: Jacobs 1995 Table 5-2 for Sunsat.
USUAL_DEG: dict[str, tuple[Range, Range, Range]] = {"sunsat": ((-10.0, 10.0), (-5.0, 5.0), (130.0, 140.0))}
OTHER_USUAL_DEG: tuple[Range, Range, Range] = ((-5.0, 5.0), (-5.0, 5.0), (-5.0, 5.0))


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
        help="stars that an orbit and attitude limits will show, their distance table and bank image",
        description="Ranges are MIN:MAX in degrees, or one number. Without an orbit the catalogue is the whole sky.",
    )
    p._negative_number_matcher = NEGATIVE_RANGE
    p.add_argument("--profile", default="cubestar", help=" | ".join(PROFILES))
    p.add_argument("--format", help=f"{' | '.join(FORMATS)} (default: the profile's own, else cubestar)")
    p.add_argument("--inclination-deg", type=_range, help="orbit by elements: inclination, ICRS")
    p.add_argument("--raan-deg", type=_range, help="orbit by elements: right ascension of the ascending node, ICRS")
    p.add_argument("--altitude-km", type=float, help="with elements: the node drifts through the days of use")
    p.add_argument("--tle", type=Path, metavar="FILE", help="orbit by a two-line element set")
    p.add_argument("--from", dest="start", metavar="DATE", help="first day of use, UTC (default: today)")
    p.add_argument("--days", type=float, default=14.0, help="days of use (default 14)")
    p.add_argument("--pointing", help=f"{' | '.join(ORBIT_LAWS + FREE_LAWS)} (default: sunsat or zenith)")
    for name in ("roll", "pitch", "yaw"):
        p.add_argument(f"--{name}-deg", type=_range, help=f"limits of {name}")
    for name in ("ra", "dec", "field-roll"):
        p.add_argument(f"--{name}-deg", type=float, default=0.0, help="inertial pointing")
    p.add_argument("--off-nadir-deg", type=float, default=0.0, help="how far a target law looks aside")
    p.add_argument(
        "--body-from-cam", type=_nine, metavar="R", help="mounting: nine numbers by rows with commas, for the law's own"
    )
    p.add_argument(
        "--mounting-deg", type=_three, metavar="X,Y,Z", help="or: turns from the body's axes to the camera's"
    )
    p.add_argument("--method", default="exact", help=" | ".join(METHODS) + " (Jacobs' steps of 1°)")
    p.add_argument("--margin-deg", type=float, default=0.0, help="widen the field on every side")
    p.add_argument("--mag-limit", type=float, help="faint limit in V (default: the profile's)")
    p.add_argument("--bright-limit", type=float, default=-2.0, help="bright limit in V")
    p.add_argument("--min-separation-deg", type=float, default=0.0, help="reject stars with closer neighbours")
    p.add_argument("--brightest-per-field", type=int, default=0, help="keep the N brightest of each field (0: all)")
    p.add_argument("--thinning", default="circles", help=f"which fields: {' | '.join(THINNINGS)} of the camera's shape")
    p.add_argument("--drop-variables", action="store_true", help="reject variable stars")
    p.add_argument("--pair-min-deg", type=float, default=0.25, help="smallest tabulated distance")
    p.add_argument("--pair-max-deg", type=float, help="largest tabulated distance (default: the field's diagonal)")
    catalogue_sky.register(p)
    p.add_argument("--epoch", type=float, help="Julian year of the positions (default: middle of use)")
    p.add_argument("--bank-bytes", type=int, help="capacity of the bank")
    p.add_argument("--k-vector", action="store_true", help="an index of the distances goes on board too")
    p.add_argument(
        "--reduced-frame",
        type=_frame,
        metavar="WxH[,N[,STEP]]",
        help="the N (8) brightest of every frame of W by H degrees, STEP (1) degrees apart, as a reduced catalogue",
    )
    p.add_argument("--name", default="", help="name in the manifest")
    p.add_argument("--author", default="", help="who is responsible for it")
    p.add_argument("--out", type=Path, metavar="FILE", help="write the image here and the manifest to FILE.json")
    p.add_argument("--report", type=Path, metavar="FILE", help="write the quality report here, .html or .pdf")
    p.add_argument("--json", action="store_true", help="print one JSON object")
    p.set_defaults(run=run_build)


def run_build(arguments: argparse.Namespace, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> int:
    """Build, write and print."""
    begin = perf_counter()
    request = request_of(arguments, now())
    built = build(request, catalogue_sky.source_of(arguments, request))
    if arguments.out is not None:
        write_file(arguments.out, built.image)
        write_file(arguments.out.with_name(arguments.out.name + ".json"), built.manifest.as_json().encode())
    if arguments.report is not None:
        catalogue_files.write_report(arguments.report, built)
    facts = facts_of(built) | {"elapsed_s": round(perf_counter() - begin, 3)}
    print_facts(facts if arguments.json else facts | facts.pop("funnel"), arguments.json)
    if arguments.out is None and not arguments.json:
        print("nothing was saved: give --out FILE to keep image and manifest", file=sys.stderr)
    return 0


def request_of(a: argparse.Namespace, now: datetime) -> BuildRequest:
    """Return the build request of parsed arguments; converts degrees to radians."""
    camera = profile(a.profile)
    orbit = _orbit(a)
    attitude, start = _attitude(a, orbit is not None), _start(a.start, now)
    height_m = altitude_m(orbit, None if a.altitude_km is None else 1000 * a.altitude_km)
    return BuildRequest(
        profile_name=camera.name,
        format_name=a.format or own_format(camera.name),
        rules=Rules(
            faint_mag=camera.sensor.faint_limit_mag if a.mag_limit is None else a.mag_limit,
            bright_mag=a.bright_limit,
            min_separation_rad=float(np.radians(a.min_separation_deg)),
            brightest_per_field=a.brightest_per_field,
            drop_variables=a.drop_variables,
            thinning=a.thinning,
            screening=catalogue_sky.screening(a),
        ),
        name=a.name,
        author=a.author,
        orbit=orbit,
        attitude=attitude,
        start=start,
        days=a.days,
        margin_rad=float(np.radians(a.margin_deg)),
        pair_min_rad=float(np.radians(a.pair_min_deg)),
        pair_max_rad=None if a.pair_max_deg is None else float(np.radians(a.pair_max_deg)),
        epoch_jyear=a.epoch,
        bank_bytes=a.bank_bytes,
        corrections=catalogue_sky.corrections(a, orbit, attitude, start, height_m),
        source="list" if a.list is not None else a.source,
        occultation=catalogue_sky.occultation(a, height_m),
        method=a.method,
        k_vector=a.k_vector,
        reduced=a.reduced_frame,
    )


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


def _range(text: str) -> Range:
    """Parse ``MIN:MAX`` or one number, degrees."""
    parts = text.split(":")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or len(values) != len(parts):
        raise argparse.ArgumentTypeError(f"expected MIN:MAX or one number in degrees, got {text!r}")
    return values[0], values[-1]


def _nine(text: str) -> tuple[float, ...]:
    return _numbers(text, 9, "nine")


def _three(text: str) -> tuple[float, ...]:
    return _numbers(text, 3, "three")


def _numbers(text: str, count: int, word: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise argparse.ArgumentTypeError(f"expected {word} numbers with commas, got {text!r}")
    return values


def _frame(text: str) -> ReducedFrame:
    sides, *more = text.split(",")
    try:
        width, height = (float(np.radians(float(side))) for side in sides.split("x"))
        brightest, step_deg = int(more[0]) if more else 8, float(more[1]) if len(more) > 1 else 1.0
    except ValueError:
        more = [""] * 3
    if len(more) > 2:
        raise argparse.ArgumentTypeError(f"expected WxH, WxH,N or WxH,N,STEP, got {text!r}")
    return ReducedFrame(width, height, brightest, float(np.radians(step_deg)))


def _radians(limits: Range) -> Range:
    return float(np.radians(limits[0])), float(np.radians(limits[1]))


def _orbit(a: argparse.Namespace) -> ElementsOrbit | TleOrbit | None:
    if a.tle is not None:
        if a.inclination_deg or a.raan_deg:
            raise BadInput("two orbits were given", expected="either --tle or --inclination-deg with --raan-deg")
        try:
            return TleOrbit(read_limited(a.tle, TLE_BYTES).decode("utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise BadInput("the TLE file cannot be read", got=f"{a.tle}: {error}") from None
    if a.inclination_deg is None and a.raan_deg is None:
        return None
    if a.inclination_deg is None:
        raise BadInput("a node without an inclination is no orbit", expected="--inclination-deg with --raan-deg")
    height_m = None if a.altitude_km is None else 1000 * a.altitude_km
    return ElementsOrbit(_radians(a.inclination_deg), _radians(a.raan_deg or (0.0, 360.0)), height_m)


def _attitude(a: argparse.Namespace, has_orbit: bool) -> AttitudeLimits | None:
    given = (a.roll_deg, a.pitch_deg, a.yaw_deg)
    if not has_orbit and a.pointing is None:
        if any(given):
            raise BadInput(
                "attitude limits without an orbit", hint="--inclination-deg and --raan-deg, --tle or --pointing"
            )
        return None
    law = a.pointing or ("sunsat" if a.profile == "sunsat" else "zenith")
    usual = USUAL_DEG.get(law, OTHER_USUAL_DEG)
    roll, pitch, yaw = (_radians(mine or default) for mine, default in zip(given, usual, strict=True))
    ra, dec, field_roll = (float(np.radians(angle)) for angle in (a.ra_deg, a.dec_deg, a.field_roll_deg))
    aside = float(np.radians(a.off_nadir_deg)) if law == "target" else 0.0
    mounting = mounting_of(a.body_from_cam, a.mounting_deg)
    return AttitudeLimits(law, roll, pitch, yaw, ra, dec, field_roll, mounting, off_nadir_rad=aside)


def _start(text: str | None, now: datetime) -> datetime:
    if text is None:
        return now.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("the first day cannot be read", expected="2026-12-01 or 2026-12-01T12:00Z", got=text) from None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
