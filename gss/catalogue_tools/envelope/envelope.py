"""Envelopes: the part of the sky that is in the field of view for at least one orbit and one attitude within the
limits.

Three types share one interface (:class:`Envelope`): the whole sky; a band around the orbit normals for laws that rotate
with the orbit; a patch for laws that do not. Jacobs 1995 §5.2.1 steps through all combinations of six parameters and
marks 1° blocks. This module computes the membership of each star from the geometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.corrections.corrections import ICRS_FROM_ECLIPTIC
from gss.catalogue_tools.envelope.attitude import (
    BASE_FROM_SUN,
    SUN_LAWS,
    AttitudeLimits,
    base_from_icrs,
    euler_123,
    orbit_axes,
)
from gss.catalogue_tools.envelope.field import CircularField, FieldShape
from gss.catalogue_tools.envelope.moments import Moments
from gss.catalogue_tools.envelope.orbits import OrbitRanges, Range
from gss.catalogue_tools.envelope.reach import TOLERANCE_RAD, cosine_range, polar_interval, reachable
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion

EDGE_POINTS = 121
FIELD_POINTS = 24
PATCH_ATTITUDES = 300
# Parameter of the Beta distribution. At 0.15, half of the samples are within a hundredth of the range from one of its
# ends.
CROWDING = 0.15
WITNESSES = 3000
# A fifth of the smallest pixel of all profiles. A finer tolerance would take seconds if Sun and attitude move in the
# same direction.
PATCH_TOLERANCE_RAD = 5e-5
MAP_TOLERANCE_RAD = 5e-3
POLAR_BINS = 1440
PLANES_PER_BIN = 24
ECCENTRIC_FIELDS = 20_000


class Envelope(Protocol):
    """Interface of an envelope for the builder, the map and the quality report. Directions are ICRS unit vectors."""

    @property
    def shape(self) -> FieldShape: ...

    @property
    def dimensions(self) -> int:
        """Number of coordinates that define one moment; see :meth:`at`."""
        ...

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Return the (n,) mask of the (n, 3) directions that are in the field at some time."""
        ...

    def time_fraction(self, unit: Array) -> Array:
        """Return the (n,) fraction of time in the field, with every orbit, date and attitude within the limits equally
        likely."""
        ...

    def edges(self, at_end: bool) -> list[Array]:
        """Lines of (k, 3) directions: the border of the visible sky at the start or at the end of validity."""
        ...

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """Return (count, 3, 3) random cam_from_icrs within the limits."""
        ...

    def at(self, cube: Array) -> Moments:
        """Return the moments for (n, ``dimensions``) points of the unit cube. Each coordinate maps to one varying
        quantity.

        The first coordinate is the elapsed fraction of the validity. A uniform distribution over the cube is uniform
        over the limits.
        """
        ...


@dataclass(frozen=True)
class WholeSky:
    """No orbit and no attitude limits."""

    shape: FieldShape
    dimensions: ClassVar[int] = 4

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        return np.ones(len(unit), bool)

    def time_fraction(self, unit: Array) -> Array:
        return np.full(len(unit), self.shape.area_sr / (4 * np.pi))

    def edges(self, at_end: bool) -> list[Array]:
        return []

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        return np.asarray(matrix_from_quaternion(rng.normal(size=(count, 4))))

    def at(self, cube: Array) -> Moments:
        """Shoemake's uniform random rotations."""
        part, u, v, w = cube.T
        a, b = 2 * np.pi * v, 2 * np.pi * w
        near, far = np.sqrt(1 - u), np.sqrt(u)
        q = np.stack([near * np.sin(a), near * np.cos(a), far * np.sin(b), far * np.cos(b)], axis=-1)
        return Moments(matrix_from_quaternion(q), part)


