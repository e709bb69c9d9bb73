"""Request for a sub-catalogue in user units, and its conversion to the builder's request in radians and metres."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import Field

from gss.catalogue_tools.corrections.correction_switches import Corrections
from gss.catalogue_tools.corrections.doubles import Doubles
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS, AttitudeLimits, mounting_of
from gss.catalogue_tools.envelope.occultation import Occultation
from gss.catalogue_tools.plan import altitude_m, orbital_velocity, planes_of, pole_of
from gss.catalogue_tools.request import MAX_HEADS, BuildRequest, ElementsOrbit, TleOrbit, own_format
from gss.catalogue_tools.selection.screening import ScreeningRules
from gss.catalogue_tools.selection.selection import SelectionRules
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.sensor import Baffle
from gss.operations.requests import Id, Request
from gss.skytables.bank import ReducedFrame

FIRST_YEAR, LAST_YEAR = 1950, 2150
SYMMETRIC_DEG = ([-5.0, 5.0], [-5.0, 5.0], [-5.0, 5.0])
USUAL_LIMITS_DEG = {"sunsat": ([-10.0, 10.0], [-5.0, 5.0], [130.0, 140.0])}
"""Usual limits of roll, pitch and yaw by pointing law (Jacobs 1995 Table 5-2). Other laws use :data:`SYMMETRIC_DEG`."""

Angle = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Angle in degrees. The range excludes NaN and infinity."""
Range = Annotated[list[Angle], Field(min_length=2, max_length=2)]
"""Minimum and maximum, degrees."""
Mounting = Annotated[list[Annotated[float, Field(ge=-1.1, le=1.1)]], Field(min_length=9, max_length=9)]
Turns = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Law = Literal["sunsat", "zenith", "nadir", "target", "inertial", "anti_sun", "sun_pointing"]


class CorrectionsRequest(Request):
    """Corrections applied to the source stars. ``doubles``: treatment of stars that the camera cannot separate."""

    proper_motion: bool = True
    parallax: bool = False
    annual_aberration: bool = False
    orbital_aberration: bool = False
    frame: Literal["icrs", "of_date", "b1950"] = "icrs"
    e_terms: bool = True
    instrument_magnitude: bool = False
    roll_off: Literal["off", "average", "worst"] = "off"
    doubles: Literal["", "moniteq", "huffman", "erlank_combine", "erlank_keep", "drop"] = ""
    doubles_separation_deg: float | None = Field(default=None, gt=0, lt=5)
    flag_variables: bool = False
    variables_at_date: bool = False


class OccultationRequest(Request):
    """Occultation of the sky. Angles are in degrees from the boresight; null: limit of the camera's baffle."""

    earth: bool = False
    earth_margin_deg: float = Field(default=0.0, ge=0, le=60)
    sun: bool = False
    sun_deg: float | None = Field(default=None, gt=0, lt=180)
    moon: bool = False
    moon_deg: float | None = Field(default=None, gt=0, lt=180)


class ScreeningRequest(Request):
    """Rules of the screening list. ``action``: off, list (only list the stars) or drop. Reasons: close doubles
    (``doubles``), variable stars (``variables``), high proper motion (``fast``). A star is also listed if more than
    ``most_companions`` stars are at the distance ``arc_deg`` ± ``tolerance_deg`` from it, or if more than
    ``most_false`` false triples are expected."""

    action: Literal["off", "list", "drop"] = "off"
    doubles: bool = True
    variables: bool = True
    fast: bool = True
    most_companions: int | None = Field(default=None, ge=0, le=100_000)
    most_false: float | None = Field(default=None, ge=0, le=1e6)
    arc_deg: float = Field(default=8.0, gt=0, lt=180)
    tolerance_deg: float = Field(default=0.01, gt=0, le=10)


class ReducedRequest(Request):
    """Frame of a reduced catalogue. The reduced catalogue contains the ``brightest`` stars of each upright frame of this size.
    The frames are ``step_deg`` apart."""

    width_deg: float = Field(ge=1, le=120)
    height_deg: float = Field(ge=1, le=120)
    brightest: int = Field(default=8, ge=1, le=100)
    step_deg: float = Field(default=1.0, ge=0.25, le=10)


