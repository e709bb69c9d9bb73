"""Overlays that the page draws on a frame: regions, stars with their names, predicted positions, coordinate grid.

Positions are in pixels. Degrees appear only in the labels of the grid.
"""

from __future__ import annotations

import math
from typing import NotRequired

import numpy as np
from typing_extensions import TypedDict  # pydantic needs this TypedDict before Python 3.12

from gss.domain.aberration import aberrate
from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.camera import Camera
from gss.domain.results import Centroids, Matches, Region
from gss.domain.stars import StarTable
from gss.store.packed_detail import BOUNDS, RegionColumns, StarColumns

DETECTED_WITHIN_PX = 3.0
GRID_STEPS_DEG = (1, 2, 5, 10, 15, 30)
GRID_LINES = 6
MAX_PREDICTED = 120


class RegionOverlay(TypedDict):
    """Bounding box of a region. ``rejected``: reason for the rejection, "" for a star."""

    col_min: int
    row_min: int
    col_max: int
    row_max: int
    area_px: int
    peak_dn: float
    rejected: str


class StarOverlay(TypedDict):
    """A measured star. A matched star also has its catalogue star and the residual."""

    index: int
    col_px: float
    row_px: float
    flux_dn: float
    peak_dn: float
    area_px: int
    hip: NotRequired[int]
    name: NotRequired[str]
    v_mag: NotRequired[float | None]
    dx_px: NotRequired[float | None]
    dy_px: NotRequired[float | None]
    dx_arcsec: NotRequired[float | None]
    dy_arcsec: NotRequired[float | None]
    weight: NotRequired[float]


class PredictedStar(TypedDict):
    """Predicted position of a catalogue star. ``detected``: True if a measured star is near it."""

    hip: int
    name: str
    v_mag: float
    col_px: float
    row_px: float
    detected: bool


class GridLine(TypedDict):
    """Part of a line of constant right ascension or declination. ``points``: (column, row)."""

    label: str
    points: list[tuple[float, float]]


class AttitudeOverlay(TypedDict):
    """Overlays derived from an attitude. ``north``: unit step (column, row) towards celestial north. ``field``: outline on the
    sky, (ra, dec) in radians."""

    predicted: list[PredictedStar]
    grid: list[GridLine]
    north: tuple[float, float] | None
    field: list[tuple[float, float]]


NOTHING: AttitudeOverlay = {"predicted": [], "grid": [], "north": None, "field": []}
"""Overlays of a result without an attitude."""


def regions_of(regions: tuple[Region, ...]) -> RegionColumns:
    """Return the regions of a result as columns."""
    bounds = np.array([region[: len(BOUNDS)] for region in regions], float).reshape(len(regions), len(BOUNDS))
    return RegionColumns(bounds, np.array([r.peak_dn for r in regions], float), [r.rejected for r in regions])


def stars_of(camera: Camera, stars: StarTable, centroids: Centroids, matches: Matches | None) -> StarColumns:
    """Return the measured stars of a result as columns. ``stars``: catalogue with names and magnitudes."""
    columns = (centroids.col_px, centroids.row_px, centroids.flux_dn, centroids.peak_dn, centroids.area_px)
    measured = np.column_stack(columns).astype(float)
    if matches is None:
        none = np.empty(0, int)
        return StarColumns(measured, none, none, [], np.empty((0, 6)))
    rows = stars.rows_of(matches.hip)
    listed = rows >= 0
    v_mag = np.full(len(rows), math.nan)
    v_mag[listed] = stars.v_mag[rows[listed]]
    residual_px = np.where(np.isfinite(matches.residual_px), matches.residual_px, math.nan)
    arcsec = residual_px * (math.degrees(camera.pixel_rad) * 3600)
    numbers = np.column_stack([v_mag, residual_px, arcsec, matches.weight])
    names = [stars.name_of(number) for number in matches.hip.tolist()]
    return StarColumns(measured, matches.centroid, matches.hip, names, numbers)


def describe(
    camera: Camera,
    stars: StarTable,
    faint_limit_mag: float,
    centroids: Centroids,
    cam_from_icrs: Array,
    velocity_c: tuple[float, float, float] | None = None,
) -> AttitudeOverlay:
    """Return the overlays derived from an attitude as JSON values. ``velocity_c``: velocity of the observer in units of c, None if
    aberration was not corrected."""
    return {
        "predicted": predicted(camera, cam_from_icrs, stars, faint_limit_mag, centroids, velocity_c),
        "grid": grid(camera, cam_from_icrs),
        "north": north(cam_from_icrs),
        "field": field_outline(camera, cam_from_icrs),
    }


