"""Curves of a design report: stars in the field, signal, and accuracy against one parameter of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.design.accuracy import Accuracy, against_exposure, against_limit, limit_at_mag
from gss.catalogue_tools.design.camera import LIMITS, DesignCamera
from gss.catalogue_tools.design.centroid_bound import centroid_sigma_px
from gss.catalogue_tools.design.in_view import (
    StarsInFields,
    affordable,
    bright_rows,
    mean_by_limit,
    nth_brightest_mag,
    nth_nearest_rad,
    p_fewer_by_focal,
    p_fewer_by_limit,
    p_fewer_in_circle,
    pairs_in_view,
)
from gss.catalogue_tools.design.radiometry import saturation_mag, snr_brightest_pixel, snr_window
from gss.domain.angles import Array
from gss.domain.experiment import Progress
from gss.domain.stars import StarTable

NEED = (3, 5)
EXPOSURE_FACTORS = np.geomspace(0.1, 10.0, 9)
FOCAL_FACTORS = np.geomspace(0.6, 2.0, 13)
LIMIT_SPAN_MAG, LIMIT_STEP_MAG, GRID_BEYOND_MAG = 3.0, 0.1, 0.6


@dataclass(frozen=True)
class Curves:
    """Curves of a report: fractions of fields with fewer than 3 and 5 stars by magnitude limit, by circle diameter and
    by focal length; signal-to-noise ratio and centroid error by magnitude; accuracy by exposure and by magnitude
    limit."""

    limit_mag: Array
    mean_stars: Array
    p_fewer_by_limit: Array
    circle_rad: Array
    p_fewer_in_circle: Array
    focal_mm: Array
    p_fewer_by_focal: Array
    v_mag: Array
    snr_brightest: Array
    snr_window: Array
    centroid_px: Array
    exposure_s: Array
    exposure_limit_mag: Array
    by_exposure: tuple[Accuracy, ...]
    used_limit_mag: Array
    by_limit: tuple[Accuracy, ...]


def curves_of(
    camera: DesignCamera,
    stars: StarTable,
    in_force_mag: float,
    attitudes: Array,
    pairs: StarsInFields,
    in_fields: StarsInFields,
    max_pairs: float,
    progress: Progress,
) -> Curves:
    """Compute all curves. ``in_force_mag``: active magnitude limit. ``attitudes``: pointings. ``pairs``, ``in_fields``:
    stars in their fields. ``max_pairs``: largest number of stars that one curve can process."""
    grid = _limit_grid(in_force_mag)
    nth = nth_brightest_mag(pairs, stars.v_mag)
    unit = stars.icrs[: bright_rows(stars, in_force_mag)]
    half = camera.half_diagonal_rad
    circle = np.linspace(0.1, 1.0, 37) * min(4 * half, np.radians(120.0))
    focal = _focals(camera)
    widest = camera.edited(focal_mm=float(focal[0]))
    focal_attitudes = attitudes[: affordable(widest, len(unit), len(attitudes), max_pairs)]
    progress(0.2)
    v = np.arange(np.floor(min(saturation_mag(camera), in_force_mag, 6.0)) - 1, in_force_mag + 2, 0.25)
    exposures = _exposures_s(camera)
    used = np.linspace(max(-1.0, in_force_mag - 3.0), in_force_mag, 9)
    by_focal = p_fewer_by_focal(unit, focal_attitudes, camera, focal, NEED)
    progress(0.4)
    by_exposure = _by_exposure(camera, stars, attitudes, exposures, max_pairs)
    progress(0.8)
    nearest = nth_nearest_rad(unit, attitudes[:, 2])
    return Curves(
        grid,
        mean_by_limit(pairs, stars.v_mag, grid),
        np.stack([p_fewer_by_limit(nth, n, grid) for n in NEED]),
        circle,
        np.stack([p_fewer_in_circle(nearest, n, circle) for n in NEED]),
        focal,
        by_focal,
        v,
        snr_brightest_pixel(camera, v),
        snr_window(camera, v),
        centroid_sigma_px(camera, v),
        exposures,
        np.array([limit_at_mag(camera, float(t)) for t in exposures]),
        by_exposure,
        used,
        tuple(against_limit(camera, stars, in_fields, used)),
    )


def _exposures_s(camera: DesignCamera) -> Array:
    """Return exposures around that of the camera, within the accepted range."""
    low, high, _ = LIMITS["exposure_s"]
    exposures = camera.exposure_s * EXPOSURE_FACTORS
    return np.unique(np.append(exposures[(exposures >= low) & (exposures <= high)], camera.exposure_s))


def _by_exposure(
    camera: DesignCamera, stars: StarTable, attitudes: Array, exposure_s: Array, max_pairs: float
) -> tuple[Accuracy, ...]:
    """Compute the accuracy by exposure.

    A longer exposure shows many more stars. Therefore the number of pointings is limited to the number that can be
    processed at the longest exposure.
    """
    rows = bright_rows(stars, max(limit_at_mag(camera, float(t)) for t in exposure_s))
    affordable_attitudes = attitudes[: affordable(camera, rows, len(attitudes), max_pairs / 2)]
    pairs = pairs_in_view(stars.icrs[:rows], affordable_attitudes, camera.shape)
    return tuple(against_exposure(camera, stars, pairs, exposure_s))


def _limit_grid(limit: float) -> Array:
    low = np.floor((limit - LIMIT_SPAN_MAG) / LIMIT_STEP_MAG) * LIMIT_STEP_MAG
    grid = np.arange(low, limit + GRID_BEYOND_MAG, LIMIT_STEP_MAG)
    return np.unique(np.round(np.append(grid, limit), 6))


def _focals(camera: DesignCamera) -> Array:
    """Return focal lengths around that of the camera. The shortest is limited by the geometry of a flat detector."""
    shortest = np.hypot(*camera.half_size_mm) / np.tan(np.radians(60.0))
    focal = camera.focal_mm * FOCAL_FACTORS
    in_range = focal[(focal >= max(1.0, shortest)) & (focal <= 2000.0)]
    return np.unique(np.append(in_range, camera.focal_mm))
