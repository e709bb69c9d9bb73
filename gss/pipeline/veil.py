"""Diffuse light: stray light of bright bodies over the whole detector, and occultation by the Earth.

Diffuse light varies slowly over the field, so it is computed on a coarse grid of directions and interpolated
bilinearly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.sensor import Baffle, Sensor

Map = NDArray[np.float32]

GRID_STEP_PX = 8
# Exponent of the decrease outside the limit angle, fitted to Moniteq 1983 Table 5.3, 21° to 58°.
OUTSIDE_POWER = 1.3
# Ratio of the stray light of the Earth to that of the Sun at the same angle (Moniteq 1983 Table 5.3).
EARTH_SHARE = 0.3
# Share of a star's light that the lens scatters per steradian at 1°. The share decreases with the square of the angle.
# The total is about one per cent. This value is an assumption.
SCATTER_PER_SR = 1.0
SCATTER_CORE_RAD = float(np.radians(0.3))
EARTH_ALBEDO = 0.3
SUN_V_MAG = -26.74
# Airglow of 21.5 mag per square arcsecond.
NIGHT_EARTH_V_SR = -5.0
BLIND_E_S = 1e9
STEEPEST = 20.0
# Angle across the field over which stray light increases by a factor of e towards its source. This value is an
# assumption.
SLOPE_RAD = float(np.radians(15.0))


@dataclass(frozen=True)
class Veil:
    """(rows, columns) electrons per second of diffuse light; ``blocked``: mask of pixels where the Earth hides the sky, or None."""

    e_s: Map
    blocked: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Grid:
    """Coarse directions (r, c, 3) in the camera frame and the (rows, r), (c, columns) interpolation weights."""

    unit_cam: Array
    down: Map
    across: Map

    def spread(self, coarse: Array) -> Map:
        """Interpolate an (r, c) map to (rows, columns)."""
        return np.asarray(self.down @ np.asarray(coarse, np.float32) @ self.across)


@lru_cache(maxsize=8)
def grid_of(camera: Camera) -> Grid:
    """Return the coarse grid of a camera."""
    cols = np.linspace(0, camera.columns - 1, max(2, camera.columns // GRID_STEP_PX))
    rows = np.linspace(0, camera.rows - 1, max(2, camera.rows // GRID_STEP_PX))
    positions = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
    unit = camera.unproject(positions).reshape(len(rows), len(cols), 3)
    return Grid(unit, _weights(rows, camera.rows), _weights(cols, camera.columns).T.copy())


def _weights(nodes: Array, count: int) -> Map:
    """Return the (count, nodes) weights of a linear interpolation between ``nodes`` at 0 … count − 1."""
    position = np.arange(count) / (nodes[1] - nodes[0])
    first = np.minimum(position.astype(np.intp), len(nodes) - 2)
    weights = np.zeros((count, len(nodes)), np.float32)
    weights[np.arange(count), first] = 1 - (position - first)
    weights[np.arange(count), first + 1] = position - first
    return weights


def sun_stray(camera: Camera, baffle: Baffle, sun_cam: Array) -> Map:
    """Return the stray light of the Sun in direction ``sun_cam`` (3,), in e/s; ``BLIND_E_S`` everywhere if the Sun
    shines on the lens."""
    angle_rad = np.arccos(np.clip(sun_cam[2], -1, 1))
    if angle_rad < baffle.blind_rad:
        return np.full((camera.rows, camera.columns), BLIND_E_S, np.float32)
    return stray(camera, baffle, sun_cam, 0.0, baffle.sun_limit_rad, baffle.reference_e_s)


def earth_stray(camera: Camera, baffle: Baffle, nadir_cam: Array, earth_rad: float, lit: float) -> Map:
    """Return the stray light, in e/s, of an Earth with angular radius ``earth_rad`` and sunlit share ``lit``."""
    return stray(camera, baffle, nadir_cam, earth_rad, baffle.earth_limit_rad, EARTH_SHARE * lit * baffle.reference_e_s)


def stray(
    camera: Camera, baffle: Baffle, to_cam: Array, radius_rad: float, limit_rad: float, at_limit_e_s: float
) -> Map:
    """Return the stray light of a body in e/s. It depends on the angle between the boresight and the limb of the body.

    The baffle determines how much light reaches the lens. The lens scatters this light over the field with a gentle
    gradient.
    """
    grid = grid_of(camera)
    off_axis_rad = float(np.arccos(np.clip(to_cam[2], -1, 1)))
    angle_rad = off_axis_rad - radius_rad
    if angle_rad < limit_rad:
        level_e_s = at_limit_e_s * float(np.exp(min((limit_rad - angle_rad) / baffle.decay_rad, STEEPEST)))
    else:
        level_e_s = at_limit_e_s * (limit_rad / angle_rad) ** OUTSIDE_POWER
    nearer_rad = off_axis_rad - np.arccos(np.clip(grid.unit_cam @ to_cam, -1, 1))
    return grid.spread(level_e_s * np.exp(nearer_rad / SLOPE_RAD))


def halo(camera: Camera, sensor: Sensor, to_cam: Array, v_mag: float, margin_rad: float) -> Map:
    """Return the light that the lens scatters from a bright body in or near the field, in e/s. If the body is outside
    the field, the light decreases by e⁻³ over ``margin_rad``."""
    grid = grid_of(camera)
    outside_rad = max(0.0, float(np.arccos(np.clip(to_cam[2], -1, 1))) - camera.half_diagonal_rad)
    angle2 = 2 * (1 - grid.unit_cam @ to_cam)
    per_sr = SCATTER_PER_SR * np.radians(1.0) ** 2 / (angle2 + SCATTER_CORE_RAD**2)
    body_e_s = float(sensor.star_e(v_mag, 1.0)) * np.exp(-3 * outside_rad / margin_rad)
    return grid.spread(body_e_s * camera.pixel_rad**2 * per_sr)


def earth_disc(
    camera: Camera, sensor: Sensor, nadir_cam: Array, earth_rad: float, sun_cam: Array
) -> tuple[NDArray[np.bool_], Map]:
    """Return the mask of pixels that see the Earth and the Earth's light in these pixels, in e/s. The model is a
    Lambertian surface of albedo 0.3 in sunlight, and a faint glow at night.

    The observer is at distance R/sin(earth_rad) from the Earth's centre. The terminator is that of a sphere without
    atmosphere.
    """
    grid = grid_of(camera)
    along = grid.unit_cam @ nadir_cam
    on_disc = grid.spread(np.arccos(np.clip(along, -1, 1))) < earth_rad
    # Lengths are in Earth radii. The distance of the observer from the centre is 1/sin ρ. ``reach``: distance to the
    # nearer intersection with the sphere.
    distance = 1 / np.sin(earth_rad)
    reach = distance * along - np.sqrt(np.maximum(0.0, 1 - distance**2 * (1 - along**2)))
    normal = grid.unit_cam * reach[..., None] - distance * nadir_cam
    sunlit = np.clip(normal @ sun_cam, 0, None) / np.maximum(np.linalg.norm(normal, axis=-1), 1e-9)
    per_px = camera.pixel_rad**2
    day_e_s = float(sensor.star_e(SUN_V_MAG, 1.0)) * EARTH_ALBEDO / np.pi * per_px
    night_e_s = float(sensor.star_e(NIGHT_EARTH_V_SR, 1.0)) * per_px
    return on_disc, grid.spread(day_e_s * sunlit + night_e_s) * on_disc
