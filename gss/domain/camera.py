"""Camera geometry: conversion of camera-frame unit vectors to pixels and back, exact in both directions.

Distortions act on the ideal tangent plane ``(x, y) = (X/Z, Y/Z)``. In each model, one direction is a closed formula.
The opposite direction is computed from this formula by Newton's method: ``undistort(distort(p)) == p`` to rounding
inside the model's domain.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, lengths
from gss.domain.errors import BadInput

NEWTON_STEPS = 25
# Newton's method doubles the number of correct digits: after a step this short, the error is below the rounding error.
CONVERGED = 1e-9
LONGEST_STEP = 0.5
"""Longest step of Newton's method on the tangent plane, whose unit is the focal length."""
INVERSE_ERROR = 1e-9
"""Largest distance on the tangent plane between a measured point and the distorted solution."""


class Distortion(Protocol):
    """Lens distortion model. Maps (n, 2) tangent-plane points from ideal to measured and back. Returns NaN outside the model's
    domain."""

    def distort(self, ideal: Array) -> Array: ...

    def undistort(self, measured: Array) -> Array: ...


@dataclass(frozen=True)
class Pinhole:
    """No distortion."""

    def distort(self, ideal: Array) -> Array:
        return ideal

    def undistort(self, measured: Array) -> Array:
        return measured


@dataclass(frozen=True)
class Brown:
    """Brown–Conrady model in OpenCV's convention, with a closed formula from ideal to measured.

    Erlank 2013 eq. 4.1.3–4 uses the same polynomial from measured to ideal with inverted signs, which is an
    approximation. :class:`BrownUndistort` implements that form.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def distort(self, ideal: Array) -> Array:
        x, y = ideal[..., 0], ideal[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        measured = np.empty(np.shape(ideal))
        measured[..., 0], measured[..., 1] = x * radial, y * radial
        if self.p1 or self.p2:
            measured[..., 0] += 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
            measured[..., 1] += self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return measured

    def undistort(self, measured: Array) -> Array:
        measured = np.array(measured, float)
        if self == _NO_DISTORTION:
            return measured
        u, v = measured[..., 0], measured[..., 1]
        x, y = u.copy(), v.copy()
        for _ in range(NEWTON_STEPS):
            step_x, step_y = self._newton_step(x, y, u, v)
            length = np.sqrt(step_x * step_x + step_y * step_y)
            if not (length <= LONGEST_STEP).all():
                # Long steps are damped because they can jump over the fold of a strong barrel polynomial.
                damping = np.minimum(1.0, LONGEST_STEP / np.maximum(length, 1e-300))
                step_x, step_y = step_x * damping, step_y * damping
            x -= step_x
            y -= step_y
            if not (length > CONVERGED).any():
                break
        ideal = np.stack([x, y], axis=-1)
        bad = lengths(self.distort(ideal) - measured) > INVERSE_ERROR
        ideal[bad] = np.nan
        return ideal

    def _newton_step(self, x: Array, y: Array, u: Array, v: Array) -> tuple[Array, Array]:
        """Return the (…) steps along x and y, on the tangent plane, to subtract from the estimates (x, y) of the ideal points that
        are measured at (u, v)."""
        x2, y2, xy = x * x, y * y, x * y
        r2 = x2 + y2
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = 2 * (self.k1 + r2 * (2 * self.k2 + 3 * r2 * self.k3))
        error_u, error_v = x * radial - u, y * radial - v
        xx, cross, yy = radial + x2 * slope, xy * slope, radial + y2 * slope
        if self.p1 or self.p2:
            error_u += 2 * self.p1 * xy + self.p2 * (r2 + 2 * x2)
            error_v += self.p1 * (r2 + 2 * y2) + 2 * self.p2 * xy
            p1_x, p1_y, p2_x, p2_y = 2 * self.p1 * x, 2 * self.p1 * y, 2 * self.p2 * x, 2 * self.p2 * y
            cross += p1_x + p2_y
            xx += p1_y + 3 * p2_x
            yy += 3 * p1_y + p2_x
        determinant = xx * yy - cross * cross
        return (yy * error_u - cross * error_v) / determinant, (xx * error_v - cross * error_u) / determinant


_NO_DISTORTION = Brown()


@dataclass(frozen=True)
class BrownUndistort:
    """Brown's polynomial from measured to ideal (Erlank 2013 eq. 4.1.3–4). On-board processors evaluate this direction in
    closed form."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def _forward(self) -> Brown:
        return Brown(self.k1, self.k2, self.p1, self.p2)

    def undistort(self, measured: Array) -> Array:
        return self._forward().distort(np.asarray(measured, float))

    def distort(self, ideal: Array) -> Array:
        return self._forward().undistort(np.asarray(ideal, float))


