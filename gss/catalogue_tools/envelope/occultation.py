"""Envelope minus the sky hidden by Earth, Sun and Moon (Jacobs 1995 §7.6, Moniteq 1983 §2.3).

A star is visible if its line of sight passes the Earth's limb by the margin. A field is usable if its boresight also
passes the limb by the margin and keeps the baffle's angles to Sun and Moon. Eclipses are ignored: the Sun's keep-out
angle also applies in the Earth's shadow, which is conservative. The directions of Sun and Moon are those from the
Earth's centre (from a low orbit the Moon appears up to 1.1° away; add this to the Moon's angle).

On an eccentric orbit the Earth's disc has the size of each moment. Only the membership of stars uses the disc at apogee,
the smallest one, so that no visible star is missing while the perigee drifts (Moniteq 1983 §2.5).

For a camera that rotates with the orbit, the sky hidden by the Earth is exact to ``hidden_bands.END_RAD``. For other
laws, the Earth hides a direction permanently only if limb and margin exceed 90°. In this case boresight and star are
tested separately. Sun and Moon are sampled, with a bias of ``baffle_search.NEAR_RAD`` towards visibility, at dates a
degree of solar or node motion apart. Fractions of time are computed over random times, with the node moving uniformly
over the validity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.design.baffle_search import (
    EPOCH_RAD,
    MOON_STEP_DAYS,
    VIEWS_PER_STAR,
    AvoidanceAngles,
    free_of_baffle,
)
from gss.catalogue_tools.envelope.attitude import AttitudeLimits, orbit_axes
from gss.catalogue_tools.envelope.ellipse import EARTH_RADIUS_M, MIN_ORBIT_M, Ellipse
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope, polar_range
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.hidden_bands import ROUNDS, seen_bands
from gss.catalogue_tools.envelope.moments import Moments, joined
from gss.catalogue_tools.envelope.orbits import OrbitRanges, altitude_of_tle
from gss.catalogue_tools.envelope.reach import TOLERANCE_RAD
from gss.catalogue_tools.envelope.views import Views, views_of
from gss.catalogue_tools.selection.counting import Shadow, fields_per_star
from gss.domain.angles import Array
from gss.domain.errors import BadInput

__all__ = ["Blinded", "Occultation", "OccultedEnvelope", "altitude_of_tle"]

# Number of random fields. Nearly all visible stars are in one of these fields and need no search.
WITNESSES = 4096
SAMPLE = 20_000
HITS_PER_DIRECTION = 100
HOPELESS_DRAWS, DRAWS_PER_FIELD = 100_000, 5000


@dataclass(frozen=True)
class Occultation:
    """Bodies that hide the sky.

    ``altitude_m`` None: the Earth is ignored. ``earth_margin_rad``: margin beyond the limb. ``sun_rad``, ``moon_rad``:
    smallest permitted angle from the boresight, defined by the baffle (28.1° for Sunsat, Jacobs 1995 eq. 7.26); 0
    disables the body.
    """

    altitude_m: float | None = None
    earth_margin_rad: float = 0.0
    sun_rad: float = 0.0
    moon_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.altitude_m is not None and not MIN_ORBIT_M <= self.altitude_m < np.inf:
            raise BadInput(
                "the altitude is too low for an orbit",
                expected=f"{MIN_ORBIT_M / 1e3:g} km or more",
                got=f"{self.altitude_m / 1e3:g} km",
            )
        for name in ("earth_margin", "sun", "moon"):
            value = getattr(self, f"{name}_rad")
            if not 0 <= value < np.pi:
                raise BadInput(
                    f"{name.replace('_', ' ')} angle is out of range",
                    expected="0° to 180°",
                    got=f"{np.degrees(value):g}°",
                )
        if self.earth_rad >= np.pi:
            raise BadInput(
                "the Earth's disc and margin cover the whole sky",
                expected="less than 180° together",
                hint="use a smaller margin",
            )

    @property
    def earth_rad(self) -> float:
        """Angle from nadir to limb plus margin at the altitude; 0 if the Earth is ignored."""
        if self.altitude_m is None:
            return 0.0
        return self.smallest_rad(None)

    def earth_at_rad(self, distance_m: Array) -> Array:
        """Return the (n,) angles from nadir to limb plus margin at (n,) distances from the Earth's centre."""
        return np.asarray(np.arcsin(np.minimum(1.0, EARTH_RADIUS_M / distance_m)) + self.earth_margin_rad)

    def smallest_rad(self, ellipse: Ellipse | None) -> float:
        """Return the smallest angle from nadir to limb plus margin on an orbit; 0 if the Earth is ignored."""
        if self.altitude_m is None:
            return 0.0
        altitude_m = self.altitude_m if ellipse is None else ellipse.apogee_altitude_m
        return float(self.earth_at_rad(np.array(EARTH_RADIUS_M + altitude_m)))

    @property
    def baffled(self) -> bool:
        """True if Sun or Moon are included."""
        return self.sun_rad > 0 or self.moon_rad > 0

    @property
    def active(self) -> bool:
        """True if any body is included."""
        return self.baffled or self.altitude_m is not None


