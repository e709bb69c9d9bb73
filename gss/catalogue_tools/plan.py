"""Derive the build plan of a request: field of view, orbit planes, envelope, dates and limits of the tables."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from gss.catalogue_tools.corrections.correction_switches import MeanOrbitVelocity
from gss.catalogue_tools.corrections.corrections import DAYS_PER_YEAR, sun_longitude_rad
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS, SUN_LAWS, AttitudeLimits, euler_123
from gss.catalogue_tools.envelope.blocks import BlockEnvelope, ShareReport
from gss.catalogue_tools.envelope.ellipse import (
    EARTH_MU_M3_S2,
    EARTH_RADIUS_M,
    Ellipse,
    node_rate_rad_s,
    perigee_rate_rad_s,
)
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope, PatchEnvelope, WholeSky
from gss.catalogue_tools.envelope.field import FieldShape, widened
from gss.catalogue_tools.envelope.lifetime import Lifetime, lifetime
from gss.catalogue_tools.envelope.occultation import OccultedEnvelope
from gss.catalogue_tools.envelope.orbits import (
    OrbitRanges,
    altitude_of_tle,
    from_elements,
    from_tle,
    jyear_of,
)
from gss.catalogue_tools.envelope.several_heads import HeadsEnvelope
from gss.catalogue_tools.request import BLOCK_RULES, BuildRequest, ElementsOrbit, TleOrbit, epoch_of
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput

# This value is chosen. In the documents, a flash of 1 MiB contains the program and several banks (Jacobs 1995 app. D.1,
# Erlank 2013
# §4.2). The packages of the shipped instruments state the same size.
BANK_BYTES = 192 * 1024
SECONDS_PER_DAY = 86_400.0
SUN_RATE_RAD_DAY = 2 * np.pi / DAYS_PER_YEAR


@dataclass(frozen=True)
class BuildPlan:
    """A request with all derived values.

    ``shape``: field of view without the margin; the shape of the envelope includes the margin. ``base``: envelope
    before occultation.
    """

    request: BuildRequest
    profile: CameraProfile
    shape: FieldShape
    envelope: Envelope
    base: Envelope
    planes: OrbitRanges | None
    epoch_jyear: float
    valid_from: datetime | None
    valid_to: datetime | None
    pair_max_rad: float
    bank_bytes: int

    @property
    def date_jyear(self) -> float:
        """Julian year for which the apparent sky is computed."""
        middle = self.request.middle
        return self.epoch_jyear if middle is None else jyear_of(middle)

    @property
    def drift_rad_day(self) -> float:
        """Rate at which the envelope moves with its node or along the ecliptic; 0 if it does not move."""
        limits, days = self.request.attitude, self.request.days
        if self.planes is not None and limits is not None and limits.pointing in ORBIT_LAWS:
            orbit = self.request.orbit
            if isinstance(orbit, ElementsOrbit) and orbit.altitude_m is None:
                # Without an altitude the node rate is unknown, so a Sun-synchronous orbit is assumed.
                return SUN_RATE_RAD_DAY
            return (self.planes.raan_end_rad - self.planes.raan_start_rad) / days
        return SUN_RATE_RAD_DAY if limits is not None and limits.pointing in SUN_LAWS else 0.0

    def lifetime(self) -> Lifetime:
        """Return the lifetime of the envelope; with several heads, that of the head with the shortest lifetime."""
        heads = self.base.heads if isinstance(self.base, HeadsEnvelope) else (self.base,)
        return min(
            (lifetime(envelope, self.drift_rad_day, self.valid_to) for envelope in heads),
            key=lambda envelope: envelope.days,
        )


def plan(request: BuildRequest, report: ShareReport | None = None) -> BuildPlan:
    """Derive the plan of a request. Raises BadInput if the request cannot be built.

    ``report`` is called later, with the fraction done, while the envelope steps through its blocks.
    """
    profile = request.profile
    planes = planes_of(request.orbit, request.start, request.days)
    shape = FieldShape(widened(profile.camera, request.margin_rad))
    envelopes = [_envelope(request, limits, shape, planes, report) for limits in request.attitudes]
    base = HeadsEnvelope(tuple(envelopes)) if request.heads else envelopes[0]
    hidden = request.occultation
    limits = request.attitude
    longest = profile.camera.diagonal_rad if request.pair_max_rad is None else request.pair_max_rad
    _check_distances(request.pair_min_rad, longest)
    drifts = (
        isinstance(envelopes[0], BandEnvelope | BlockEnvelope)
        or (limits is not None and limits.pointing in SUN_LAWS)
        or hidden.sun_rad > 0
        or hidden.moon_rad > 0
    )
    return BuildPlan(
        request,
        profile,
        FieldShape(profile.camera),
        _occulted(request, base, planes) if hidden.active else base,
        base,
        planes,
        epoch_of(request),
        request.start,
        request.end if drifts else None,
        longest,
        BANK_BYTES if request.bank_bytes is None else request.bank_bytes,
    )


def _check_distances(shortest_rad: float, longest_rad: float) -> None:
    if not 0 <= shortest_rad < longest_rad:
        raise BadInput(
            "the shortest distance is not below the longest",
            expected=f"0° to less than {np.degrees(longest_rad):.4g}°",
            got=f"{np.degrees(shortest_rad):.4g}°",
            hint="leave the longest distance empty to use the diagonal of the field",
        )


def planes_of(orbit: ElementsOrbit | TleOrbit | None, start: datetime | None, days: float) -> OrbitRanges | None:
    """Return the orbit planes during ``days`` from ``start``; None without an orbit."""
    if isinstance(orbit, TleOrbit):
        if start is None:
            raise BadInput("a TLE needs dates", expected="a start and a number of days", got="no start")
        return from_tle(orbit.text, start, days)
    return None if orbit is None else _drifted(orbit, start, days)


def _drifted(orbit: ElementsOrbit, start: datetime | None, days: float) -> OrbitRanges:
    """Return the limits of the first day, widened by the drift of the node until the last day. The perigee of an
    eccentric orbit drifts at the rate of the middle inclination."""
    first = from_elements(orbit.inclination_rad, orbit.raan_rad)
    if orbit.altitude_m is None:
        return first
    if start is None:
        raise BadInput("a drifting node needs dates", expected="a start and a number of days", got="no start")
    # The rate is a monotonic function of the inclination, so its extremes are at the limits of the inclination.
    seconds = days * SECONDS_PER_DAY
    shape = orbit.altitude_m, orbit.eccentricity
    low, high = sorted(node_rate_rad_s(i, *shape) * seconds for i in first.inclination_rad)
    raan = first.raan_rad[0] + min(0.0, low), first.raan_rad[1] + max(0.0, high)
    middle = (first.raan_rad[0] + first.raan_rad[1]) / 2
    ellipse = None
    if orbit.eccentricity > 0:
        drift = perigee_rate_rad_s(float(np.mean(first.inclination_rad)), *shape) * seconds
        ellipse = Ellipse(orbit.eccentricity, orbit.altitude_m, orbit.perigee_rad, orbit.perigee_rad + drift)
    return OrbitRanges(first.inclination_rad, raan, middle, middle + (low + high) / 2, ellipse)


def _envelope(
    request: BuildRequest,
    limits: AttitudeLimits | None,
    shape: FieldShape,
    planes: OrbitRanges | None,
    report: ShareReport | None,
) -> Envelope:
    if limits is None:
        if planes is None:
            return WholeSky(shape)
        raise BadInput("an orbit needs a pointing law with attitude limits", expected="a pointing law with its limits")
    if limits.pointing in ORBIT_LAWS:
        if planes is None:
            raise BadInput(
                f"pointing {limits.pointing} follows the orbit",
                expected="orbital elements or a TLE",
                got="no orbit",
                hint="omit the attitude limits for the whole sky",
            )
        if request.method in BLOCK_RULES:
            blocks = BlockEnvelope(shape, limits, planes, rule=BLOCK_RULES[request.method])
            return blocks if report is None else replace(blocks, report=report)
        return BandEnvelope(shape, limits, planes)
    if request.method in BLOCK_RULES:
        raise BadInput(
            "blocks need a pointing law that follows the orbit", expected=" | ".join(ORBIT_LAWS), got=limits.pointing
        )
    return _patch(request, shape, limits)


def _patch(request: BuildRequest, shape: FieldShape, limits: AttitudeLimits) -> PatchEnvelope:
    if limits.pointing not in SUN_LAWS:
        return PatchEnvelope(shape, limits)
    if request.start is None or request.end is None:
        raise BadInput(
            f"pointing {limits.pointing} follows the Sun and needs dates",
            expected="a start and a number of days",
            got="no start",
        )
    sun = sun_longitude_rad(jyear_of(request.start)), sun_longitude_rad(jyear_of(request.end))
    return PatchEnvelope(shape, limits, (sun[0], min(sun[1], sun[0] + 2 * np.pi)))


def _occulted(request: BuildRequest, base: Envelope, planes: OrbitRanges | None) -> Envelope:
    start = None if request.start is None else jyear_of(request.start)
    end = None if request.end is None else jyear_of(request.end)
    return OccultedEnvelope(base, request.occultation, planes, start, end)


def altitude_m(orbit: ElementsOrbit | TleOrbit | None, given_m: float | None) -> float | None:
    """Return ``given_m`` if it is set, otherwise the altitude of the TLE or the elements; None if it is unknown."""
    if given_m is not None:
        return given_m
    if isinstance(orbit, TleOrbit):
        return altitude_of_tle(orbit.text)
    return orbit.altitude_m if orbit is not None else None


def pole_of(planes: OrbitRanges | None) -> Array:
    """Return the (3,) ICRS pole of the middle plane."""
    if planes is None:
        raise BadInput("orbital aberration needs an orbit", expected="orbital elements or a TLE", got="no orbit")
    i, raan = float(np.mean(planes.inclination_rad)), float(np.mean(planes.raan_rad))
    return np.array([np.sin(raan) * np.sin(i), -np.cos(raan) * np.sin(i), np.cos(i)])


def orbital_velocity(attitude: AttitudeLimits | None, normal: Array, height_m: float | None) -> MeanOrbitVelocity:
    """Return the velocity for orbital aberration on a circular orbit, at the time each star crosses the middle of the
    field. An eccentric orbit has the velocity of a circle with its semi-major axis.

    ``normal``: (3,) ICRS pole of the orbit.
    """
    if height_m is None:
        raise BadInput("orbital aberration needs the orbit's altitude", expected="an altitude, or a TLE", got="neither")
    speed_km_s = float(np.sqrt(EARTH_MU_M3_S2 / (EARTH_RADIUS_M + height_m))) / 1000
    pole = (float(normal[0]), float(normal[1]), float(normal[2]))
    if attitude is None or attitude.pointing not in ORBIT_LAWS:
        return MeanOrbitVelocity(speed_km_s, pole)
    middle = euler_123((attitude.low + attitude.high) / 2)
    boresight = (attitude.cam_from_body @ middle)[2]
    return MeanOrbitVelocity(speed_km_s, pole, (float(boresight[0]), float(boresight[1]), float(boresight[2])))
