"""``gss catalogue build``: options for star source, corrections, screening and occultation."""

from __future__ import annotations

import argparse
import sys
from datetime import datetime
from pathlib import Path

import numpy as np

from gss.catalogue_tools.corrections.correction_switches import FRAMES, Corrections
from gss.catalogue_tools.corrections.doubles import POLICIES, Doubles
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.occultation import Occultation
from gss.catalogue_tools.plan import planes_of
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, TleOrbit
from gss.catalogue_tools.selection.screening import ACTIONS, ScreeningRules
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.sources.sources import SOURCES, Source, load_source, of_list
from gss.catalogue_tools.sources.star_list_mapping import ListMapping
from gss.catalogue_tools.sources.star_lists import ImportedList, require_camera
from gss.catalogue_tools.tables.terms import occultation_of, orbital_velocity, pole_of
from gss.cli.input_files import read_limited
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
    p.add_argument("--source", default="hipparcos", help=f"{' | '.join(SOURCES)} (default hipparcos)")
    p.add_argument("--list", metavar="FILE", help="a star list of your own: CSV, ECSV, FITS or VOTable")
    p.add_argument("--list-column", action="append", default=[], metavar="FIELD=COLUMN", help="for example ra=RAJ2000")
    p.add_argument("--list-unit", action="append", default=[], metavar="FIELD=UNIT", help="for example ra=hourangle")
    p.add_argument("--list-epoch", type=float, help="Julian year of the list's positions")
    p.add_argument("--list-frame", help="icrs | fk5 | b1950")
    p.add_argument("--refuse-bad-rows", action="store_true", help="a bad row of the list ends the build")
    p.add_argument(
        "--correct",
        action="append",
        default=[],
        metavar="NAME",
        help=f"a correction, repeatable: {' | '.join(SWITCHES)}",
    )
    p.add_argument("--no-proper-motion", action="store_true", help="leave the stars at the source's epoch")
    p.add_argument("--frame", default="icrs", help=f"axes on board: {' | '.join(FRAMES)}")
    p.add_argument("--roll-off", default="off", help="the lens's loss: off | average | worst")
    p.add_argument("--doubles", default="", help=f"stars that the camera cannot separate: {' | '.join(POLICIES)}")
    p.add_argument("--doubles-separation-deg", type=float, help="default: what the camera can separate")
    p.add_argument("--screen", choices=ACTIONS, help="the screening list: drop its stars, or only list them")
    p.add_argument("--screen-marks", default="doubles,variables,fast", metavar="MARKS", help="which put a star on it")
    p.add_argument("--screen-companions", type=int, metavar="N", help="so do more stars than that in the ring")
    p.add_argument("--screen-false", type=float, metavar="X", help="so do more expected false triples than that")
    p.add_argument("--screen-ring-deg", default="8:0.01", metavar="ARC:TOL", help="the ring (default 8:0.01)")
    p.add_argument("--earth", action="store_true", help="the Earth hides sky; needs --altitude-km or --tle")
    p.add_argument("--earth-margin-deg", type=float, default=0.0, help="beyond the limb")
    for name in ("sun", "moon"):
        p.add_argument(
            f"--{name}-deg",
            nargs="?",
            type=float,
            const=OWN,
            metavar="DEG",
            help=f"no use of the camera closer to the {name.capitalize()} (default: its baffle)",
        )


def source_of(a: argparse.Namespace, request: BuildRequest) -> Source | StarTable:
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
    require_camera(read.camera, request.profile_name)
    _tell_dropped(read)
    return of_list(read.stars, a.list)


def _tell_dropped(read: ImportedList) -> None:
    """Report every dropped row, because the user expects that star in the catalogue."""
    for row in read.dropped[:SHOWN_ROWS]:
        print(f"gss: row {row.row} was left out: {row.column}: {row.reason} ({row.value})", file=sys.stderr)
    if read.dropped_count > SHOWN_ROWS:
        print(f"gss: {read.dropped_count} rows were left out in all", file=sys.stderr)


def corrections(
    a: argparse.Namespace,
    orbit: ElementsOrbit | TleOrbit | None,
    attitude: AttitudeLimits | None,
    start: datetime,
    height_m: float | None,
) -> Corrections:
    """Return the corrections to apply to the stars."""
    unknown = [name for name in a.correct if name not in SWITCHES]
    if unknown:
        raise BadInput("unknown correction", expected=" | ".join(SWITCHES), got=", ".join(unknown))
    on = {name: name in a.correct for name in SWITCHES if name != "orbital_aberration"}
    velocity = None
    if "orbital_aberration" in a.correct:
        velocity = orbital_velocity(attitude, pole_of(planes_of(orbit, start, a.days)), height_m)
    separation = None if a.doubles_separation_deg is None else float(np.radians(a.doubles_separation_deg))
    return Corrections(
        proper_motion=not a.no_proper_motion,
        orbital_aberration=velocity,
        aberration_days=min(a.days, 366.0) if on["annual_aberration"] else 0.0,
        frame=a.frame,
        e_terms=not on["annual_aberration"],
        roll_off=a.roll_off,
        doubles=Doubles(a.doubles, separation) if a.doubles else None,
        **on,
    )


def screening(a: argparse.Namespace) -> ScreeningRules | None:
    """Return the screening rules, None without a screening list."""
    if a.screen is None:
        return None
    marks = [mark for mark in a.screen_marks.split(",") if mark]
    if unknown := [mark for mark in marks if mark not in MARKS]:
        raise BadInput("unknown mark", expected=",".join(MARKS), got=",".join(unknown))
    try:
        arc, tolerance = (float(np.radians(float(part))) for part in a.screen_ring_deg.split(":"))
    except ValueError:
        raise BadInput("the ring cannot be read", expected="ARC:TOL in degrees", got=a.screen_ring_deg) from None
    on = {mark: mark in marks for mark in MARKS}
    return ScreeningRules(
        a.screen,
        **on,
        most_companions=a.screen_companions,
        most_false=a.screen_false,
        arc_rad=arc,
        tolerance_rad=tolerance,
    )


def occultation(a: argparse.Namespace, height_m: float | None) -> Occultation:
    """Return the occultation settings."""
    return occultation_of(
        a.profile,
        height_m,
        earth=a.earth,
        margin_rad=float(np.radians(a.earth_margin_deg)),
        sun=a.sun_deg is not None,
        sun_rad=_given(a.sun_deg),
        moon=a.moon_deg is not None,
        moon_rad=_given(a.moon_deg),
    )


def _given(angle_deg: float | None) -> float | None:
    return None if angle_deg is None or angle_deg == OWN else float(np.radians(angle_deg))


def _pairs(texts: list[str]) -> dict[str, str]:
    found = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not (name and sign and value):
            raise BadInput("a field of the list cannot be read", expected="FIELD=VALUE", got=text)
        found[name] = value
    return found
