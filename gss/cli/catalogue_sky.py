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
DEFAULT_LIMIT = -1.0
SHOWN_ROWS = 10


def register(parser: argparse.ArgumentParser) -> None:
    """Add the options to ``build``."""
    parser.add_argument("--source", help=f"{' | '.join(SOURCES)} (default hipparcos)")
    parser.add_argument("--list", metavar="FILE", help="your star list: CSV, ECSV, FITS or VOTable")
    parser.add_argument(
        "--list-column", action="append", default=[], metavar="FIELD=COLUMN", help="for example ra=RAJ2000"
    )
    parser.add_argument(
        "--list-unit", action="append", default=[], metavar="FIELD=UNIT", help="for example ra=hourangle"
    )
    parser.add_argument("--list-epoch", type=float, help="Julian year of the list's positions")
    parser.add_argument("--list-frame", help="icrs | fk5 | b1950")
    parser.add_argument("--refuse-bad-rows", action="store_true", help="reject a list with an invalid row")
    parser.add_argument(
        "--correct",
        action="append",
        default=[],
        metavar="NAME",
        help=f"a correction, repeatable: {' | '.join(SWITCHES)}",
    )
    parser.add_argument("--no-proper-motion", action="store_true", help="keep star positions at the source's epoch")
    parser.add_argument("--frame", help=f"reference frame of positions: {' | '.join(FRAMES)} (default icrs)")
    parser.add_argument("--roll-off", help="vignetting of the lens: off | average | worst (default off)")
    parser.add_argument("--doubles", help=f"stars that the camera cannot separate: {' | '.join(POLICIES)}")
    parser.add_argument(
        "--doubles-separation-deg", type=float, help="default: smallest separation that the camera resolves"
    )
    parser.add_argument(
        "--screen", choices=ACTIONS, help="screen the stars: drop the screened stars, or only list them"
    )
    parser.add_argument(
        "--screen-marks",
        default="doubles,variables,fast",
        metavar="MARKS",
        help="marks that put a star on the screening list",
    )
    parser.add_argument(
        "--screen-companions", type=int, metavar="N", help="screen stars with more than N other stars in their ring"
    )
    parser.add_argument(
        "--screen-false", type=float, metavar="X", help="screen stars with more than X expected false triples"
    )
    parser.add_argument(
        "--screen-ring-deg",
        default="8:0.01",
        metavar="ARC:TOL",
        help="radius and tolerance of the ring (default 8:0.01)",
    )
    parser.add_argument(
        "--earth", action="store_true", help="exclude the sky behind the Earth; needs --altitude-km or --tle"
    )
    parser.add_argument("--earth-margin-deg", type=float, help="margin beyond the Earth's limb")
    for name in ("sun", "moon"):
        parser.add_argument(
            f"--{name}-deg",
            nargs="?",
            type=float,
            const=DEFAULT_LIMIT,
            metavar="DEG",
            help=f"minimum angle to the {name.capitalize()} (default: limit of the baffle)",
        )


def source_of(arguments: argparse.Namespace, request: BuildRequest) -> StarSource | StarTable:
    """Return the stars from which the catalogue is built. Raises BadInput."""
    if request.source == "hipparcos":
        return load_stars()
    if request.source != "list":
        return load_source(request.source, request.depth_mag)
    from gss.operations.catalogues.star_lists import MAX_BYTES, kind_of, parse_star_list
    from gss.operations.parsing.parse_processes import ParseProcesses

    mapping = ListMapping(
        columns=_pairs(arguments.list_column),
        units=_pairs(arguments.list_unit),
        epoch_jyear=arguments.list_epoch,
        frame=arguments.list_frame,
        bad_rows="refuse" if arguments.refuse_bad_rows else "drop",
    )
    try:
        data = read_limited(Path(arguments.list), MAX_BYTES)
    except OSError as error:
        raise BadInput("the star list cannot be read", got=str(error)) from None
    with ParseProcesses() as parsing:
        star_list = parse_star_list(parsing, data, kind_of(arguments.list), mapping)
    star_list = for_known_cameras(star_list, registry().names())
    require_camera(star_list.camera, request.profile_name)
    _print_dropped(star_list)
    return of_list(star_list.stars, arguments.list)


def _print_dropped(star_list: ImportedList) -> None:
    """Print the dropped rows, because the user expects their stars in the catalogue."""
    for row in star_list.dropped[:SHOWN_ROWS]:
        print(f"gss: row {row.row} was excluded: {row.column}: {row.reason} ({row.value})", file=sys.stderr)
    if star_list.dropped_count > SHOWN_ROWS:
        print(f"gss: {star_list.dropped_count} rows were excluded in total", file=sys.stderr)


def values_of(arguments: argparse.Namespace) -> dict[str, object]:
    """Return the request's values for these options."""
    if unknown := [name for name in arguments.correct if name not in SWITCHES]:
        raise BadInput("unknown correction", expected=" | ".join(SWITCHES), got=", ".join(unknown))
    corrections = {
        **{name: name in arguments.correct for name in SWITCHES},
        "proper_motion": not arguments.no_proper_motion,
        "frame": arguments.frame,
        "roll_off": arguments.roll_off,
        "doubles": arguments.doubles,
        "doubles_separation_deg": arguments.doubles_separation_deg,
    }
    occultation = {
        "earth": arguments.earth,
        "earth_margin_deg": arguments.earth_margin_deg,
        "sun": arguments.sun_deg is not None,
        "sun_deg": None if arguments.sun_deg == DEFAULT_LIMIT else arguments.sun_deg,
        "moon": arguments.moon_deg is not None,
        "moon_deg": None if arguments.moon_deg == DEFAULT_LIMIT else arguments.moon_deg,
    }
    return {
        "source": "list" if arguments.list is not None else arguments.source,
        "corrections": _without_none(corrections),
        "occultation": _without_none(occultation),
        "screening": _screening(arguments),
    }


def _screening(arguments: argparse.Namespace) -> dict[str, object] | None:
    if arguments.screen is None:
        return None
    marks = [mark for mark in arguments.screen_marks.split(",") if mark]
    if unknown := [mark for mark in marks if mark not in MARKS]:
        raise BadInput("unknown mark", expected=",".join(MARKS), got=",".join(unknown))
    try:
        arc_deg, tolerance_deg = (float(part) for part in arguments.screen_ring_deg.split(":"))
    except ValueError:
        raise BadInput(
            "the ring cannot be read", expected="ARC:TOL in degrees", got=arguments.screen_ring_deg
        ) from None
    return {
        "action": arguments.screen,
        **{mark: mark in marks for mark in MARKS},
        "most_companions": arguments.screen_companions,
        "most_false": arguments.screen_false,
        "arc_deg": arc_deg,
        "tolerance_deg": tolerance_deg,
    }


def _without_none(values: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in values.items() if value is not None}


def _pairs(texts: list[str]) -> dict[str, str]:
    pairs = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not (name and sign and value):
            raise BadInput("a field of the list cannot be read", expected="FIELD=VALUE", got=text)
        pairs[name] = value
    return pairs
