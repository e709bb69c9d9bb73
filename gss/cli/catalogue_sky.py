"""``gss catalogue build``: options for star source, corrections, screening and occultation."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gss.catalogue_tools.corrections.correction_switches import FRAMES
from gss.catalogue_tools.corrections.doubles import POLICIES
from gss.catalogue_tools.request import BuildRequest
from gss.catalogue_tools.selection.screening import ACTIONS
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.sources.sources import SOURCES, StarSource, load_source, of_list
from gss.catalogue_tools.sources.star_list_mapping import ListMapping
from gss.catalogue_tools.sources.star_lists import ImportedList, for_known_cameras, require_camera
from gss.cli.input_files import read_limited
from gss.cli.instruments import registry
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable

SWITCHES = (
    "parallax",
    "annual_aberration",
    "orbital_aberration",
    "instrument_magnitude",
    "flag_variables",
    "variables_at_date",
)
MARKS = ("doubles", "variables", "fast")
OWN = -1.0
SHOWN_ROWS = 10


def register(p: argparse.ArgumentParser) -> None:
    """Add the options to ``build``."""
    p.add_argument("--source", help=f"{' | '.join(SOURCES)} (default hipparcos)")
    p.add_argument("--list", metavar="FILE", help="your star list: CSV, ECSV, FITS or VOTable")
    p.add_argument("--list-column", action="append", default=[], metavar="FIELD=COLUMN", help="for example ra=RAJ2000")
    p.add_argument("--list-unit", action="append", default=[], metavar="FIELD=UNIT", help="for example ra=hourangle")
    p.add_argument("--list-epoch", type=float, help="Julian year of the list's positions")
    p.add_argument("--list-frame", help="icrs | fk5 | b1950")
    p.add_argument("--refuse-bad-rows", action="store_true", help="reject a list with an invalid row")
    p.add_argument(
        "--correct",
        action="append",
        default=[],
        metavar="NAME",
        help=f"a correction, repeatable: {' | '.join(SWITCHES)}",
    )
    p.add_argument("--no-proper-motion", action="store_true", help="keep star positions at the source's epoch")
    p.add_argument("--frame", help=f"reference frame of positions: {' | '.join(FRAMES)} (default icrs)")
    p.add_argument("--roll-off", help="vignetting of the lens: off | average | worst (default off)")
    p.add_argument("--doubles", help=f"stars that the camera cannot separate: {' | '.join(POLICIES)}")
    p.add_argument("--doubles-separation-deg", type=float, help="default: what the camera can separate")
    p.add_argument("--screen", choices=ACTIONS, help="screening list: drop its stars, or only list them")
    p.add_argument(
        "--screen-marks",
        default="doubles,variables,fast",
        metavar="MARKS",
        help="marks that put a star on the screening list",
    )
    p.add_argument(
        "--screen-companions", type=int, metavar="N", help="screen stars with more stars than this in the ring"
    )
    p.add_argument(
        "--screen-false", type=float, metavar="X", help="screen stars with more expected false triples than this"
    )
    p.add_argument(
        "--screen-ring-deg",
        default="8:0.01",
        metavar="ARC:TOL",
        help="radius and tolerance of the ring (default 8:0.01)",
    )
    p.add_argument("--earth", action="store_true", help="exclude sky hidden by the Earth; needs --altitude-km or --tle")
    p.add_argument("--earth-margin-deg", type=float, help="margin beyond the Earth's limb")
    for name in ("sun", "moon"):
        p.add_argument(
            f"--{name}-deg",
            nargs="?",
            type=float,
            const=OWN,
            metavar="DEG",
            help=f"minimum angle to the {name.capitalize()} (default: limit of the baffle)",
        )


def source_of(a: argparse.Namespace, request: BuildRequest) -> StarSource | StarTable:
    """Return the stars to build from."""
    if request.source == "hipparcos":
        return load_stars()
    if request.source != "list":
        return load_source(request.source, request.depth_mag)
    from gss.operations.catalogues.star_lists import LARGEST_BYTES, kind_of, parse_star_list
    from gss.operations.parsing.parse_processes import ParseProcesses

    mapping = ListMapping(
        columns=_pairs(a.list_column),
        units=_pairs(a.list_unit),
        epoch_jyear=a.list_epoch,
        frame=a.list_frame,
        bad_rows="refuse" if a.refuse_bad_rows else "drop",
    )
    try:
        data = read_limited(Path(a.list), LARGEST_BYTES)
    except OSError as error:
        raise BadInput("the star list cannot be read", got=str(error)) from None
    with ParseProcesses() as parsing:
        read = parse_star_list(parsing, data, kind_of(a.list), mapping)
    read = for_known_cameras(read, registry().names())
    require_camera(read.camera, request.profile_name)
    _print_dropped(read)
    return of_list(read.stars, a.list)


def _print_dropped(read: ImportedList) -> None:
    """Report every dropped row, because the user expects that star in the catalogue."""
    for row in read.dropped[:SHOWN_ROWS]:
        print(f"gss: row {row.row} was excluded: {row.column}: {row.reason} ({row.value})", file=sys.stderr)
    if read.dropped_count > SHOWN_ROWS:
        print(f"gss: {read.dropped_count} rows were excluded in total", file=sys.stderr)


def values_of(a: argparse.Namespace) -> dict[str, object]:
    """Return the request's values for these options."""
    if unknown := [name for name in a.correct if name not in SWITCHES]:
        raise BadInput("unknown correction", expected=" | ".join(SWITCHES), got=", ".join(unknown))
    corrections = {
        **{name: name in a.correct for name in SWITCHES},
        "proper_motion": not a.no_proper_motion,
        "frame": a.frame,
        "roll_off": a.roll_off,
        "doubles": a.doubles,
        "doubles_separation_deg": a.doubles_separation_deg,
    }
    hidden = {
        "earth": a.earth,
        "earth_margin_deg": a.earth_margin_deg,
        "sun": a.sun_deg is not None,
        "sun_deg": None if a.sun_deg == OWN else a.sun_deg,
        "moon": a.moon_deg is not None,
        "moon_deg": None if a.moon_deg == OWN else a.moon_deg,
    }
    return {
        "source": "list" if a.list is not None else a.source,
        "corrections": _given(corrections),
        "occultation": _given(hidden),
        "screening": _screening(a),
    }


def _screening(a: argparse.Namespace) -> dict[str, object] | None:
    if a.screen is None:
        return None
    marks = [mark for mark in a.screen_marks.split(",") if mark]
    if unknown := [mark for mark in marks if mark not in MARKS]:
        raise BadInput("unknown mark", expected=",".join(MARKS), got=",".join(unknown))
    try:
        arc_deg, tolerance_deg = (float(part) for part in a.screen_ring_deg.split(":"))
    except ValueError:
        raise BadInput("the ring cannot be read", expected="ARC:TOL in degrees", got=a.screen_ring_deg) from None
    return {
        "action": a.screen,
        **{mark: mark in marks for mark in MARKS},
        "most_companions": a.screen_companions,
        "most_false": a.screen_false,
        "arc_deg": arc_deg,
        "tolerance_deg": tolerance_deg,
    }


def _given(values: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in values.items() if value is not None}


def _pairs(texts: list[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not (name and sign and value):
            raise BadInput("a field of the list cannot be read", expected="FIELD=VALUE", got=text)
        pairs[name] = value
    return pairs