class CatalogueHead(Request):
    """Mounting of one head of a spacecraft. ``body_from_cam``, ``mounting_deg``: as in the catalogue request. ``unit``: name of
    the head."""

    unit: str = Field(default="", max_length=24)
    body_from_cam: Mounting | None = None
    mounting_deg: Turns | None = None


class CatalogueRequest(Request):
    """Build request. Angles are in degrees. ``orbit``: none selects the whole sky, unless ``pointing`` needs no orbit.
    ``inclination_max_deg``: upper limit of the inclination; null: same as ``inclination_deg``. ``altitude_km``:
    altitude from which the drift of the node over the days of use is computed; null: the node limits are fixed.
    ``eccentricity``: above 0 for an eccentric orbit with the argument of perigee ``perigee_deg`` at the start; ``altitude_km``
    is then the semi-major axis minus 6378 km.
    ``roll_deg``, ``pitch_deg``, ``yaw_deg``: limits; null: usual limits of the law. ``faint_mag``: null: the camera's
    limit. ``body_from_cam``: nine numbers by rows that replace the mounting of the law. ``mounting_deg``:
    alternatively, three rotations about x, y and z in this order from the body axes to the camera axes. ``heads``:
    alternatively, the mountings of several heads; the envelope is the union of the envelopes of all heads.
    ``off_nadir_deg``: off-nadir angle of a target law. ``thinning``: shape of the fields in which the
    ``brightest_per_field`` stars are kept: circles, or upright frames of the camera's shape. ``reduced``: null: no
    reduced catalogue, unless the format requires one, which then uses the camera's frame."""

    name: str = Field(default="", max_length=60)
    profile: str = Field(default="", max_length=40, description="Instrument; empty: that of the unit on the line.")
    format: str = Field(default="", max_length=40, description="On-board format; empty: the instrument's own.")
    orbit: Literal["none", "elements", "tle"] = "none"
    inclination_deg: float = Field(default=97.6, ge=0, le=180)
    inclination_max_deg: float | None = Field(default=None, ge=0, le=180)
    raan_deg: Range = Field(default=[0.0, 360.0])
    altitude_km: float | None = Field(default=None, ge=100, le=1_000_000)
    eccentricity: float = Field(default=0.0, ge=0, lt=1)
    perigee_deg: Angle = 0.0
    tle: str = Field(default="", max_length=400)
    start: str = ""
    days: float = Field(default=14, gt=0, le=3660)
    pointing: Law = "zenith"
    roll_deg: Range | None = None
    pitch_deg: Range | None = None
    yaw_deg: Range | None = None
    ra_deg: float = Field(default=0.0, ge=-360, le=720)
    dec_deg: float = Field(default=0.0, ge=-90, le=90)
    field_roll_deg: float = Field(default=0.0, ge=-360, le=360)
    off_nadir_deg: float = Field(default=0.0, ge=0, le=80)
    body_from_cam: Mounting | None = None
    mounting_deg: Turns | None = None
    heads: list[CatalogueHead] = Field(default=[], max_length=MAX_HEADS)
    margin_deg: float = Field(default=0.5, ge=0, le=20)
    method: Literal["exact", "blocks", "whole_blocks"] = "exact"
    source: Literal["hipparcos", "hipparcos_all", "gaia", "list"] = "hipparcos"
    star_list: Id | None = None
    corrections: CorrectionsRequest = CorrectionsRequest()
    occultation: OccultationRequest = OccultationRequest()
    epoch_jyear: float | None = Field(default=None, ge=1800, le=2200)
    faint_mag: float | None = Field(default=None, ge=-2, le=21)
    bright_mag: float = Field(default=-2.0, ge=-3, le=21)
    min_separation_deg: float = Field(default=0.0, ge=0, le=5)
    brightest_per_field: int = Field(default=0, ge=0, le=500)
    thinning: Literal["circles", "frames"] = "circles"
    drop_variables: bool = False
    screening: ScreeningRequest = ScreeningRequest()
    reduced: ReducedRequest | None = None
    pair_min_deg: float = Field(default=0.25, ge=0, le=20)
    pair_max_deg: float | None = Field(default=None, gt=0, le=120)
    bank_bytes: int | None = Field(default=None, ge=64, le=1 << 30)
    k_vector: bool = False