@dataclass(frozen=True)
class RadialTilt:
    """Tilted detector and radial polynomial (Jacobs 1995 eq. 6.13–6.16), with a closed formula from measured to ideal.

    ``tilt_max_rad`` is the largest tilt, in the direction ``tilt_direction_rad`` (from camera +x towards +y).
    ``radial`` contains k₁…k₄ of Δr = k₁ r + k₂ r² + …, with r and Δr in millimetres on the detector as in the
    source. ``focal_mm`` converts them to the tangent plane.
    """

    focal_mm: float
    tilt_max_rad: float = 0.0
    tilt_direction_rad: float = 0.0
    radial: tuple[float, ...] = ()

    def _tilt_rad(self, x: Array, y: Array) -> Array:
        phi = np.arctan2(y, x)
        return np.asarray(np.arcsin(np.sin(self.tilt_max_rad) * np.cos(phi - self.tilt_direction_rad)))

    def _aberration(self, r_mm: Array) -> tuple[Array, Array]:
        """Return Δr in millimetres and its derivative at radius ``r_mm``."""
        delta_mm, slope = np.zeros_like(r_mm), np.zeros_like(r_mm)
        for power in range(len(self.radial), 0, -1):
            k = self.radial[power - 1]
            delta_mm, slope = (delta_mm + k) * r_mm, slope * r_mm + power * k
        return delta_mm, slope

    def undistort(self, measured: Array) -> Array:
        x, y = measured[..., 0], measured[..., 1]
        r = np.hypot(x, y)
        tilt = self._tilt_rad(x, y)
        delta_mm, _ = self._aberration(r * self.focal_mm)
        ideal_r = np.cos(tilt) * (r - delta_mm / self.focal_mm) / (1 + r * np.sin(tilt))
        scale = np.where(r > 0, ideal_r / np.where(r > 0, r, 1.0), 1.0)
        return np.asarray(measured) * scale[..., None]

    def distort(self, ideal: Array) -> Array:
        x, y = ideal[..., 0], ideal[..., 1]
        ideal_r = np.hypot(x, y)
        tilt = self._tilt_rad(x, y)
        cosine, sine = np.cos(tilt), np.sin(tilt)
        r = ideal_r.copy()
        for _ in range(NEWTON_STEPS):
            delta_mm, slope = self._aberration(r * self.focal_mm)
            value = cosine * (r - delta_mm / self.focal_mm) - ideal_r * (1 + r * sine)
            step = value / (cosine * (1 - slope) - ideal_r * sine)
            r = r - step
            if not np.any(np.abs(step) > CONVERGED):
                break
        scale = np.where(ideal_r > 0, r / np.where(ideal_r > 0, ideal_r, 1.0), 1.0)
        return np.asarray(ideal) * scale[..., None]