@dataclass(frozen=True)
class BandEnvelope:
    """Envelope of a camera that rotates once per orbit, at every argument of latitude.

    An eccentric orbit has the same envelope as a circular one, because the base axes are nadir and orbit normal and all arguments
    of latitude occur. It differs in the fraction of time: the satellite is longer near apogee (Moniteq 1983 §2.5).
    """

    shape: FieldShape
    limits: AttitudeLimits
    orbit: OrbitRanges
    dimensions: ClassVar[int] = 6

    @cached_property
    def polar_interval(self) -> Range:
        """Interval of the components along the orbit's +y axis (against the orbit normal) of all visible directions."""
        return polar_interval(self.shape, self.limits.cam_from_body, self.limits.low, self.limits.high)

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Return the (n,) mask of the directions inside. A direction is inside if its components along +y over all
        planes overlap the interval that the camera covers."""
        lowest, highest = self.polar_interval
        smallest, largest = polar_range(self.orbit, unit)
        return np.asarray((largest >= lowest - TOLERANCE_RAD) & (smallest <= highest + TOLERANCE_RAD))

    def time_fraction(self, unit: Array) -> Array:
        rng = np.random.default_rng(0)
        if self.orbit.ellipse is not None:
            return self._sampled_fraction(unit, rng)
        return self.share_in_planes(unit, *self._planes(rng, PLANES_PER_BIN if np.ptp(self.orbit.raan_rad) > 0 else 1))

    def _sampled_fraction(self, unit: Array, rng: np.random.Generator) -> Array:
        """Return the (n,) fraction of time from random moments. Directions that are inside the envelope but in no sampled field
        get half of the smallest fraction."""
        u = np.asarray(unit, float)
        inside = np.flatnonzero(self.contains(u))
        share = np.zeros(len(u))
        counts = fields_per_star(u[inside], self.attitudes(rng, ECCENTRIC_FIELDS), self.shape)
        share[inside] = np.maximum(counts, 0.5) / ECCENTRIC_FIELDS
        return share

    def share_in_planes(self, unit: Array, raan_rad: Array, inclination_rad: Array) -> Array:
        """Return the (n,) fraction of time in the field over (k,) planes, for circular orbits. The planes can be outside the
        limits."""
        knots, share = self._share_by_angle
        flat = np.sin(inclination_rad)
        normal = np.stack([np.sin(raan_rad) * flat, -np.cos(raan_rad) * flat, np.cos(inclination_rad)])
        total = np.zeros(len(unit))
        for plane in normal.T:
            total += np.interp(np.arccos(np.clip(-(unit @ plane), -1, 1)), knots, share, left=0.0, right=0.0)
        return np.asarray(total / normal.shape[1])

    def edges(self, at_end: bool) -> list[Array]:
        raan = self.orbit.raan_end_rad if at_end else self.orbit.raan_start_rad
        axes = orbit_axes(np.array(raan), np.array(np.mean(self.orbit.inclination_rad)), np.array(0.0))
        turn = np.linspace(0, 2 * np.pi, EDGE_POINTS)
        lines = []
        for y in self.polar_interval:
            if abs(y) < 1 - 1e-12:
                flat = np.sqrt(1 - y * y)
                circle = np.stack([flat * np.cos(turn), np.full(EDGE_POINTS, y), flat * np.sin(turn)], axis=-1)
                lines.append(circle @ axes)
        return lines

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        raan = rng.uniform(*self.orbit.raan_rad, count)
        inclination = rng.uniform(*self.orbit.inclination_rad, count)
        turn = part = rng.uniform(0, 1, count)
        if self.orbit.ellipse is not None:  # node and perigee drift together
            part = rng.random(count)
            raan = self.orbit.raan_drifted(part, raan)
        latitude, _ = self.orbit.latitude_at(part, turn)
        body_from_orbit = euler_123(rng.uniform(self.limits.low, self.limits.high, (count, 3)))
        return np.asarray(self.limits.cam_from_body @ body_from_orbit @ orbit_axes(raan, inclination, latitude))

    def at(self, cube: Array) -> Moments:
        """See :meth:`Envelope.at`; node and perigee move uniformly from the start of validity to its end."""
        part, tilt = cube[:, 0], cube[:, 1]
        raan = self.orbit.raan_at(part)
        low, high = self.orbit.inclination_rad
        latitude, distance_m = self.orbit.latitude_at(part, cube[:, 2])
        axes = orbit_axes(raan, low + (high - low) * tilt, latitude)
        body_from_orbit = euler_123(self.limits.low + (self.limits.high - self.limits.low) * cube[:, 3:])
        return Moments(self.limits.cam_from_body @ body_from_orbit @ axes, part, axes[:, 2], distance_m)

    def _planes(self, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
        """Return ``count`` planes. Nodes are evenly spaced over their range; inclinations are random."""
        low, high = self.orbit.raan_rad
        return low + (high - low) * (np.arange(count) + 0.5) / count, rng.uniform(*self.orbit.inclination_rad, count)

    @cached_property
    def _share_by_angle(self) -> tuple[Array, Array]:
        """Fraction of an orbit for which a direction is in the field, by its angle from orbit +y, as (angles,
        fractions).

        The fraction is the solid angle of field and attitudes at that angle, divided by the solid angle of the ring of
        sky there. Sampled with seed 0.
        """
        rng = np.random.default_rng(0)
        across = _points_in(self.shape, rng, 4000)
        body_from_orbit = euler_123(rng.uniform(self.limits.low, self.limits.high, (250, 3)))
        y = (across @ self.limits.cam_from_body) @ body_from_orbit[:, :, 1].T
        lowest, highest = np.arccos(np.clip(self.polar_interval, -1, 1))
        bins = np.linspace(highest, lowest, max(12, int(POLAR_BINS * (lowest - highest) / np.pi)) + 1)
        count, _ = np.histogram(np.arccos(np.clip(y, -1, 1)), bins)
        ring_sr = 2 * np.pi * -np.diff(np.cos(bins))
        share = count / y.size * self.shape.area_sr / ring_sr
        middle = (bins[1:] + bins[:-1]) / 2
        return np.concatenate([[bins[0]], middle, [bins[-1]]]), np.concatenate([share[:1], share, share[-1:]])


@dataclass(frozen=True)
class PatchEnvelope:
    """Envelope of a camera whose base axes do not rotate with the orbit: inertial, or pointing towards or away from the
    Sun."""

    shape: FieldShape
    limits: AttitudeLimits
    sun_longitude_rad: Range = (0.0, 0.0)
    dimensions: ClassVar[int] = 4

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        return self._contains(np.asarray(unit, float), PATCH_TOLERANCE_RAD)

    def witnessed(self, unit: Array, fields: int) -> NDArray[np.bool_]:
        """Return the (n,) mask of the (n, 3) directions in one of ``fields`` sampled fields within the limits.

        The samples are concentrated at the ends of the limits, which determine the edge of the envelope.
        """
        return fields_per_star(unit, self.crowded(fields, CROWDING), self.shape) > 0

    def crowded(self, count: int, crowding: float) -> Array:
        """Return the (count, 3, 3) cam_from_icrs within the limits, drawn from a symmetric Beta distribution with
        parameter ``crowding`` along every axis."""
        along = np.random.default_rng(0).beta(crowding, crowding, (count, 4))
        sun = np.asarray(self.sun_longitude_rad, float)
        base = base_from_icrs(self.limits, sun[0] + (sun[1] - sun[0]) * along[:, 0])
        angles = self.limits.low + (self.limits.high - self.limits.low) * along[:, 1:]
        return np.asarray(self.limits.cam_from_body @ euler_123(angles) @ base)

    def _contains(self, u: Array, tolerance_rad: float) -> NDArray[np.bool_]:
        near = np.flatnonzero(self._near(u))
        result = np.zeros(len(u), bool)
        if self.limits.pointing in SUN_LAWS:
            # Directions in a sampled field need no search. A search is slow if Sun and attitude move in the same
            # direction.
            result[near] = self.witnessed(u[near], WITNESSES)
            near = near[~result[near]]
        if self.limits.pointing == "inertial":
            base = cam_from_icrs(self.limits.ra_rad, self.limits.dec_rad, self.limits.field_roll_rad)
            pivot, spin = u[near], np.zeros(2)
        else:
            base = BASE_FROM_SUN[self.limits.pointing]
            pivot, spin = u[near] @ ICRS_FROM_ECLIPTIC, np.asarray(self.sun_longitude_rad)
        low, high, mounting = self.limits.low, self.limits.high, self.limits.cam_from_body
        if high[2] - low[2] >= 2 * np.pi - 1e-9 and abs(mounting[2, 2]) > 1 - 1e-12:
            # If yaw covers a full turn about the boresight, the yaw axis is not searched.
            fixed = np.array([1.0, 1.0, 0.0])
            disc = CircularField(self.shape.half_diagonal_rad)
            result[near] = reachable(pivot, base, spin, disc, mounting, low * fixed, high * fixed, tolerance_rad)
        else:
            result[near] = reachable(pivot, base, spin, self.shape, mounting, low, high, tolerance_rad)
        return result

    def time_fraction(self, unit: Array) -> Array:
        u = np.asarray(unit, float)
        near = np.flatnonzero(self._near(u))
        share = np.zeros(len(u))
        for attitude in self.attitudes(np.random.default_rng(0), PATCH_ATTITUDES):
            share[near] += self.shape.inside(u[near] @ attitude.T)
        share /= PATCH_ATTITUDES
        # Directions that are inside the envelope but in no sampled field get half of the smallest fraction.
        rare = near[share[near] == 0]
        share[rare[self._contains(u[rare], MAP_TOLERANCE_RAD)]] = 0.5 / PATCH_ATTITUDES
        return share

    def edges(self, at_end: bool) -> list[Array]:
        sun = self.sun_longitude_rad[1 if at_end else 0]
        base = base_from_icrs(self.limits, np.array([sun]))[0]
        middle = euler_123((self.limits.low + self.limits.high) / 2)
        return [field_outline(self.shape, self.limits.cam_from_body @ middle @ base)]

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        base = base_from_icrs(self.limits, rng.uniform(*self.sun_longitude_rad, count))
        body_from_base = euler_123(rng.uniform(self.limits.low, self.limits.high, (count, 3)))
        return np.asarray(self.limits.cam_from_body @ body_from_base @ base)

    def at(self, cube: Array) -> Moments:
        """See :meth:`Envelope.at`; the Sun moves uniformly along the ecliptic."""
        sun = self.sun_longitude_rad[0] + np.ptp(self.sun_longitude_rad) * cube[:, 0]
        body_from_base = euler_123(self.limits.low + (self.limits.high - self.limits.low) * cube[:, 1:])
        return Moments(self.limits.cam_from_body @ body_from_base @ base_from_icrs(self.limits, sun), cube[:, 0])

    def _near(self, unit: Array) -> NDArray[np.bool_]:
        """Return the mask of directions that can be in the field, by their angle from the middle boresight. This is a
        fast pre-selection."""
        sun = np.array([np.mean(self.sun_longitude_rad)])
        middle = euler_123((self.limits.low + self.limits.high) / 2) @ base_from_icrs(self.limits, sun)[0]
        boresight = (self.limits.cam_from_body @ middle)[2]
        turn = float(np.sum(self.limits.high - self.limits.low) + np.ptp(self.sun_longitude_rad)) / 2
        reach_rad = self.shape.half_diagonal_rad + turn
        return np.asarray(unit @ boresight >= np.cos(reach_rad)) if reach_rad < np.pi else np.ones(len(unit), bool)


def polar_range(orbit: OrbitRanges, unit: Array) -> tuple[Array, Array]:
    """Return the (n,) smallest and largest component along orbit +y of (n, 3) directions over all planes.

    The component is −(sin i·ρ·sin(Ω − α) + cos i·z). Its extremes over Ω, and then over i, have closed forms.
    """
    u = np.asarray(unit, float)
    z, rho, alpha = u[:, 2], np.hypot(u[:, 0], u[:, 1]), np.arctan2(u[:, 1], u[:, 0])
    across = cosine_range(rho, alpha + np.pi / 2, *orbit.raan_rad)
    low, high = (cosine_range(np.hypot(a, z), np.arctan2(a, z), *orbit.inclination_rad) for a in across)
    return -high[1], -low[0]


def field_outline(shape: FieldShape, cam_from_icrs: Array) -> Array:
    """Return (k, 3) ICRS directions of the closed outline of one field."""
    return np.asarray(shape.edge(np.linspace(0, 4, FIELD_POINTS * 4 + 1)) @ cam_from_icrs)


def _points_in(shape: FieldShape, rng: np.random.Generator, count: int) -> Array:
    """Return at most 2·``count`` camera-frame directions, (k, 3), uniform over the field's solid angle."""
    low = np.cos(shape.half_diagonal_rad)
    share = shape.area_sr / (2 * np.pi * (1 - low))
    tries = int(count / share)
    z, turn = rng.uniform(low, 1, tries), rng.uniform(0, 2 * np.pi, tries)
    flat = np.sqrt(1 - z * z)
    unit = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
    return unit[shape.inside(unit)]