@dataclass(frozen=True)
class SamplingEffort:
    """Sampling effort: number of random fields, moments for the fractions of time, rounds of the search for the ends of
    a band, views and dates for the effect of Sun and Moon."""

    witnesses: int
    moments: int
    rounds: int
    views: int
    epoch_rad: float
    moon_step_days: float


THOROUGH = SamplingEffort(WITNESSES, SAMPLE, ROUNDS, VIEWS_PER_STAR, EPOCH_RAD, MOON_STEP_DAYS)
# For interactive previews.
QUICK = SamplingEffort(1024, 4000, 5, 48, 2 * EPOCH_RAD, 4 * MOON_STEP_DAYS)


@dataclass(frozen=True)
class Blinded:
    """Fractions of time for which the boresight is too close to each body, and to any body (``total``), from ``SAMPLE``
    moments."""

    earth: float
    sun: float
    moon: float
    total: float


@dataclass(frozen=True)
class OccultedEnvelope:
    """An envelope minus the directions hidden by Earth, Sun and Moon.

    ``orbit``: orbit for laws that do not define the Earth's direction; None: any direction is possible.
    ``start_jyear``, ``end_jyear``: limits of the validity, required for Sun and Moon. ``effort``: sampling effort.
    """

    base: Envelope
    occultation: Occultation
    orbit: OrbitRanges | None = None
    start_jyear: float | None = None
    end_jyear: float | None = None
    effort: SamplingEffort = THOROUGH

    def __post_init__(self) -> None:
        if self.occultation.baffled:
            _ = self.baffle

    @cached_property
    def baffle(self) -> AvoidanceAngles:
        """Directions of Sun and Moon over the validity. Raises BadInput without dates."""
        if self.start_jyear is None or self.end_jyear is None:
            raise BadInput("Sun and Moon need dates", expected="a start and a number of days", got="no dates")
        angles, steps = (
            (self.occultation.sun_rad, self.occultation.moon_rad),
            (self.effort.epoch_rad, self.effort.moon_step_days),
        )
        return AvoidanceAngles(*angles, self.start_jyear, self.end_jyear, *steps)

    @property
    def shape(self) -> FieldShape:
        """Field of view of the envelope."""
        return self.base.shape

    @property
    def dimensions(self) -> int:
        """Dimensions of the base envelope, plus two for the direction of the Earth if the law does not define it."""
        return self.base.dimensions + (0 if isinstance(self.base, BandEnvelope) else 2)

    def edges(self, at_end: bool) -> list[Array]:
        """Border of the base envelope, without occultation."""
        return self.base.edges(at_end)

    def at(self, cube: Array) -> Moments:
        """Moments of the base envelope, with the direction of the Earth."""
        moments = self.base.at(cube[:, : self.base.dimensions])
        return moments if moments.nadir is not None else self._with_nadir(moments, cube[:, -2:])

    def usable(self, moments: Moments) -> NDArray[np.bool_]:
        """Return the (n,) mask of the moments whose field is not blinded."""
        return np.asarray(~np.logical_or.reduce(self._blinding(moments)))

    def shadow(self, moments: Moments) -> Shadow | None:
        """Region hidden by the Earth at these moments; None without an Earth."""
        if self.occultation.altitude_m is None or moments.nadir is None:
            return None
        return Shadow(moments.nadir, self._earth_rad(moments))

    def usable_moments(self, rng: np.random.Generator, count: int) -> Moments:
        """Return ``count`` random usable moments. Raises BadInput if all or nearly all fields are blinded."""
        batches: list[Moments] = []
        drawn = usable = 0
        draw = min(max(2 * count, 1000), HOPELESS_DRAWS)
        while usable < count:
            if drawn >= HOPELESS_DRAWS and drawn > DRAWS_PER_FIELD * usable:
                raise BadInput(
                    "every field is blinded by Earth, Sun or Moon",
                    expected="some usable fields",
                    got=f"{usable} of {drawn} tried",
                    hint="use smaller baffle angles or margin, other dates or another pointing",
                )
            moments = self.at(rng.random((draw, self.dimensions)))
            good = np.flatnonzero(self.usable(moments))
            batches.append(moments.take(good))
            drawn, usable = drawn + draw, usable + len(good)
        return joined(batches).take(np.arange(count))

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """Return (count, 3, 3) random usable cam_from_icrs."""
        return self.usable_moments(rng, count).cam_from_icrs

    @cached_property
    def blinded(self) -> Blinded:
        """Fractions of time lost to each body."""
        earth, sun, moon = self._blinding(self.at(np.random.default_rng(0).random((SAMPLE, self.dimensions))))
        return Blinded(*(float(np.mean(b)) for b in (earth, sun, moon, earth | sun | moon)))

    def time_fraction(self, unit: Array) -> Array:
        """Return the (n,) fraction of time in a usable field and clear of the Earth. The fraction is sampled; see
        HITS_PER_DIRECTION."""
        u = np.asarray(unit, float)
        # Only a band has a fast membership test. For other envelopes, each field is compared only with nearby
        # directions.
        band = isinstance(self.base, BandEnvelope)
        possible = np.flatnonzero(self.base.contains(u)) if band else np.arange(len(u))
        per_field = max(1.0, len(u) * self.base.shape.area_sr / (4 * np.pi))
        count = int(np.clip(HITS_PER_DIRECTION * len(possible) / per_field, 1000, self.effort.moments))
        moments = self.at(np.random.default_rng(0).random((count, self.dimensions)))
        good = moments.take(np.flatnonzero(self.usable(moments)))
        share = np.zeros(len(u))
        counts = fields_per_star(u[possible], good.cam_from_icrs, self.base.shape, self.shadow(good))
        share[possible] = counts / count
        return share

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Return the (n,) mask of the (n, 3) directions that are visible in a usable field at some time."""
        u = np.asarray(unit, float)
        visible = self.base.contains(u)
        visible[visible] = self._clear_of_earth(u[visible])
        if not self.occultation.baffled or not visible.any():
            return visible
        doubtful = np.flatnonzero(visible)
        doubtful = doubtful[~self._witnessed(u[doubtful])]
        visible[doubtful] = free_of_baffle(
            self.base, u[doubtful], self.baffle, self._views, self._smallest_rad, self.effort.views
        )
        return visible

    def _clear_of_earth(self, u: Array) -> NDArray[np.bool_]:
        earth_rad = self._smallest_rad
        if isinstance(self.base, BandEnvelope):
            smallest, largest = polar_range(self.base.orbit, u)
            return np.asarray(
                np.logical_or.reduce(
                    [np.zeros(len(u), bool)] + [(largest >= a) & (smallest <= b) for a, b in self._bands]
                )
            )
        if earth_rad <= np.pi / 2 or self.orbit is None:
            # In every orbit there is a time at which the Earth is behind the camera.
            return np.ones(len(u), bool)
        smallest, largest = polar_range(self.orbit, u)
        height = np.where((smallest <= 0) & (largest >= 0), 0.0, np.minimum(np.abs(smallest), np.abs(largest)))
        return np.asarray(height <= np.sin(earth_rad) + TOLERANCE_RAD)

    @cached_property
    def _views(self) -> Views:
        limits = getattr(self.base, "limits", None) or AttitudeLimits("inertial")
        return views_of(self.base.shape, limits)

    @cached_property
    def _bands(self) -> list[tuple[float, float]]:
        return (
            seen_bands(self.base, self._views, self._smallest_rad, self.effort.rounds)
            if isinstance(self.base, BandEnvelope)
            else []
        )

    def _witnessed(self, u: Array) -> NDArray[np.bool_]:
        moments = self.at(np.random.default_rng(1).random((self.effort.witnesses, self.dimensions)))
        good = moments.take(np.flatnonzero(self.usable(moments)))
        return fields_per_star(u, good.cam_from_icrs, self.base.shape, self.shadow(good)) > 0

    def _blinding(self, moments: Moments) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        boresight, o = moments.cam_from_icrs[:, 2], self.occultation
        none = np.zeros(len(boresight), bool)
        earth = sun_near = moon_near = none
        if o.altitude_m is not None and moments.nadir is not None:
            earth = (boresight * moments.nadir).sum(axis=1) > np.cos(self._earth_rad(moments))
        if o.baffled:
            sun, moon = self.baffle.bodies(moments.part)
            if o.sun_rad:
                sun_near = (boresight * sun).sum(axis=1) > np.cos(o.sun_rad)
            if o.moon_rad:
                moon_near = (boresight * moon).sum(axis=1) > np.cos(o.moon_rad)
        return earth, sun_near, moon_near

    @property
    def _smallest_rad(self) -> float:
        """Smallest angle from nadir to limb plus margin during the validity."""
        orbit = self.base.orbit if isinstance(self.base, BandEnvelope) else self.orbit
        return self.occultation.smallest_rad(None if orbit is None else orbit.ellipse)

    def _earth_rad(self, moments: Moments) -> Array | float:
        """Return the (n,) or common angle from nadir to limb plus margin."""
        if moments.distance_m is None:
            return self.occultation.earth_rad
        return self.occultation.earth_at_rad(moments.distance_m)

    def _with_nadir(self, moments: Moments, place: Array) -> Moments:
        """Return the moments with (n, 3) directions to the Earth for (n, 2) points of the unit square: along the orbit, or over
        the whole sphere without an orbit."""
        if self.orbit is None:
            turn, z = 2 * np.pi * place[:, 0], 2 * place[:, 1] - 1
            flat = np.sqrt(1 - z * z)
            return replace(moments, nadir=np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1))
        low, high = self.orbit.inclination_rad
        latitude, distance_m = self.orbit.latitude_at(moments.part, place[:, 0])
        axes = orbit_axes(self.orbit.raan_at(moments.part), low + (high - low) * place[:, 1], latitude)
        return replace(moments, nadir=axes[:, 2], distance_m=distance_m)