@dataclass(frozen=True)
class Camera:
    """Geometry of one camera. Pixel centres are at integer (col, row), 0-based. Each axis has a focal length in pixels, so
    pixels do not need to be square."""

    columns: int
    rows: int
    focal_col_px: float
    focal_row_px: float
    centre_col_px: float
    centre_row_px: float
    distortion: Distortion = field(default_factory=Pinhole)

    def __post_init__(self) -> None:
        if self.columns < 1 or self.rows < 1 or not (self.focal_col_px > 0 and self.focal_row_px > 0):
            raise BadInput(
                "the camera is not valid",
                expected="at least 1 x 1 pixels and positive focal lengths",
                got=f"{self.columns} x {self.rows}, f = {self.focal_col_px}, {self.focal_row_px} px",
            )

    @classmethod
    def from_optics(
        cls, columns: int, rows: int, pitch_col_mm: float, pitch_row_mm: float, focal_mm: float, distortion: Distortion
    ) -> Camera:
        """Return a camera with its optical axis at the centre of the detector."""
        return cls(
            columns,
            rows,
            focal_mm / pitch_col_mm,
            focal_mm / pitch_row_mm,
            (columns - 1) / 2,
            (rows - 1) / 2,
            distortion,
        )

    @classmethod
    def from_fov(cls, columns: int, rows: int, fov_col_rad: float) -> Camera:
        """Return a pinhole camera with square pixels and the given horizontal field of view."""
        if not 0 < fov_col_rad < np.pi:
            raise BadInput(
                "the field of view is out of range", expected="between 0° and 180°", got=f"{np.degrees(fov_col_rad):g}°"
            )
        focal_px = columns / 2 / np.tan(fov_col_rad / 2)
        return cls(columns, rows, focal_px, focal_px, (columns - 1) / 2, (rows - 1) / 2)

    def with_focal_scaled(self, factor: float) -> Camera:
        """Return the same camera with both focal lengths multiplied by ``factor``."""
        return replace(self, focal_col_px=self.focal_col_px * factor, focal_row_px=self.focal_row_px * factor)

    def with_focal_scales(self, factors: tuple[float, ...]) -> tuple[Camera, ...]:
        """Return the cameras whose focal lengths are multiplied by each of the factors. The last 16 results are kept, so that
        the angles of these cameras are computed once."""
        return _with_focal_scales(self, factors)

    def project(self, unit_cam: Array) -> Array:
        """Return (n, 2) pixels (col, row) of (n, 3) camera-frame vectors. NaN behind the camera or outside the domain of the
        distortion model."""
        v = np.asarray(unit_cam, float)
        z = np.where(v[..., 2] > 1e-6, v[..., 2], np.nan)
        measured = self.distortion.distort(v[..., :2] / z[..., None])
        return measured * self._focal() + self._centre()

    def unproject(self, pixels: Array) -> Array:
        """Return (n, 3) camera-frame unit vectors of (n, 2) pixels (col, row)."""
        measured = (np.asarray(pixels, float) - self._centre()) / self._focal()
        ideal = self.distortion.undistort(measured)
        v = np.ones((*ideal.shape[:-1], 3))
        v[..., :2] = ideal
        v /= lengths(v)[..., None]
        return v

    def contains(self, pixels: Array, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Return the (n,) mask of (n, 2) pixels on the detector and at least ``margin_px`` inside its edge. False for NaN."""
        col, row = pixels[..., 0], pixels[..., 1]
        low = margin_px - 0.5
        return np.asarray((col >= low) & (row >= low) & (col <= self.columns - 1 - low) & (row <= self.rows - 1 - low))

    def corners(self) -> Array:
        """Return (4, 3) camera-frame unit vectors of the detector's outer corners, in order around the edge."""
        c, r = self.columns - 0.5, self.rows - 0.5
        return self.unproject(np.array([[-0.5, -0.5], [c, -0.5], [c, r], [-0.5, r]]))

    def outline(self, per_side: int = 16) -> Array:
        """Return (4·per_side, 3) camera-frame unit vectors around the detector's edge."""
        c, r = self.columns - 0.5, self.rows - 0.5
        s = np.linspace(0, 1, per_side, endpoint=False)
        corners = np.array([[-0.5, -0.5], [c, -0.5], [c, r], [-0.5, r], [-0.5, -0.5]])
        points = [a + s[:, None] * (b - a) for a, b in itertools.pairwise(corners)]
        return self.unproject(np.concatenate(points))

    @cached_property
    def half_diagonal_rad(self) -> float:
        """Largest angle from the boresight to a corner."""
        z = np.clip(self.corners()[:, 2], -1, 1)
        return float(np.max(np.arctan2(np.sqrt(1 - z * z), z)))

    @cached_property
    def diagonal_rad(self) -> float:
        """Largest angle between two corners, which is the largest distance between two stars in one frame."""
        c = self.corners()
        return float(np.max(2 * np.arcsin(np.linalg.norm(c[:, None] - c[None], axis=-1) / 2)))

    @cached_property
    def fov_rad(self) -> tuple[float, float]:
        """Full field of view through the optical centre: (horizontal, vertical)."""
        mid_col, mid_row = self.centre_col_px, self.centre_row_px
        edges = np.array([[-0.5, mid_row], [self.columns - 0.5, mid_row], [mid_col, -0.5], [mid_col, self.rows - 0.5]])
        e = self.unproject(edges)
        h = np.arccos(np.clip(e[0] @ e[1], -1, 1))
        v = np.arccos(np.clip(e[2] @ e[3], -1, 1))
        return float(h), float(v)

    @property
    def pixel_rad(self) -> float:
        """Angle of one pixel at the optical centre (geometric mean of both axes)."""
        return 1.0 / float(np.sqrt(self.focal_col_px * self.focal_row_px))

    def _focal(self) -> Array:
        return np.array([self.focal_col_px, self.focal_row_px])

    def _centre(self) -> Array:
        return np.array([self.centre_col_px, self.centre_row_px])


@lru_cache(maxsize=16)
def _with_focal_scales(camera: Camera, factors: tuple[float, ...]) -> tuple[Camera, ...]:
    return tuple(camera if factor == 1.0 else camera.with_focal_scaled(factor) for factor in factors)
