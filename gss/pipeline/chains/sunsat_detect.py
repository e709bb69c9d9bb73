"""Star detection of Sunsat (Jacobs 1995 §2.2): dark average of each row, scan, region growing, shape, centroid, magnitude.

The functions work on a whole frame and, for tracking, on a window. They do not modify the frame, so the document's step
of restoring the search area is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.results import Centroids, Region
from gss.pipeline.chains.sunsat_parameters import MAGNITUDE_RATIO, ZERO_LUX, SunsatParameters
from gss.pipeline.regions import Blobs, Pixels, SearchLimits, SearchResult, region_records, search

Levels = NDArray[np.floating]
NO_LIMIT = 1 << 40
# Error added by the threshold cut for a star whose peak equals the threshold; measured on rendered frames.
CUT_PX = 0.15
BAND_ROWS = 30


@dataclass(frozen=True)
class Streak:
    """Expected elongation and direction of a star (Jacobs 1995 §2.2.3). ``direction_rad``: from u towards v, ±90°."""

    length_px: float
    direction_rad: float


@dataclass(frozen=True)
class RegionShapes:
    """Shapes of m regions: long and short axis in pixels (between pixel centres), and direction from u towards v in
    (−π/2, π/2]."""

    long_px: Array
    short_px: Array
    direction_rad: Array


@dataclass(frozen=True)
class DetectedStars:
    """Stars of a search area in order of discovery, and all regions found."""

    centroids: Centroids
    regions: tuple[Region, ...]
    invalid: int
    stopped: str


def zero_rows_dn(pixels: Pixels, dark: Pixels | None, p: SunsatParameters) -> tuple[Array, str]:
    """Return the (rows,) levels from which the brightness of the pixels is measured, and a note that describes them.

    ``dark``: (rows, n) pixels of the dark columns. Their average is the dark average of a row, which follows the drift of
    the video amplifier's offset (§2.2.1.2, §8.5.2). The background light raises the threshold above it. The document does
    not state how this amount is determined. Here it is the median of the sky level above the dark average over ``BAND_ROWS``
    rows, interpolated between the bands, because stray light is uneven. The compensation of eq. 2.11 remains relative to
    the sky, because light of the sky is not light of the star. A frame without dark columns uses the sky level of each row
    instead.
    """
    sky_dn = sky_rows_dn(pixels, p.dark_clip_dn, p.search_step_px)
    if dark is None:
        return sky_dn, "no dark columns, level of each row from the sky between the stars"
    dark_dn = dark_rows_dn(dark)
    bands = np.array_split(np.arange(len(dark_dn)), max(1, len(dark_dn) // BAND_ROWS))
    band_dn = [float(np.median((sky_dn - dark_dn)[band])) for band in bands]
    background_dn = np.interp(np.arange(len(dark_dn)), [band.mean() for band in bands], band_dn)
    above = f"sky {np.median(background_dn):.2f} levels above it"
    return dark_dn + background_dn, f"dark average of each row from {dark.shape[1]} dark columns, {above}"


def dark_rows_dn(dark: Pixels) -> Array:
    """Return the (rows,) dark averages of the (rows, n) pixels of the dark columns (§2.2.1.2)."""
    return np.asarray(dark.mean(axis=1))


def sky_rows_dn(pixels: Pixels, clip_dn: float, step_px: int = 3) -> Array:
    """Return the (rows,) sky levels: the mean of every third pixel of a row, without pixels that differ from the median by
    more than ``clip_dn``."""
    sample = pixels[:, ::step_px]
    middle = np.partition(sample, sample.shape[1] // 2, axis=1)[:, sample.shape[1] // 2].astype(float)
    near = np.abs(sample - middle[:, None]) <= clip_dn
    return np.asarray((sample * near).sum(axis=1) / near.sum(axis=1))


def find_stars(level_dn: Levels, parameters: SunsatParameters, streak: Streak | None = None) -> DetectedStars:
    """Find the stars of a (rows, columns) search area; ``level_dn``: pixel values above :func:`zero_rows_dn`."""
    p = parameters
    limits = SearchLimits(p.min_area_px, p.max_area_px, NO_LIMIT, NO_LIMIT, p.edge_rule)
    candidates = search(level_dn, p.threshold_dn, limits, p.search_step_px)
    candidates = _without_bad_shapes(candidates, p, streak)
    candidates = _first_stars(candidates, p)
    stars = candidates.blobs.take(candidates.accepted)
    centroids = gravity_centroids(level_dn, stars, p)
    regions = region_records(level_dn, candidates, 0.0, p.max_small_regions)
    return DetectedStars(centroids, regions, candidates.invalid, candidates.stopped)


def moved(detected: DetectedStars, first_col: int, first_row: int) -> DetectedStars:
    """Convert the result of a window to the pixel coordinates of its frame."""
    c = detected.centroids
    shifted = replace(c, col_px=c.col_px + first_col, row_px=c.row_px + first_row)
    regions = tuple(
        r._replace(
            col_min=r.col_min + first_col,
            col_max=r.col_max + first_col,
            row_min=r.row_min + first_row,
            row_max=r.row_max + first_row,
        )
        for r in detected.regions
    )
    return replace(detected, centroids=shifted, regions=regions)


def shapes(blobs: Blobs) -> RegionShapes:
    """Compute axes and directions of regions from second moments about the centre of the region's base (eq. 2.4–2.8).

    The pixels are assumed square, which is accurate to 4 %. Pixels "located along the axis" are the pixels that the
    axis crosses.
    """
    owner, n = blobs.owner, len(blobs)
    row, col = np.divmod(blobs.index, blobs.columns)
    u, v = -col.astype(float), row.astype(float)
    area = blobs.area_px
    du = u - (np.bincount(owner, u, n) / area)[owner]
    dv = v - (np.bincount(owner, v, n) / area)[owner]
    m20, m02, m11 = (np.bincount(owner, w, n) for w in (du * du, dv * dv, du * dv))
    # Half of the two-argument arctangent gives the results of all three cases of eq. 2.8.
    direction = 0.5 * np.arctan2(2 * m11, m20 - m02)
    c, s = np.cos(direction)[owner], np.sin(direction)[owner]
    along, across = c * du + s * dv, c * dv - s * du
    half = 0.5 * (np.abs(c) + np.abs(s))
    return RegionShapes(_extent(along, across, half, blobs), _extent(across, along, half, blobs), direction)


def _extent(along: Array, across: Array, half: Array, blobs: Blobs) -> Array:
    """Return the distance between the outermost pixels on an axis."""
    on = np.abs(across) <= half
    high = np.maximum.reduceat(np.where(on, along, -np.inf), blobs.start[:-1])
    low = np.minimum.reduceat(np.where(on, along, np.inf), blobs.start[:-1])
    return np.asarray(np.maximum(0.0, high - low))


def _without_bad_shapes(regions: SearchResult, p: SunsatParameters, streak: Streak | None) -> SearchResult:
    if not len(regions.accepted):
        return regions
    shape = shapes(regions.blobs.take(regions.accepted))
    reasons = list(regions.rejected)
    for k, number in enumerate(regions.accepted):
        reasons[number] = _shape_reason(
            float(shape.long_px[k] - shape.short_px[k]), float(shape.direction_rad[k]), p, streak
        )
    accepted = np.array([k for k in regions.accepted if not reasons[k]], np.intp)
    return replace(regions, rejected=tuple(reasons), accepted=accepted)


def _shape_reason(elongation_px: float, direction_rad: float, p: SunsatParameters, streak: Streak | None) -> str:
    """Return why a region with this elongation is not a star, or "" (eq. 2.9–2.10; without an earlier attitude, the
    maximum elongation applies)."""
    if streak is None:
        if elongation_px < p.max_elongation_px:
            return ""
        return f"elongation {elongation_px:.1f} px, at most {p.max_elongation_px:g}"
    if abs(elongation_px - streak.length_px) >= p.elongation_slack_px:
        return f"elongation {elongation_px:.1f} px, expected {streak.length_px:.1f} ± {p.elongation_slack_px:g}"
    turn = (direction_rad - streak.direction_rad + np.pi / 2) % np.pi - np.pi / 2
    if elongation_px > p.direction_from_px and abs(turn) >= p.direction_rad:
        return f"lies {np.degrees(abs(turn)):.0f}° across the expected streak"
    return ""


def _first_stars(regions: SearchResult, p: SunsatParameters) -> SearchResult:
    """Truncate the search after the first stars of the scan (§2.3)."""
    if len(regions.accepted) < p.max_found:
        return regions
    end = int(regions.accepted[p.max_found - 1]) + 1
    stopped = f"search stopped at {p.max_found} stars" if end < len(regions.blobs) else ""
    rejected = regions.rejected[:end]
    return SearchResult(
        regions.blobs.take(np.arange(end)),
        rejected,
        regions.accepted[: p.max_found],
        sum(" > max " in r for r in rejected),
        stopped,
    )


def gravity_centroids(level_dn: Levels, blobs: Blobs, parameters: SunsatParameters) -> Centroids:
    """Return the centres of gravity of the brightness above threshold (eq. 2.1–2.2), one star per blob, in the blobs'
    order.

    ``flux_dn`` is brightness_star of eq. C.1: the light above threshold plus k_area times the light below it.
    """
    p = parameters
    if not len(blobs):
        return Centroids.from_pixels(np.empty((0, 2)))
    owner, n = blobs.owner, len(blobs)
    row, col = np.divmod(blobs.index, blobs.columns)
    level = np.asarray(level_dn, float).ravel()[blobs.index]
    weight = level - p.threshold_dn
    total = np.bincount(owner, weight, n)
    col_px, row_px = np.bincount(owner, weight * col, n) / total, np.bincount(owner, weight * row, n) / total
    area = blobs.area_px
    peak = np.maximum.reduceat(level, blobs.start[:-1])
    offset2 = (col - col_px[owner]) ** 2 + (row - row_px[owner]) ** 2
    spread = np.bincount(owner, offset2 * (p.noise.dark_sigma_dn**2 + level / p.noise.gain_e_per_dn), n)
    model_px2 = (CUT_PX * p.threshold_dn / peak) ** 2 + p.noise.floor_px**2
    sigma = np.sqrt(spread / (2 * total**2) + model_px2)
    return Centroids(col_px, row_px, total + p.k_area * area * p.threshold_dn, peak, area.astype(np.int32), sigma)


def magnitudes(flux_dn: Array, parameters: SunsatParameters) -> Array:
    """Return the (n,) magnitudes Mv of star brightnesses (eq. 2.12–2.13); NaN for zero brightness."""
    flux = np.asarray(flux_dn, float)
    lux = parameters.k_illum_lux * np.where(flux > 0, flux, np.nan)
    return np.asarray(np.log(ZERO_LUX / lux) / np.log(MAGNITUDE_RATIO))


def brightness_dn(v_mag: Array | float, parameters: SunsatParameters) -> Array:
    """Return the brightness of stars of a magnitude; inverse of :func:`magnitudes`."""
    return np.asarray(ZERO_LUX * MAGNITUDE_RATIO ** -np.asarray(v_mag, float) / parameters.k_illum_lux)


Index = NDArray[np.intp]


def brightest(centroids: Centroids) -> Index:
    """Return the indices that sort by decreasing brightness. Stars of equal brightness keep their order."""
    return np.argsort(-centroids.flux_dn, kind="stable")
