"""Attitude accuracy from noise, over the sky, against exposure and against the magnitude limit.

The stars in view, each with its Cramér–Rao bound, are combined by the Fisher information of a small rotation. Errors of
calibration, distortion, catalogue and centroid bias are not included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.centroid_bound import centroid_sigma_px
from gss.catalogue_tools.design.in_view import StarsInFields, bright_rows
from gss.catalogue_tools.design.radiometry import limit_brightest_pixel_mag, limit_mag, saturation_mag
from gss.domain.angles import Array
from gss.domain.stars import StarTable

MIN_STARS = 3
MAG_STEP = 0.05


@dataclass(frozen=True)
class Accuracy:
    """Statistics of the attitude's standard deviation over pointings. ``share``: fraction of pointings with at least
    :data:`MIN_STARS` stars.

    ``cross_*``: one axis across the boresight, root mean square of the two. ``roll_*``: about the boresight.
    ``median``, ``p95``: over all pointings, with the value +inf for a pointing with too few stars. ``mean``, ``worst``:
    only over the pointings with enough stars; NaN if there are none.
    """

    share: float
    cross_median_rad: float
    cross_mean_rad: float
    cross_p95_rad: float
    cross_worst_rad: float
    roll_median_rad: float
    roll_mean_rad: float
    roll_p95_rad: float
    roll_worst_rad: float


def sigma_rad(camera: DesignCamera, pairs: StarsInFields, star_sigma_px: Array) -> tuple[Array, Array]:
    """Return the (m,) standard deviations (across, about) of the attitude of each field; NaN for fields with fewer than
    three stars.

    ``star_sigma_px``: (n,) per star of the table, +inf for unused stars. Under the small rotation ρ, a star at (x, y)
    in the tangent plane moves by (−xy, 1 + x², −y)·ρ and (−1 − y², xy, x)·ρ. These derivatives are exact for wide
    fields too.
    """
    m = len(pairs.count)
    sigma = star_sigma_px[pairs.star]
    used = np.isfinite(sigma)
    field, x, y = pairs.field[used], pairs.plane[used, 0], pairs.plane[used, 1]
    wx = (camera.camera.focal_col_px / sigma[used]) ** 2
    wy = (camera.camera.focal_row_px / sigma[used]) ** 2
    g = (-x * y, 1 + x * x, -y)
    h = (-1 - y * y, x * y, x)
    information = np.empty((m, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            part = np.bincount(field, wx * g[i] * g[j] + wy * h[i] * h[j], minlength=m)
            information[:, i, j] = information[:, j, i] = part
    enough = np.bincount(field, minlength=m) >= MIN_STARS
    across, about = np.full(m, np.nan), np.full(m, np.nan)
    if enough.any():
        covariance = np.linalg.inv(information[enough])
        across[enough] = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)
        about[enough] = np.sqrt(covariance[:, 2, 2])
    return across, about


def star_sigma_px(camera: DesignCamera, stars: StarTable, rows: int) -> Array:
    """Return the (rows,) centroid errors of the brightest stars. A saturated star is given the error of a star just
    below saturation."""
    bright = saturation_mag(camera)
    v = np.maximum(stars.v_mag[:rows], bright if np.isfinite(bright) else -2.0)
    grid = np.arange(np.floor(v.min()) if rows else 0.0, (v.max() if rows else 0.0) + 2 * MAG_STEP, MAG_STEP)
    return np.exp(np.interp(v, grid, np.log(centroid_sigma_px(camera, grid))))


def accuracy(camera: DesignCamera, stars: StarTable, pairs: StarsInFields, limit: float | None = None) -> Accuracy:
    """Compute the accuracy over the pointings of ``pairs``, using stars to the active magnitude limit or to
    ``limit``."""
    rows = bright_rows(stars, limit_mag(camera) if limit is None else limit)
    return summary(*sigma_rad(camera, pairs.brighter_than(rows), star_sigma_px(camera, stars, rows)))


def summary(across: Array, about: Array) -> Accuracy:
    """Return the statistics of (m,) standard deviations, which are NaN for fields without an attitude."""
    finite = np.isfinite(across) & np.isfinite(about)

    def statistics_of(values: Array) -> tuple[float, float, float, float]:
        ranked, finite_values = np.sort(np.where(finite, values, np.inf)), values[finite]
        median, p95 = (float(ranked[int(q * (len(ranked) - 1))]) for q in (0.5, 0.95))
        mean, worst = (
            (float(finite_values.mean()), float(finite_values.max()))
            if len(finite_values)
            else (float("nan"), float("nan"))
        )
        return median, mean, p95, worst

    return Accuracy(float(finite.mean()), *statistics_of(across), *statistics_of(about))


def limit_at_mag(camera: DesignCamera, exposure_s: float) -> float:
    """Return the magnitude limit at another exposure. This is the radiometric limit, or the stated limit. A shorter
    exposure makes the stated limit brighter; a longer exposure does not change it."""
    other = replace(camera, exposure_s=exposure_s)
    if camera.mag_limit is None:
        return limit_mag(other)
    return camera.mag_limit + min(0.0, limit_brightest_pixel_mag(other) - limit_brightest_pixel_mag(camera))


def against_exposure(camera: DesignCamera, stars: StarTable, pairs: StarsInFields, exposure_s: Array) -> list[Accuracy]:
    """Return the accuracy for each exposure (s) with the camera at rest: the noise-equivalent angle."""
    return [
        accuracy(replace(camera, exposure_s=float(t)), stars, pairs, limit_at_mag(camera, float(t)))
        for t in np.ravel(exposure_s)
    ]


def against_limit(camera: DesignCamera, stars: StarTable, pairs: StarsInFields, limits_mag: Array) -> list[Accuracy]:
    """Return the accuracy for each magnitude limit, using only stars up to that limit."""
    return [accuracy(camera, stars, pairs, float(v)) for v in np.ravel(limits_mag)]
