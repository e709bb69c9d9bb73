"""Visibility of directions over ranges of attitudes, computed exactly instead of stepping through all combinations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.field import PER_SIDE, FieldRegion, FieldShape
from gss.domain.angles import Array

# Tolerance at the edge of the visible sky. Directions within it are treated as visible.
TOLERANCE_RAD = 2e-6
# Largest number of boxes processed together. If it is exceeded, undecided directions are treated as visible, so no star
# is missed.
MAX_BOXES = 4_000_000
FIRST_GRID, ZOOM_GRID, ZOOMS, ZOOM = 25, 9, 9, 0.3


def cosine_range(amplitude: Array, peak_rad: Array, low_rad: float, high_rad: float) -> tuple[Array, Array]:
    """Return the smallest and largest value of ``amplitude``·cos(x − ``peak_rad``) for x in [low, high]. Amplitudes are
    ≥ 0."""
    ends = amplitude * np.cos(low_rad - peak_rad), amplitude * np.cos(high_rad - peak_rad)
    width = high_rad - low_rad
    has_peak = np.mod(peak_rad - low_rad, 2 * np.pi) <= width
    has_trough = np.mod(peak_rad + np.pi - low_rad, 2 * np.pi) <= width
    return np.where(has_trough, -amplitude, np.minimum(*ends)), np.where(has_peak, amplitude, np.maximum(*ends))


def polar_interval(shape: FieldShape, cam_from_body: Array, low: Array, high: Array) -> tuple[float, float]:
    """Return the smallest and largest component along the orbit's +y axis over all visible directions and all roll,
    pitch, yaw in the box.

    A camera that rotates with a circular orbit covers every azimuth about the orbit normal. The directions that it sees
    at one time, over all attitudes of the box, form one connected patch. Therefore a star is visible at some time if
    and only if its component is between these two numbers.
    """
    axis = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    sees_axis, sees_opposite = reachable(axis, np.eye(3), np.zeros(2), shape, cam_from_body, low, high)
    smallest = -1.0 if sees_opposite else -_largest(shape, -cam_from_body, low, high)
    largest = 1.0 if sees_axis else _largest(shape, cam_from_body, low, high)
    return smallest, largest


def _largest(shape: FieldShape, cam_from_body: Array, low: Array, high: Array) -> float:
    """Largest +y component over the outline of the field and the box.

    The search uses a grid in pitch, yaw and position on the outline, with roll in closed form. It is repeated with
    finer grids around the best point.
    """
    pitch, yaw = (np.linspace(low[k], high[k], FIRST_GRID) for k in (1, 2))
    place = np.arange(4 * PER_SIDE, step=4) / PER_SIDE
    best = -np.inf
    for zoom in range(ZOOMS + 1):
        value = _over_roll(shape.edge(place) @ cam_from_body, pitch, yaw, low[0], high[0])
        k, j, i = np.unravel_index(int(np.argmax(value)), value.shape)
        best = max(best, float(value[k, j, i]))
        if zoom == 0:
            steps = [(high[1] - low[1]) / FIRST_GRID, (high[2] - low[2]) / FIRST_GRID, 4 / PER_SIDE]
        centre = [pitch[j], yaw[i], place[k]]
        near = [
            c + step * 2 * ZOOM**zoom * np.linspace(-1, 1, ZOOM_GRID) for c, step in zip(centre, steps, strict=True)
        ]
        pitch, yaw, place = np.clip(near[0], low[1], high[1]), np.clip(near[1], low[2], high[2]), near[2]
    return best


def _over_roll(unit_body: Array, pitch: Array, yaw: Array, roll_low: float, roll_high: float) -> Array:
    """Return the (k, pitch, yaw) largest +y orbit component of (k, 3) body vectors over the roll range."""
    x, y, z = (unit_body[:, n, None, None] for n in range(3))
    cp, sp, ct, st = np.cos(yaw), np.sin(yaw), np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    # Invert yaw, then pitch. The remaining rotation is roll, about x.
    x1, by = cp * x - sp * y, np.broadcast_to(sp * x + cp * y, np.broadcast_shapes(x.shape, (len(pitch), len(yaw))))
    bz = -st * x1 + ct * z
    return cosine_range(np.hypot(by, bz), -np.arctan2(bz, by), roll_low, roll_high)[1]


def reachable(
    unit: Array,
    base_from_pivot: Array,
    spin_rad: Array,
    shape: FieldRegion,
    cam_from_body: Array,
    low: Array,
    high: Array,
    tolerance_rad: float = TOLERANCE_RAD,
) -> NDArray[np.bool_]:
    """Return the (n,) mask of (n, 3) directions that are in the field for some spin in [spin₀, spin₁] and some roll,
    pitch, yaw in the box.

    A direction in the pivot frame is rotated by the spin about pivot z (coordinate change), then by
    ``base_from_pivot``, then by roll, pitch, yaw and the mounting. Branch and bound: a box is decided if the direction
    is in the field at the centre of the box, or if no rotation in the box can bring it into the field. Otherwise the
    box is halved. The result is exact to ``tolerance_rad``, with undecided directions counted as visible.
    """
    reached = np.zeros(len(unit), bool)
    half = np.concatenate([[np.ptp(spin_rad)], np.asarray(high) - low]) / 2
    centre = np.concatenate([[np.mean(spin_rad)], (np.asarray(high) + low) / 2])
    owner, centres = np.arange(len(unit)), np.broadcast_to(centre, (len(unit), 4))
    off_axis = np.hypot(unit[:, 0], unit[:, 1])
    while len(owner):
        if len(owner) > MAX_BOXES:
            reached[owner] = True
            break
        body = _turned(_spun(unit[owner], centres[:, 0], base_from_pivot), centres[:, 1:])
        v = body @ cam_from_body.T
        # Spin is the first rotation, about pivot z. It moves a direction by at most the angle of spin times the sine of
        # the distance from this axis.
        spun = half[0] * off_axis[owner]
        other = spun + half[1] + half[2]
        # Yaw is the last rotation, about body z. It hardly moves directions near this axis.
        slack = other + half[3] * np.minimum(1.0, np.hypot(body[:, 0], body[:, 1]) + other)
        near = shape.may_be_within(v, slack)
        reached[owner[near & (shape.inside(v) | (slack <= tolerance_rad))]] = True
        keep = near & ~reached[owner]
        owner, centres = owner[keep], centres[keep]
        widest = int(np.argmax(half * [off_axis[owner].max(initial=0.0), 1, 1, 1]))
        half[widest] /= 2
        step = np.zeros(4)
        step[widest] = half[widest]
        owner, centres = np.concatenate([owner, owner]), np.concatenate([centres - step, centres + step])
    return reached


def _spun(unit: Array, spin: Array, base_from_pivot: Array) -> Array:
    """Convert (m, 3) pivot-frame vectors to the base frame at (m,) spins."""
    c, s = np.cos(spin), np.sin(spin)
    x, y, z = unit.T
    return np.asarray(np.stack([c * x + s * y, c * y - s * x, z], axis=-1) @ base_from_pivot.T)


def _turned(unit: Array, angles: Array) -> Array:
    """Convert (m, 3) base-frame vectors to the body frame at (m, 3) roll, pitch, yaw."""
    (cf, ct, cp), (sf, st, sp) = np.cos(angles).T, np.sin(angles).T
    x, y, z = unit.T
    y, z = cf * y + sf * z, cf * z - sf * y
    x, z = ct * x - st * z, ct * z + st * x
    x, y = cp * x + sp * y, cp * y - sp * x
    return np.stack([x, y, z], axis=-1)