def build_request(spec: CatalogueRequest, camera: CameraProfile, user: str, now: datetime) -> BuildRequest:
    """Return the builder's request in radians and metres. If the request has an attitude but no start, the days of use begin at
    ``now``."""
    orbit, attitude = orbit_of(spec), _attitude(spec)
    start = moment(spec.start) or (None if attitude is None else now)
    height_m = altitude_m(orbit, None if spec.altitude_km is None else 1000 * spec.altitude_km)
    return BuildRequest(
        profile=camera,
        format_name=spec.format or own_format(camera),
        rules=SelectionRules(
            camera.sensor.faint_limit_mag if spec.faint_mag is None else spec.faint_mag,
            spec.bright_mag,
            math.radians(spec.min_separation_deg),
            spec.brightest_per_field,
            spec.drop_variables,
            spec.thinning,
            _screening(spec),
        ),
        name=spec.name,
        author=user,
        orbit=orbit,
        attitude=attitude,
        start=start,
        days=spec.days,
        margin_rad=math.radians(spec.margin_deg),
        pair_min_rad=math.radians(spec.pair_min_deg),
        pair_max_rad=_optional(spec.pair_max_deg),
        epoch_jyear=spec.epoch_jyear,
        bank_bytes=spec.bank_bytes,
        corrections=_corrections(spec, orbit, attitude, start, height_m),
        source=spec.source,
        star_list=spec.star_list,
        occultation=_occultation(spec.occultation, camera.baffle, height_m),
        method=spec.method,
        k_vector=spec.k_vector,
        reduced=_frame(spec),
        heads=tuple(_head(head) for head in spec.heads),
    )


def with_camera(spec: CatalogueRequest, camera: CameraProfile) -> CatalogueRequest:
    """Return the request with empty camera and format replaced by their names, for storing it."""
    return spec.model_copy(update={"profile": camera.name, "format": spec.format or own_format(camera)})


def moment(text: str) -> datetime | None:
    """Parse a date from a form. Return None if the text is empty. Raises BadInput if it is not ISO 8601 or the year is out of
    range."""
    if not text:
        return None
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput("the start is not a date", expected="ISO 8601, for example 2026-12-01", got=text[:40]) from None
    if not FIRST_YEAR <= at.year <= LAST_YEAR:
        raise BadInput(
            "the start year is out of range", expected=f"a year from {FIRST_YEAR} to {LAST_YEAR}", got=text[:40]
        )
    return at if at.tzinfo else at.replace(tzinfo=UTC)


def orbit_of(spec: CatalogueRequest) -> ElementsOrbit | TleOrbit | None:
    """Return the orbit of a request, None without an orbit."""
    if spec.orbit == "elements":
        low = spec.inclination_deg
        high = low if spec.inclination_max_deg is None else spec.inclination_max_deg
        height_m = None if spec.altitude_km is None else 1000 * spec.altitude_km
        perigee_rad = math.radians(spec.perigee_deg)
        limits = _radians([low, high]), _radians(spec.raan_deg)
        return ElementsOrbit(*limits, height_m, spec.eccentricity, perigee_rad)
    return TleOrbit(spec.tle) if spec.orbit == "tle" else None


def _attitude(spec: CatalogueRequest) -> AttitudeLimits | None:
    if spec.orbit == "none" and spec.pointing in ORBIT_LAWS:
        return None
    roll, pitch, yaw = USUAL_LIMITS_DEG.get(spec.pointing, SYMMETRIC_DEG)
    return AttitudeLimits(
        spec.pointing,
        _radians(spec.roll_deg or roll),
        _radians(spec.pitch_deg or pitch),
        _radians(spec.yaw_deg or yaw),
        ra_rad=math.radians(spec.ra_deg),
        dec_rad=math.radians(spec.dec_deg),
        field_roll_rad=math.radians(spec.field_roll_deg),
        body_from_cam=mounting_of(spec.body_from_cam, spec.mounting_deg),
        off_nadir_rad=math.radians(spec.off_nadir_deg) if spec.pointing == "target" else 0.0,
    )


