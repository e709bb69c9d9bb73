"""Count stars in view at random pointings, like ``Stats`` in Jacobs 1995 §5.1. All curves of a run use the same
pointings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.envelope.envelope import Envelope, WholeSky
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.selection.quality import Counts, stars_per_field
from gss.domain.angles import Array, ra_dec_from_unit
from gss.domain.errors import BadInput
from gss.domain.experiment import Progress
from gss.domain.stars import StarTable

Each = Callable[..., Iterable[Counts]]
PORTION = 262_144
"""Number of pointings drawn together: larger portions are counted faster, smaller portions need less memory."""
NTH = 5
COMPLETE_V_MAG = 7.3
"""Magnitude to which Hipparcos is complete. Counts of fainter stars are too low."""


@dataclass(frozen=True)
class InView:
    """Number of stars in view. ``histogram``: pointings with 0, 1, 2 … stars. ``worst_*``: smallest number of stars,
    and the boresight of the first pointing with it."""

    pointings: int
    histogram: Counts
    worst_stars: int
    worst_ra_rad: float
    worst_dec_rad: float

    @property
    def mean(self) -> float:
        """Mean number of stars per pointing."""
        return float(self.histogram @ np.arange(len(self.histogram)) / self.pointings)

    def p_fewer_than(self, stars: int) -> float:
        """Fraction of the pointings with fewer than ``stars`` stars."""
        return float(self.histogram[:stars].sum() / self.pointings)


@dataclass(frozen=True)
class StarsInFields:
    """Every star in every field of a set of pointings, sorted by field and then by brightness, brightest first.

    ``field``, ``star``: (k,) rows in the attitudes and in the star table, which is sorted by brightness. ``plane``: (k,
    2) tangent plane coordinates X/Z, Y/Z. ``count``: (m,) stars per field.
    """

    field: NDArray[np.intp]
    star: NDArray[np.intp]
    plane: Array
    count: Counts

    def brighter_than(self, rows: int) -> StarsInFields:
        """Return the pairs whose star is among the first ``rows`` stars."""
        keep = self.star < rows
        count = np.bincount(self.field[keep], minlength=len(self.count))
        return StarsInFields(self.field[keep], self.star[keep], self.plane[keep], count)


def look(camera: DesignCamera, pointings: int, seed: int, envelope: Envelope | None = None) -> Array:
    """Return (m, 3, 3) random cam_from_icrs, uniform over the sky and the roll, or within an envelope."""
    if pointings < 1:
        raise BadInput("the number of pointings is out of range", expected="at least 1", got=str(pointings))
    where = WholeSky(camera.shape) if envelope is None else envelope
    return where.attitudes(np.random.default_rng(seed), pointings)


def bright_rows(stars: StarTable, limit_mag: float) -> int:
    """Return the number of stars that are not fainter than the limit. The table is sorted by brightness."""
    return int(np.searchsorted(stars.v_mag, limit_mag, side="right"))


def affordable(camera: DesignCamera, rows: int, pointings: int, max_pairs: float) -> int:
    """Return the number of pointings for which the expected number of counted stars is below ``max_pairs``; at least
    50."""
    per_field = rows * camera.shape.area_sr / (4 * np.pi)
    return max(min(pointings, 50), min(pointings, int(max_pairs / max(per_field, 1e-9))))


def count_stars(
    unit: Array,
    attitudes: Callable[[int, int], Array],
    pointings: int,
    shape: FieldShape,
    each: Each,
    progress: Progress,
) -> InView:
    """Compute the histogram of the number of (n, 3) ICRS stars in view over ``pointings``.

    ``attitudes(k, m)``: the m attitudes of portion k. After each patch of sky, progress is reported and cancellation
    checked.
    """
    histogram = np.zeros(1, np.int64)
    worst, worst_boresight = np.iinfo(np.int64).max, np.array([1.0, 0.0, 0.0])
    for k, start in enumerate(range(0, pointings, PORTION)):
        portion = attitudes(k, min(PORTION, pointings - start))
        each_reported = _reporting(each, _within(progress, start / pointings, len(portion) / pointings))
        counts = stars_per_field(unit, portion, shape, each_reported)
        batch_histogram = np.bincount(counts, minlength=len(histogram))
        batch_histogram[: len(histogram)] += histogram
        histogram = batch_histogram
        if counts.min() < worst:
            worst, worst_boresight = int(counts.min()), portion[int(counts.argmin()), 2]
    progress(1.0)
    ra, dec = ra_dec_from_unit(worst_boresight)
    return InView(pointings, histogram, int(worst), float(ra), float(dec))


def counted_pairs(pairs: StarsInFields, attitudes: Array) -> InView:
    """Compute the histogram for the pointings of ``pairs``."""
    worst = int(np.argmin(pairs.count))
    ra, dec = ra_dec_from_unit(attitudes[worst, 2])
    return InView(len(attitudes), np.bincount(pairs.count), int(pairs.count[worst]), float(ra), float(dec))


def _within(progress: Progress, start: float, size: float) -> Progress:
    return lambda share: progress(start + size * share)


def _reporting(each: Each, progress: Progress) -> Each:
    """Wrap ``each`` so that it reports progress after each group."""

    def each_reported(work: Callable[..., Counts], groups: Sequence[object]) -> Iterator[Counts]:
        for k, result in enumerate(each(work, groups)):
            progress(k / len(groups))
            yield result

    return each_reported


def pairs_in_view(unit: Array, attitudes: Array, shape: FieldShape) -> StarsInFields:
    """Find the stars of (n, 3) ICRS directions, brightest first, in the fields of (m, 3, 3) cam_from_icrs."""
    m = len(attitudes)
    reach = 2 * np.sin(shape.half_diagonal_rad / 2) * (1 + 1e-9)
    if len(unit):
        near = cKDTree(attitudes[:, 2]).sparse_distance_matrix(cKDTree(unit), reach, output_type="ndarray")
        field, star = near["i"], near["j"]
        cam = np.einsum("nij,nj->ni", attitudes[field], unit[star])
        inside = shape.inside(cam)
        field, star, cam = field[inside], star[inside], cam[inside]
    else:
        field = star = np.zeros(0, np.intp)
        cam = np.zeros((0, 3))
    order = np.argsort(field * np.int64(max(1, len(unit))) + star, kind="stable")
    field, star, cam = field[order], star[order], cam[order]
    return StarsInFields(field, star, cam[:, :2] / cam[:, 2:], np.bincount(field, minlength=m))


def nth_brightest_mag(pairs: StarsInFields, v_mag: Array, nth: int = NTH) -> Array:
    """Return the (m, nth) magnitudes of the 1st … nth brightest star of each field; +inf if the field has fewer
    stars."""
    start = np.concatenate([[0], np.cumsum(pairs.count)[:-1]])
    result = np.full((len(pairs.count), nth), np.inf)
    for k in range(nth):
        has = pairs.count > k
        result[has, k] = v_mag[pairs.star[start[has] + k]]
    return result


def p_fewer_by_limit(nth_mag: Array, stars: int, limit_mag: Array) -> Array:
    """Return the fraction of fields with fewer than ``stars`` stars, for each magnitude limit."""
    sorted_mag = np.sort(nth_mag[:, stars - 1])
    return np.asarray(1 - np.searchsorted(sorted_mag, limit_mag, side="right") / len(sorted_mag), float)


def mean_by_limit(pairs: StarsInFields, v_mag: Array, limit_mag: Array) -> Array:
    """Return the mean number of stars in the fields of ``pairs``, for each magnitude limit. ``v_mag``: magnitudes of the
    star table."""
    sorted_mag = np.sort(v_mag[pairs.star])
    return np.asarray(np.searchsorted(sorted_mag, limit_mag, side="right") / len(pairs.count), float)


def nth_nearest_rad(unit: Array, boresight: Array, nth: int = NTH) -> Array:
    """Return the (m, nth) angles from (m, 3) boresights to their 1st … nth nearest star: radii of the circles that
    contain 1 … nth stars."""
    if len(unit) < nth:
        return np.full((len(boresight), nth), np.inf)
    chord, _ = cKDTree(unit).query(boresight, k=nth)
    return np.asarray(2 * np.arcsin(np.minimum(chord / 2, 1.0)))


def p_fewer_in_circle(nth_rad: Array, stars: int, diameter_rad: Array) -> Array:
    """Return the fraction of circular fields with fewer than ``stars`` stars, for each diameter (Erlank 2013 Fig.
    3.8)."""
    sorted_rad = np.sort(nth_rad[:, stars - 1])
    return np.asarray(
        1 - np.searchsorted(sorted_rad, np.asarray(diameter_rad) / 2, side="right") / len(sorted_rad), float
    )


def p_fewer_by_focal(
    unit: Array, attitudes: Array, camera: DesignCamera, focal_mm: Array, stars: tuple[int, ...]
) -> Array:
    """Return the (len(stars), len(focal_mm)) fraction of this detector's rectangular fields with fewer stars, for each
    focal length.

    One search with the shortest focal length is sufficient, because the tangent plane coordinates of a star give the
    longest focal length at which it is in the field.
    """
    widest = camera.edited(focal_mm=float(np.min(focal_mm)))
    pairs = pairs_in_view(unit, attitudes, widest.shape)
    half_x, half_y = camera.half_size_mm
    longest_mm = np.minimum(
        half_x / np.maximum(np.abs(pairs.plane[:, 0]), 1e-12), half_y / np.maximum(np.abs(pairs.plane[:, 1]), 1e-12)
    )
    order = np.lexsort((-longest_mm, pairs.field))
    longest_mm = longest_mm[order]
    start = np.concatenate([[0], np.cumsum(pairs.count)[:-1]])
    result = np.empty((len(stars), len(focal_mm)))
    for row, n in enumerate(stars):
        has = pairs.count >= n
        longest_focal_mm = np.sort(longest_mm[start[has] + n - 1])
        holding = len(longest_focal_mm) - np.searchsorted(longest_focal_mm, focal_mm, side="left")
        result[row] = 1 - holding / len(attitudes)
    return result