def predicted(
    camera: Camera,
    cam_from_icrs: Array,
    stars: StarTable,
    faint_limit_mag: float,
    centroids: Centroids,
    velocity_c: tuple[float, float, float] | None = None,
) -> list[PredictedStar]:
    """Return the predicted positions of catalogue stars, brightest first, and whether a centroid is near them. ``velocity_c``:
    velocity of the observer, with which aberration is added."""
    near = stars.icrs @ cam_from_icrs[2] > math.cos(min(camera.half_diagonal_rad * 1.05 + 0.01, math.pi / 2))
    stars = stars.take(np.flatnonzero(near & (stars.v_mag <= faint_limit_mag))).brighter_than(faint_limit_mag)
    icrs = stars.icrs if velocity_c is None else aberrate(stars.icrs, np.array(velocity_c))
    pixels = camera.project(icrs @ cam_from_icrs.T)
    rows: list[PredictedStar] = []
    for k in np.flatnonzero(camera.contains(pixels))[:MAX_PREDICTED]:
        gap_px = np.hypot(centroids.col_px - pixels[k, 0], centroids.row_px - pixels[k, 1])
        rows.append(
            {
                "hip": int(stars.hip[k]),
                "name": stars.name_of(int(stars.hip[k])),
                "v_mag": float(stars.v_mag[k]),
                "col_px": float(pixels[k, 0]),
                "row_px": float(pixels[k, 1]),
                "detected": bool(len(gap_px) and gap_px.min() < DETECTED_WITHIN_PX),
            }
        )
    return rows


def grid(camera: Camera, cam_from_icrs: Array) -> list[GridLine]:
    """Return lines of constant right ascension and declination across the frame."""
    boresight = cam_from_icrs[2]
    dec_deg = math.degrees(math.asin(max(-1.0, min(1.0, float(boresight[2])))))
    reach_deg = math.degrees(camera.half_diagonal_rad)
    step_deg = next((s for s in GRID_STEPS_DEG if 2 * reach_deg / s <= GRID_LINES), GRID_STEPS_DEG[-1])
    lines: list[GridLine] = []
    first_dec = max(-90 + step_deg, math.floor((dec_deg - reach_deg) / step_deg) * step_deg)
    for line_deg in np.arange(first_dec, min(90 - step_deg, dec_deg + reach_deg) + 0.5 * step_deg, step_deg):
        ra = np.radians(np.arange(0, 360.5, 1.0))
        lines += _pieces(camera, cam_from_icrs, ra, np.full_like(ra, math.radians(line_deg)), f"{line_deg:+g}°")
    ra_step_deg = min(30.0, step_deg * max(1, round(1 / max(0.1, math.cos(math.radians(dec_deg))))))
    for line_deg in np.arange(0, 360, ra_step_deg):
        dec = np.radians(np.arange(-90, 90.5, 1.0))
        lines += _pieces(camera, cam_from_icrs, np.full_like(dec, math.radians(line_deg)), dec, f"{line_deg:g}°")
    return lines


def _pieces(camera: Camera, cam_from_icrs: Array, ra: Array, dec: Array, label: str) -> list[GridLine]:
    """Return the parts of one line that are on the detector or within a margin around it. The margin lets the lines
    reach the edge of the detector."""
    cam = unit_from_ra_dec(ra, dec) @ cam_from_icrs.T
    ahead = cam[:, 2] > math.cos(min(1.4, camera.half_diagonal_rad * 1.3 + 0.02))
    if not ahead.any():
        return []
    pixels = np.full((len(cam), 2), np.nan)
    pixels[ahead] = camera.project(cam[ahead])
    inside = np.nan_to_num(pixels, nan=-1e9)
    shown = camera.contains(inside, margin_px=-0.15 * max(camera.columns, camera.rows))
    rounded = np.round(np.nan_to_num(pixels), 1)
    ends = np.flatnonzero(np.diff(np.concatenate([[False], shown, [False]]).astype(np.int8)))
    runs = [rounded[first:after] for first, after in zip(ends[::2], ends[1::2], strict=True)]
    return [{"label": label, "points": [(c, r) for c, r in run.tolist()]} for run in runs if len(run) > 1]


def north(cam_from_icrs: Array) -> tuple[float, float]:
    """Return the unit step (col, row) in the image towards celestial north at the boresight."""
    north_icrs = np.array([0.0, 0.0, 1.0]) - cam_from_icrs[2, 2] * cam_from_icrs[2]
    in_cam = cam_from_icrs @ north_icrs
    length = float(np.hypot(in_cam[0], in_cam[1])) or 1.0
    return float(in_cam[0]) / length, float(in_cam[1]) / length


def field_outline(camera: Camera, cam_from_icrs: Array) -> list[tuple[float, float]]:
    """Return (ra, dec) in radians of points along the detector's edge, for charts."""
    v = camera.outline(8) @ cam_from_icrs
    ra, dec = np.arctan2(v[:, 1], v[:, 0]) % (2 * np.pi), np.arctan2(v[:, 2], np.hypot(v[:, 0], v[:, 1]))
    return [(float(a), float(d)) for a, d in zip(ra, dec, strict=True)]