def _head(head: CatalogueHead) -> tuple[float, ...]:
    """Return the mounting of a head. Raises BadInput if it has none."""
    mounting = mounting_of(head.body_from_cam, head.mounting_deg)
    if mounting is None:
        raise BadInput("a head has no mounting", expected="body_from_cam or mounting_deg", got=head.unit or "neither")
    return mounting


def _occultation(occultation: OccultationRequest, baffle: Baffle, height_m: float | None) -> Occultation:
    """Return the occultation settings. Missing angles are taken from the baffle. For the Sun, this is the Sun limit of
    the baffle. For the Moon, whose stray light is negligible compared with that of the Sun, it is the angle within
    which light falls directly on the lens."""
    if occultation.earth and height_m is None:
        raise BadInput(
            "occultation by the Earth needs the altitude",
            expected="an altitude, or a TLE",
            got="neither",
            hint="set the altitude of the orbit",
        )
    return Occultation(
        altitude_m=height_m if occultation.earth else None,
        earth_margin_rad=math.radians(occultation.earth_margin_deg) if occultation.earth else 0.0,
        sun_rad=(baffle.sun_limit_rad if occultation.sun_deg is None else math.radians(occultation.sun_deg))
        if occultation.sun
        else 0.0,
        moon_rad=(baffle.blind_rad if occultation.moon_deg is None else math.radians(occultation.moon_deg))
        if occultation.moon
        else 0.0,
    )


def _screening(spec: CatalogueRequest) -> ScreeningRules | None:
    screening = spec.screening
    if screening.action == "off":
        return None
    ring = math.radians(screening.arc_deg), math.radians(screening.tolerance_deg)
    return ScreeningRules(
        screening.action,
        screening.doubles,
        screening.variables,
        screening.fast,
        screening.most_companions,
        screening.most_false,
        *ring,
    )


def _frame(spec: CatalogueRequest) -> ReducedFrame | None:
    reduced = spec.reduced
    if reduced is None:
        return None
    return ReducedFrame(
        math.radians(reduced.width_deg),
        math.radians(reduced.height_deg),
        reduced.brightest,
        math.radians(reduced.step_deg),
    )


def _corrections(
    spec: CatalogueRequest,
    orbit: ElementsOrbit | TleOrbit | None,
    attitude: AttitudeLimits | None,
    start: datetime | None,
    height_m: float | None,
) -> Corrections:
    corrections = spec.corrections
    velocity = None
    if corrections.orbital_aberration:
        # With several heads, the mean velocity is used, because each head observes a star from a different point of the
        # orbit.
        velocity = orbital_velocity(
            None if spec.heads else attitude, pole_of(planes_of(orbit, start, spec.days)), height_m
        )
    return Corrections(
        proper_motion=corrections.proper_motion,
        parallax=corrections.parallax,
        annual_aberration=corrections.annual_aberration,
        aberration_days=min(spec.days, 366.0) if corrections.annual_aberration and start is not None else 0.0,
        orbital_aberration=velocity,
        frame=corrections.frame,
        e_terms=corrections.e_terms and not corrections.annual_aberration,
        instrument_magnitude=corrections.instrument_magnitude,
        roll_off=corrections.roll_off,
        doubles=Doubles(corrections.doubles, _optional(corrections.doubles_separation_deg))
        if corrections.doubles
        else None,
        flag_variables=corrections.flag_variables,
        variables_at_date=corrections.variables_at_date,
    )


def _radians(limits: list[float]) -> tuple[float, float]:
    return math.radians(limits[0]), math.radians(limits[1])


def _optional(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else math.radians(angle_deg)
