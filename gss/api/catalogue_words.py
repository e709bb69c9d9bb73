"""Convert the catalogue form to a build request: degrees to radians, text to records. The command line uses the same
field names."""

from __future__ import annotations

import math
from datetime import UTC, datetime

from gss.api.schemas.catalogues import CatalogueIn
from gss.catalogue_tools.corrections.correction_switches import Corrections
from gss.catalogue_tools.corrections.doubles import Doubles
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS, AttitudeLimits
from gss.catalogue_tools.plan import planes_of
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, TleOrbit
from gss.catalogue_tools.selection.screening import ScreeningRules
from gss.catalogue_tools.selection.selection import Rules
from gss.catalogue_tools.tables.terms import altitude_m, mounting_of, occultation_of, orbital_velocity, pole_of
from gss.domain.bank_tables import ReducedFrame
from gss.domain.errors import BadInput

FIRST_YEAR, LAST_YEAR = 1950, 2150


def request_of(body: CatalogueIn, user: str, now: datetime) -> BuildRequest:
    """Return the build request for the form. If an attitude is set and no start is given, the days of use begin at ``now``."""
    orbit, attitude = _orbit(body), _attitude(body)
    start = moment(body.start) or (None if attitude is None else now)
    height_m = altitude_m(orbit, None if body.altitude_km is None else 1000 * body.altitude_km)
    hidden = body.occultation
    return BuildRequest(
        profile_name=body.profile,
        format_name=body.format,
        rules=Rules(
            body.faint_mag,
            body.bright_mag,
            math.radians(body.min_separation_deg),
            body.brightest_per_field,
            body.drop_variables,
            body.thinning,
            _screening(body),
        ),
        name=body.name,
        author=user,
        orbit=orbit,
        attitude=attitude,
        start=start,
        days=body.days,
        margin_rad=math.radians(body.margin_deg),
        pair_min_rad=math.radians(body.pair_min_deg),
        pair_max_rad=_optional(body.pair_max_deg),
        epoch_jyear=body.epoch_jyear,
        bank_bytes=body.bank_bytes,
        corrections=_corrections(body, orbit, attitude, start, height_m),
        source=body.source,
        star_list=body.star_list,
        occultation=occultation_of(
            body.profile,
            height_m,
            earth=hidden.earth,
            margin_rad=math.radians(hidden.earth_margin_deg),
            sun=hidden.sun,
            sun_rad=_optional(hidden.sun_deg),
            moon=hidden.moon,
            moon_rad=_optional(hidden.moon_deg),
        ),
        method=body.method,
        k_vector=body.k_vector,
        reduced=_frame(body),
    )


def moment(text: str) -> datetime | None:
    """Parse a date from a form; None if empty. BadInput if it is not ISO 8601 or its year is out of range."""
    if not text:
        return None
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("the start is not a date", expected="ISO 8601, for example 2026-12-01", got=text[:40]) from None
    if not FIRST_YEAR <= at.year <= LAST_YEAR:
        raise BadInput(
            "the start is far from any mission", expected=f"a year from {FIRST_YEAR} to {LAST_YEAR}", got=text[:40]
        )
    return at if at.tzinfo else at.replace(tzinfo=UTC)


def _orbit(body: CatalogueIn) -> ElementsOrbit | TleOrbit | None:
    if body.orbit == "elements":
        inclination = math.radians(body.inclination_deg)
        height_m = None if body.altitude_km is None else 1000 * body.altitude_km
        return ElementsOrbit((inclination, inclination), _radians(body.raan_deg), height_m)
    return TleOrbit(body.tle) if body.orbit == "tle" else None


def _attitude(body: CatalogueIn) -> AttitudeLimits | None:
    if body.orbit == "none" and body.pointing in ORBIT_LAWS:
        return None
    return AttitudeLimits(
        body.pointing,
        _radians(body.roll_deg),
        _radians(body.pitch_deg),
        _radians(body.yaw_deg),
        ra_rad=math.radians(body.ra_deg),
        dec_rad=math.radians(body.dec_deg),
        field_roll_rad=math.radians(body.field_roll_deg),
        body_from_cam=mounting_of(body.body_from_cam, body.mounting_deg),
        off_nadir_rad=math.radians(body.off_nadir_deg) if body.pointing == "target" else 0.0,
    )


def _screening(body: CatalogueIn) -> ScreeningRules | None:
    s = body.screening
    if s.action == "off":
        return None
    ring = math.radians(s.arc_deg), math.radians(s.tolerance_deg)
    return ScreeningRules(s.action, s.doubles, s.variables, s.fast, s.most_companions, s.most_false, *ring)


def _frame(body: CatalogueIn) -> ReducedFrame | None:
    r = body.reduced
    if r is None:
        return None
    return ReducedFrame(math.radians(r.width_deg), math.radians(r.height_deg), r.brightest, math.radians(r.step_deg))


def _corrections(
    body: CatalogueIn,
    orbit: ElementsOrbit | TleOrbit | None,
    attitude: AttitudeLimits | None,
    start: datetime | None,
    height_m: float | None,
) -> Corrections:
    c = body.corrections
    velocity = None
    if c.orbital_aberration:
        velocity = orbital_velocity(attitude, pole_of(planes_of(orbit, start, body.days)), height_m)
    return Corrections(
        proper_motion=c.proper_motion,
        parallax=c.parallax,
        annual_aberration=c.annual_aberration,
        aberration_days=min(body.days, 366.0) if c.annual_aberration and start is not None else 0.0,
        orbital_aberration=velocity,
        frame=c.frame,
        e_terms=c.e_terms and not c.annual_aberration,
        instrument_magnitude=c.instrument_magnitude,
        roll_off=c.roll_off,
        doubles=Doubles(c.doubles, _optional(c.doubles_separation_deg)) if c.doubles else None,
        flag_variables=c.flag_variables,
        variables_at_date=c.variables_at_date,
    )


def _radians(limits: list[float]) -> tuple[float, float]:
    return math.radians(limits[0]), math.radians(limits[1])


def _optional(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)
