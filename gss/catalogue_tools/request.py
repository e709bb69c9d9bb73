"""What a catalogue manager asks for, and what it means: the checked parameters of one build."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from gss.catalogue_tools.attitude import ORBIT_LAWS, AttitudeLimits
from gss.catalogue_tools.corrections import sun_longitude_rad
from gss.catalogue_tools.envelope import BandEnvelope, Envelope, PatchEnvelope, WholeSky
from gss.catalogue_tools.field import FieldShape, widened
from gss.catalogue_tools.onboard import check_format
from gss.catalogue_tools.orbits import OrbitRanges, Range, from_elements, from_tle, jyear_of
from gss.catalogue_tools.selection import Rules
from gss.domain.errors import BadInput
from gss.domain.profiles import CameraProfile, profile

# Chosen: the documents' 1 MiB of flash holds the program and several banks (Jacobs 1995 app. D.1, Erlank 2013 §4.2).
BANK_BYTES = {"cubestar": 256 * 1024, "sunsat": 512 * 1024}
PAIR_MIN_RAD = np.radians(0.25)
EPOCH_WITHOUT_DATES_JYEAR = 2000.0
# In ten years the fastest stars move a pixel of a wide camera.
EPOCH_TOLERANCE_YR = 10.0
POINTINGS = 30_000


@dataclass(frozen=True)
class ElementsOrbit:
    """Limits of inclination and node, ICRS; circular, all arguments of latitude (Jacobs 1995 Table 5-2)."""

    inclination_rad: Range
    raan_rad: Range


@dataclass(frozen=True)
class TleOrbit:
    """A two-line element set; the node drifts from ``BuildRequest.start`` over its ``days``."""

    text: str


@dataclass(frozen=True)
class BuildRequest:
    """One build. ``orbit`` None: no orbit, which with ``attitude`` None is the whole sky.

    ``margin_rad`` widens the field on every side. ``pair_max_rad`` None: the field's diagonal. ``start``: UTC with a
    time zone. ``epoch_jyear`` None: the middle of the validity, J2000 without dates. ``bank_bytes`` None: the format's
    usual bank. ``query_tolerance_px``: half width of the matcher's distance query, for the quality report.
    """

    profile_name: str
    format_name: str
    rules: Rules
    name: str = ""
    author: str = ""
    orbit: ElementsOrbit | TleOrbit | None = None
    attitude: AttitudeLimits | None = None
    start: datetime | None = None
    days: float = 14.0
    margin_rad: float = 0.0
    pair_min_rad: float = PAIR_MIN_RAD
    pair_max_rad: float | None = None
    epoch_jyear: float | None = None
    bank_bytes: int | None = None
    query_tolerance_px: float = 1.0
    seed: int = 1
    pointings: int = POINTINGS

    def __post_init__(self) -> None:
        check_format(self.format_name)
        profile(self.profile_name)
        if not 0 <= self.margin_rad < np.radians(30):
            raise BadInput("margin is out of range", expected="0° to 30°", got=f"{np.degrees(self.margin_rad):g}°")
        if not (np.isfinite(self.days) and 0 < self.days <= 3660):
            raise BadInput("validity is out of range", expected="more than 0, at most 3660 days", got=f"{self.days}")
        if self.start is not None and self.start.tzinfo is None:
            raise BadInput(
                "the start has no time zone", expected="a time with its offset from UTC", got=str(self.start)
            )
        if self.pointings < 1:
            raise BadInput("no pointings to judge the quality by", expected="at least 1", got=str(self.pointings))
        _check_epoch(self)


@dataclass(frozen=True)
class Plan:
    """A request with everything worked out. ``shape``: the field itself; the envelope's is wider by the margin."""

    request: BuildRequest
    profile: CameraProfile
    shape: FieldShape
    envelope: Envelope
    planes: OrbitRanges | None
    epoch_jyear: float
    valid_from: datetime | None
    valid_to: datetime | None
    pair_max_rad: float
    bank_bytes: int


def plan(request: BuildRequest) -> Plan:
    """Work a request out. Fails on anything that cannot be built."""
    chosen = profile(request.profile_name)
    planes = _planes(request)
    wide = FieldShape(widened(chosen.camera, request.margin_rad))
    envelope = _envelope(request, wide, planes)
    drifts = isinstance(envelope, BandEnvelope) or (
        request.attitude is not None and request.attitude.pointing == "anti_sun"
    )
    return Plan(
        request,
        chosen,
        FieldShape(chosen.camera),
        envelope,
        planes,
        epoch_of(request),
        request.start,
        _end(request) if drifts else None,
        chosen.camera.diagonal_rad if request.pair_max_rad is None else request.pair_max_rad,
        BANK_BYTES[request.format_name] if request.bank_bytes is None else request.bank_bytes,
    )


def epoch_of(request: BuildRequest) -> float:
    """Julian year of the star positions."""
    if request.epoch_jyear is not None:
        return request.epoch_jyear
    middle = _middle(request)
    return EPOCH_WITHOUT_DATES_JYEAR if middle is None else jyear_of(middle)


def parameters_of(request: BuildRequest) -> dict[str, Any]:
    """The request as plain values, for the manifest."""
    content = asdict(request)
    content["start"] = request.start.isoformat() if request.start else None
    return content


def _end(request: BuildRequest) -> datetime | None:
    return request.start + timedelta(days=request.days) if request.start else None


def _middle(request: BuildRequest) -> datetime | None:
    return request.start + timedelta(days=request.days / 2) if request.start else None


def _planes(request: BuildRequest) -> OrbitRanges | None:
    if isinstance(request.orbit, TleOrbit):
        if request.start is None:
            raise BadInput("a TLE needs dates", expected="a start and a number of days", got="no start")
        return from_tle(request.orbit.text, request.start, request.days)
    if isinstance(request.orbit, ElementsOrbit):
        return from_elements(request.orbit.inclination_rad, request.orbit.raan_rad)
    return None


def _envelope(request: BuildRequest, shape: FieldShape, planes: OrbitRanges | None) -> Envelope:
    limits = request.attitude
    if limits is None:
        if planes is None:
            return WholeSky(shape)
        raise BadInput("an orbit without attitude limits says nothing", expected="a pointing law with its limits")
    if limits.pointing in ORBIT_LAWS:
        if planes is None:
            raise BadInput(
                f"pointing {limits.pointing} follows the orbit",
                expected="orbital elements or a TLE",
                got="no orbit",
                hint="leave the attitude limits away for the whole sky",
            )
        return BandEnvelope(shape, limits, planes)
    if limits.pointing == "inertial":
        return PatchEnvelope(shape, limits)
    end = _end(request)
    if request.start is None or end is None:
        raise BadInput(
            "pointing away from the Sun needs dates", expected="a start and a number of days", got="no start"
        )
    sun = sun_longitude_rad(jyear_of(request.start)), sun_longitude_rad(jyear_of(end))
    return PatchEnvelope(shape, limits, (sun[0], min(sun[1], sun[0] + 2 * np.pi)))


def _check_epoch(request: BuildRequest) -> None:
    middle = _middle(request)
    if middle is None or request.epoch_jyear is None:
        return
    if not abs(request.epoch_jyear - jyear_of(middle)) <= EPOCH_TOLERANCE_YR:
        raise BadInput(
            "the epoch of the positions is far from the dates of use",
            expected=f"within {EPOCH_TOLERANCE_YR:g} years of {jyear_of(middle):.1f}",
            got=f"{request.epoch_jyear:g}",
        )
