"""Keep-out angles of Sun and Moon: directions of both bodies over the validity, and the sky that is visible in fields
far enough from both."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import erfa  # type: ignore[import-untyped]  # the package has no types
import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.corrections.corrections import DAYS_PER_YEAR, J2000_JYEAR
from gss.catalogue_tools.envelope.attitude import SUN_LAWS, base_from_icrs, orbit_axes
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope, PatchEnvelope
from gss.catalogue_tools.envelope.field import FieldShape, widened
from gss.catalogue_tools.envelope.views import Views, cams_within
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array

J2000_JD = 2451545.0
# Motion of the Sun or the node between two sampled dates, and time between two sampled dates if the Moon is included.
EPOCH_RAD = float(np.radians(1.0))
MOON_STEP_DAYS = 0.25
MAX_EPOCHS, MAX_KNOTS = 180, 1500
NEAR_RAD, PATCH_NEAR_RAD = float(np.radians(0.25)), float(np.radians(0.75))
VIEWS_PER_STAR = 256
PATCH_ATTITUDES = 2048
RINGS, RING_POINTS = 5, 48


@dataclass(frozen=True)
class AvoidanceAngles:
    """Smallest permitted angles from the boresight to Sun and Moon (0: disabled), from ``start_jyear`` to
    ``end_jyear``.

    Directions are those from the Earth's centre. From a low orbit, the Moon appears up to 1.1° away from this
    direction. ``epoch_rad``: motion of the Sun or the node between sampled dates. ``moon_step_days``: time between
    sampled dates if the Moon is included.
    """

    sun_rad: float
    moon_rad: float
    start_jyear: float
    end_jyear: float
    epoch_rad: float = EPOCH_RAD
    moon_step_days: float = MOON_STEP_DAYS

    def bodies(self, part: Array) -> tuple[Array, Array]:
        """Return the (n, 3) ICRS directions of Sun and Moon after (n,) fractions of the validity."""
        knots, sun, moon = self._track
        directions = [np.stack([np.interp(part, knots, axis) for axis in body.T], axis=-1) for body in (sun, moon)]
        sun, moon = (body / np.linalg.norm(body, axis=-1, keepdims=True) for body in directions)
        return sun, moon

    @cached_property
    def _track(self) -> tuple[Array, Array, Array]:
        """Directions of Sun and Moon over the validity, sampled densely enough for linear interpolation to one
        arcminute."""
        days = (self.end_jyear - self.start_jyear) * DAYS_PER_YEAR
        knots = np.linspace(0, 1, int(np.clip(np.ceil(days / MOON_STEP_DAYS), 1, MAX_KNOTS)) + 1)
        at = (self.start_jyear - J2000_JYEAR) * DAYS_PER_YEAR + days * knots
        sun = -np.asarray(erfa.epv00(J2000_JD, at)[0]["p"])
        moon = np.asarray(erfa.moon98(J2000_JD, at)["p"])
        return (
            knots,
            sun / np.linalg.norm(sun, axis=1, keepdims=True),
            moon / np.linalg.norm(moon, axis=1, keepdims=True),
        )

    def clearance(self, boresight: Array, sun: Array, moon: Array) -> Array:
        """Return the (…,) margins in radians by which (…, 3) boresights keep the angles to Sun and Moon, the smaller of
        the two. A negative margin means that the camera is blinded."""
        clear = np.full(np.broadcast_shapes(boresight.shape, sun.shape)[:-1], np.inf)
        for angle, body in ((self.sun_rad, sun), (self.moon_rad, moon)):
            if angle > 0:
                clear = np.minimum(clear, np.arccos(np.clip((boresight * body).sum(axis=-1), -1, 1)) - angle)
        return clear

    def parts(self, node_motion_rad: float, finer: float = 1.0) -> Array:
        """Return the fractions of the validity to sample, for a node that moves by ``node_motion_rad``. ``finer``:
        factor for the number of samples."""
        days = (self.end_jyear - self.start_jyear) * DAYS_PER_YEAR
        steps = max(2 * np.pi * days / DAYS_PER_YEAR, node_motion_rad) / self.epoch_rad * finer
        if self.moon_rad:
            steps = max(steps, days / self.moon_step_days)
        return np.linspace(0, 1, int(np.clip(np.ceil(steps), 1, MAX_EPOCHS - 1)) + 1)


def free_of_baffle(
    base: Envelope,
    unit: Array,
    baffle: AvoidanceAngles,
    views: Views,
    earth_rad: float,
    views_per_star: int = VIEWS_PER_STAR,
) -> NDArray[np.bool_]:
    """Return the (n,) mask of the (n, 3) directions that are visible in some field whose boresight is far enough from
    Sun and Moon.

    All directions must be within ``base`` and not permanently behind the Earth. The test is biased towards visibility:
    a direction is also accepted if it is within ``NEAR_RAD`` of a direction in a clear field. For laws that do not
    rotate with the orbit, this tolerance is ``PATCH_NEAR_RAD``.
    """
    if isinstance(base, PatchEnvelope):
        return _free_in_patch(base, unit, baffle)
    if isinstance(base, BandEnvelope):
        return _free_in_band(base, unit, baffle, views, earth_rad, views_per_star)
    return _free_in_sky(base, unit, baffle)


def _free_in_patch(base: PatchEnvelope, u: Array, baffle: AvoidanceAngles) -> NDArray[np.bool_]:
    shape = FieldShape(widened(base.shape.camera, PATCH_NEAR_RAD))
    cams = cams_within(base.limits, PATCH_ATTITUDES, 0)
    parts = baffle.parts(0.0, 2.0)
    sun, moon = baffle.bodies(parts)
    free = np.zeros(len(u), bool)
    if base.limits.pointing not in SUN_LAWS:
        fields = cams @ base_from_icrs(base.limits, np.zeros(1))
        clear = (baffle.clearance(fields[:, None, 2], sun, moon) >= -PATCH_NEAR_RAD).any(axis=1)
        return np.asarray(fields_per_star(u, fields[clear], shape) > 0)
    low, high = base.sun_longitude_rad
    for k, axes in enumerate(base_from_icrs(base.limits, low + (high - low) * parts)):
        fields = cams @ axes
        fields = fields[baffle.clearance(fields[:, 2], sun[k], moon[k]) >= -PATCH_NEAR_RAD]
        blocked = np.flatnonzero(~free)
        free[blocked] = fields_per_star(u[blocked], fields, shape) > 0
    return free


def _free_in_band(
    base: BandEnvelope, u: Array, baffle: AvoidanceAngles, views: Views, earth_rad: float, views_per_star: int
) -> NDArray[np.bool_]:
    """Test the orbit plane at each date. Views at the star's angle from the orbit's axis are rotated along the orbit
    until they contain the star; their boresight is then tested."""
    if earth_rad > 0:
        limit = np.cos(earth_rad)
        views = views.take((views.direction[:, 2] <= limit) & (views.boresight[:, 2] <= limit))
    views = views.take(np.argsort(views.from_y_rad))
    angles = views.from_y_rad
    x, _, z = views.direction.T
    flat = np.maximum(np.hypot(x, z), 1e-12)
    along = (views.boresight[:, 0] * x + views.boresight[:, 2] * z) / flat
    aside = (views.boresight[:, 0] * z - views.boresight[:, 2] * x) / flat
    parts = baffle.parts(abs(base.orbit.raan_end_rad - base.orbit.raan_start_rad))
    sun, moon = baffle.bodies(parts)
    free = np.zeros(len(u), bool)
    for inclination in np.unique([*base.orbit.inclination_rad, np.mean(base.orbit.inclination_rad)]):
        for k, raan in enumerate(base.orbit.raan_at(parts)):
            blocked = np.flatnonzero(~free)
            # If the direction is far inside a keep-out zone, every field that contains it is blinded.
            blocked = blocked[baffle.clearance(u[blocked], sun[k], moon[k]) >= -base.shape.half_diagonal_rad]
            axes = orbit_axes(np.array(raan), inclination, np.array(0.0))
            star = u[blocked] @ axes.T
            pick, real = _near(angles, np.arccos(np.clip(star[:, 1], -1, 1)), views_per_star)
            out = np.hypot(star[:, 0], star[:, 2])[:, None]
            sx, sz = (star[:, k, None] / np.maximum(out, 1e-12) for k in (0, 2))
            boresight = np.stack(
                [along[pick] * sx + aside[pick] * sz, views.boresight[pick, 1], along[pick] * sz - aside[pick] * sx],
                axis=-1,
            )
            clear = baffle.clearance(boresight, axes @ sun[k], axes @ moon[k]) >= 0
            free[blocked] = (clear & real).any(axis=1)
    return free


def _near(angles: Array, targets: Array, count: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return (n, ``count``) indices into the ascending ``angles``, spread over the angles within NEAR_RAD of each
    target, and a mask of the same shape that is False for targets without such an angle."""
    low, high = np.searchsorted(angles, targets - NEAR_RAD), np.searchsorted(angles, targets + NEAR_RAD)
    share = (np.arange(count) + 0.5) / count
    pick = (low[:, None] + share * (high - low)[:, None]).astype(np.intp)
    return np.minimum(pick, len(angles) - 1), np.broadcast_to((high > low)[:, None], pick.shape)


def _free_in_sky(base: Envelope, u: Array, baffle: AvoidanceAngles) -> NDArray[np.bool_]:
    """Test boresights on rings around each direction, out to the half diagonal of the field."""
    sun, moon = baffle.bodies(baffle.parts(0.0))
    east = np.cross(u, np.where(np.abs(u[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    north = np.cross(u, east)
    free = np.zeros(len(u), bool)
    hopeless = (baffle.clearance(u[:, None], sun, moon) < -base.shape.half_diagonal_rad).all(axis=1)
    for radius in np.linspace(0, base.shape.half_diagonal_rad, RINGS):
        for turn in np.linspace(0, 2 * np.pi, RING_POINTS, endpoint=False):
            undecided = np.flatnonzero(~free & ~hopeless)
            side = np.cos(turn) * east[undecided] + np.sin(turn) * north[undecided]
            boresight = np.cos(radius) * u[undecided] + np.sin(radius) * side
            free[undecided] = (baffle.clearance(boresight[:, None], sun, moon) >= 0).any(axis=1)
    return free
