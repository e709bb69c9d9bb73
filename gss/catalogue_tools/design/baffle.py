"""Baffle design: length and width of a tube that keeps direct light of Sun or Earth away from the lens beyond an angle.

Jacobs 1995 §7.6 describes one stage. Moniteq 1983 §5.2 describes two stages; the lens does not see the outer stage.
Coordinates in the section through the axis: z from the lens plane outwards, r from the axis, both in mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gss.domain.errors import BadInput

VANE_DEPTH_SHARE = 0.15
MIN_VANE_SHARE = 0.15
"""Smallest distance of a vane from the lens, as a fraction of the length. Closer to the lens, the spacing of vanes
would tend to zero, and the black wall is sufficient."""
MAX_MM = 20_000.0


@dataclass(frozen=True)
class BaffleGeometry:
    """Geometry of a baffle.

    ``edge_mm``: (z, r) of each knife edge, from the lens to the front. ``wall_mm``: (from z, to z, radius) of the tube
    of each stage. ``exclusion_rad``: a source at this angle from the axis, or farther, never illuminates the lens
    directly.
    """

    kind: Literal["one", "two"]
    lens_radius_mm: float
    half_fov_rad: float
    exclusion_rad: float
    length_mm: float
    front_radius_mm: float
    edge_mm: tuple[tuple[float, float], ...]
    wall_mm: tuple[tuple[float, float, float], ...]

    @property
    def outer_diameter_mm(self) -> float:
        """Diameter of the widest tube, ignoring the wall thickness."""
        return 2 * max(radius for _, _, radius in self.wall_mm)


def field_growth_mm(length_mm: float, half_fov_rad: float) -> float:
    """Return x = l·tan α, the front radius minus the lens radius at which the baffle just does not obstruct the field
    of view (eq. 7.24)."""
    return float(length_mm * np.tan(half_fov_rad))


def exclusion_rad(lens_radius_mm: float, growth_mm: float, length_mm: float) -> float:
    """Return the smallest angle from the axis at which light misses the lens: atan((2 r + x)/l) (eq. 7.26). It is 28.1°
    for 11, 10 and 60 mm."""
    return float(np.arctan((2 * lens_radius_mm + growth_mm) / length_mm))


def length_for_mm(lens_radius_mm: float, half_fov_rad: float, required_rad: float, spare_mm: float = 0.0) -> float:
    """Return the baffle length, from eq. 7.24 and 7.26 solved for l: (2 r + spare)/(tan α_bo − tan α_FOV).

    ``spare_mm``: value added to x to allow for misalignment. Raises BadInput if the angle is not between the field of
    view and 90°.
    """
    _check(lens_radius_mm, half_fov_rad, required_rad)
    return float((2 * lens_radius_mm + spare_mm) / (np.tan(required_rad) - np.tan(half_fov_rad)))


def one_stage(lens_radius_mm: float, half_fov_rad: float, required_rad: float, spare_mm: float = 0.0) -> BaffleGeometry:
    """Return the tube of Jacobs 1995 Fig. 7-4 with vanes on its wall. Raises BadInput if the angle is not possible."""
    length = length_for_mm(lens_radius_mm, half_fov_rad, required_rad, spare_mm)
    return one_stage_of_length(lens_radius_mm, half_fov_rad, length, spare_mm)


def one_stage_of_length(
    lens_radius_mm: float, half_fov_rad: float, length_mm: float, spare_mm: float = 0.0
) -> BaffleGeometry:
    """Return the tube of :func:`one_stage` for a stated length, from which the exclusion angle is computed."""
    if not length_mm > 0:
        raise BadInput("the length of the baffle is out of range", expected="more than 0 mm", got=f"{length_mm:g} mm")
    growth = field_growth_mm(length_mm, half_fov_rad) + spare_mm
    angle = exclusion_rad(lens_radius_mm, growth, length_mm)
    front = lens_radius_mm + growth
    wall = front * (1 + VANE_DEPTH_SHARE)
    edges = _vanes(lens_radius_mm, growth / length_mm, wall, length_mm, angle)
    return BaffleGeometry(
        "one", lens_radius_mm, half_fov_rad, angle, length_mm, front, edges, ((0.0, length_mm, wall),)
    )


def two_stage(lens_radius_mm: float, half_fov_rad: float, required_rad: float) -> BaffleGeometry:
    """Return the shortest two-stage baffle. The lens does not see the outer stage, and direct light does not reach the
    inner stage.

    Inner stage of length l₁ and front radius r₁ = a + l₁ tan φ. The line from the lens's far edge past the inner front
    rises by (a + r₁)/l₁; the outer edges lie on this line or beyond it, so r₂ = r₁ + l₂ (a + r₁)/l₁. Direct light at
    the angle θ misses the inner front if l₂ tan θ ≥ r₁ + r₂. Hence l₂ = 2 r₁/(tan θ − tan φ − 2a/l₁); l₁ is chosen to
    minimise l₁ + l₂. Raises BadInput if the angle is not possible or the baffle is too long.
    """
    _check(lens_radius_mm, half_fov_rad, required_rad)
    a, phi, theta = lens_radius_mm, float(np.tan(half_fov_rad)), float(np.tan(required_rad))
    shortest_inner_mm = 2 * a / (theta - phi)

    def outer(inner_mm: float) -> float:
        return 2 * (a + inner_mm * phi) / (theta - phi - 2 * a / inner_mm)

    from scipy.optimize import minimize_scalar  # the import takes 10 MB of memory

    minimum = minimize_scalar(
        lambda l1: l1 + outer(l1), bounds=(shortest_inner_mm * 1.0001, shortest_inner_mm * 100), method="bounded"
    )
    inner_mm = float(minimum.x)
    outer_mm = float(outer(inner_mm))
    rise = (2 * a + inner_mm * phi) / inner_mm
    r1 = a + inner_mm * phi
    length, r2 = inner_mm + outer_mm, r1 + outer_mm * rise
    if length > MAX_MM:
        raise BadInput(
            "the baffle would be too long",
            expected=f"at most {MAX_MM / 1e3:g} m",
            got=f"{length / 1e3:.0f} m",
            hint="use a larger exclusion angle",
        )
    wall1, wall2 = r1 * (1 + VANE_DEPTH_SHARE), r2 * (1 + VANE_DEPTH_SHARE)
    inner_edges = _vanes(a, phi, wall1, inner_mm, required_rad)
    edges = (*inner_edges, (length, r2))
    return BaffleGeometry(
        "two", a, half_fov_rad, required_rad, length, r2, edges, ((0.0, inner_mm, wall1), (inner_mm, length, wall2))
    )


def _vanes(a: float, slope: float, wall: float, length: float, angle_rad: float) -> tuple[tuple[float, float], ...]:
    """Return knife edges on the border of the field, r = a + slope·z, spaced such that the lens sees no directly lit
    part of the wall.

    The line from the lens's far edge over one tip meets the wall at the next vane.
    """
    front = a + slope * length
    deepest_lit = length - (front + wall) / np.tan(angle_rad)
    z = [length]
    while z[-1] > max(deepest_lit, MIN_VANE_SHARE * length):
        z.append(2 * a * z[-1] / (wall + a - z[-1] * slope))
    return tuple((float(x), float(a + slope * x)) for x in reversed(z))


def _check(lens_radius_mm: float, half_fov_rad: float, required_rad: float) -> None:
    if not lens_radius_mm > 0:
        raise BadInput(
            "the radius of the lens is out of range", expected="more than 0 mm", got=f"{lens_radius_mm:g} mm"
        )
    if not half_fov_rad < required_rad < np.pi / 2:
        raise BadInput(
            "no baffle can block a source this close to the field",
            expected=f"an angle from {np.degrees(half_fov_rad):.1f}° (the corner of the field) to 90°",
            got=f"{np.degrees(required_rad):.1f}°",
        )
