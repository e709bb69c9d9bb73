"""Image plane search and region growing (Jacobs 1995 §2.2, Erlank 2013 §4.1.1–2).

The documents search every third pixel of every third row. From a pixel above the threshold, a region grows over the
four neighbours until it is a complete 4-connected component. Here all components are labelled in one pass. Components
without a pixel on the search grid are dropped. The remaining components are sorted by their first grid pixel, which is
the order of the search. A test checks that the result equals the literal recursion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import Region
from gss.pipeline.kernels import NUMPY, Kernels

Pixels = NDArray[np.integer] | NDArray[np.floating]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Blobs:
    """m components in order of discovery. ``index``: flat pixel indices, blob after blob, ascending within each;
    ``start``: (m + 1,) offset of each blob in ``index``. ``columns``: width of the frame."""

    index: NDArray[np.intp]
    start: NDArray[np.intp]
    columns: int

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def area_px(self) -> NDArray[np.intp]:
        """Return the (m,) numbers of pixels per blob."""
        return np.diff(self.start)

    @property
    def owner(self) -> NDArray[np.intp]:
        """Return the blob index of each pixel."""
        return np.repeat(np.arange(len(self)), self.area_px)

    def take(self, indices: NDArray[np.intp]) -> Blobs:
        """Return the blobs with these indices, in this order."""
        areas = self.area_px[indices]
        start = np.concatenate([[0], np.cumsum(areas)])
        index = self.index[np.repeat(self.start[indices] - start[:-1], areas) + np.arange(start[-1])]
        return Blobs(index, start, self.columns)


@dataclass(frozen=True)
class SearchLimits:
    """Limits on the area of a star (inclusive) and on the length of the search. ``edge``: True to reject blobs that
    touch the frame's border, because part of the star can lie outside (Jacobs 1995 §2.2.3)."""

    min_area_px: int
    max_area_px: int
    max_invalid: int
    max_accepted: int
    edge: bool = False


@dataclass(frozen=True)
class SearchResult:
    """Blobs found before the search stopped. ``blobs``: in order of discovery, ``rejected``: (m,) the reason or "",
    ``accepted``: indices of the blobs that were not rejected, ``invalid``: number of blobs that are too large,
    ``stopped``: reason why the search ended early, or ""."""

    blobs: Blobs
    rejected: tuple[str, ...]
    accepted: NDArray[np.intp]
    invalid: int
    stopped: str


def find_blobs(pixels: Pixels, threshold_dn: float, step_px: int = 3, loops: Kernels = NUMPY) -> Blobs:
    """Find all 4-connected components of ``pixels`` (rows, columns) above ``threshold_dn`` that have a pixel on the
    search grid. All ``loops`` give bit-identical results."""
    if pixels.ndim != 2 or 0 in pixels.shape:
        raise BadInput("not a frame", expected="a (rows, columns) array of pixels", got=f"shape {pixels.shape}")
    columns = pixels.shape[1]
    lit = np.flatnonzero(pixels > threshold_dn) if loops.frames is None else loops.frames.lit(pixels, threshold_dn)
    if not len(lit):
        return Blobs(lit, np.zeros(1, np.intp), columns)
    count, label = (_label if loops.frames is None else loops.frames.components)(lit, columns)
    row, col = np.divmod(lit, columns)
    on_grid = np.flatnonzero((row % step_px == 0) & (col % step_px == 0))
    # ``lit`` is in raster order, so the search finds each component at its first grid pixel.
    found_labels, first = np.unique(label[on_grid], return_index=True)
    rank = np.full(count, -1, np.intp)
    rank[found_labels[np.argsort(first)]] = np.arange(len(found_labels))
    position = rank[label]
    accepted = np.flatnonzero(position >= 0)
    order = accepted[np.argsort(position[accepted], kind="stable")]
    start = np.concatenate([[0], np.cumsum(np.bincount(position[accepted], minlength=len(found_labels)))]).astype(
        np.intp
    )
    return Blobs(lit[order], start, columns)


def _label(lit: NDArray[np.intp], columns: int) -> tuple[int, NDArray[np.int32]]:
    """Return the number of components and the component of each lit pixel. Only the lit pixels are processed, which are
    few in a star frame."""
    right = np.flatnonzero((np.diff(lit) == 1) & (lit[1:] % columns != 0))
    below = np.searchsorted(lit, lit + columns)
    above = np.flatnonzero((below < len(lit)) & (lit[np.minimum(below, len(lit) - 1)] == lit + columns))
    a = np.concatenate([right, above])
    b = np.concatenate([right + 1, below[above]])
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(len(lit), len(lit)))
    count, label = connected_components(graph, directed=False)
    return int(count), label


def search(
    pixels: Pixels, threshold_dn: float, limits: SearchLimits, step_px: int = 3, loops: Kernels = NUMPY
) -> SearchResult:
    """Search the image plane with limits (Erlank 2013 §5.3.3). The search stops after more than ``max_invalid`` blobs
    that are too large, or at ``max_accepted`` stars. Blobs that are too small are dead pixels or faint stars and do not
    count as invalid."""
    blobs = find_blobs(pixels, threshold_dn, step_px, loops)
    area = blobs.area_px
    too_large, too_small = area > limits.max_area_px, area < limits.min_area_px
    at_edge = _touches_border(blobs, *pixels.shape) & limits.edge
    accepted = ~(too_large | too_small | at_edge)
    over = np.flatnonzero((np.cumsum(too_large) > limits.max_invalid) | (np.cumsum(accepted) >= limits.max_accepted))
    end = int(over[0]) + 1 if len(over) else len(blobs)
    stopped = ""
    if len(over) and np.count_nonzero(too_large[:end]) > limits.max_invalid:
        stopped = f"search stopped: more than {limits.max_invalid} areas are too large"
    elif end < len(blobs):
        stopped = f"search stopped at {limits.max_accepted} stars"
    blobs, area = blobs.take(np.arange(end)), area[:end]
    reasons = tuple(_reason(int(a), bool(e), limits) for a, e in zip(area, at_edge, strict=False))
    return SearchResult(blobs, reasons, np.flatnonzero(accepted[:end]), int(np.count_nonzero(too_large[:end])), stopped)


def _touches_border(blobs: Blobs, rows: int, columns: int) -> Flags:
    row, col = np.divmod(blobs.index, columns)
    border = (row == 0) | (row == rows - 1) | (col == 0) | (col == columns - 1)
    return np.bincount(blobs.owner, border, len(blobs)) > 0


def _reason(area_px: int, at_edge: bool, limits: SearchLimits) -> str:
    if area_px > limits.max_area_px:
        return f"area {area_px} px > max {limits.max_area_px}"
    if area_px < limits.min_area_px:
        return f"area {area_px} px < min {limits.min_area_px}"
    return "touches the edge of the frame" if at_edge else ""


def region_records(pixels: Pixels, result: SearchResult, black_dn: float, max_small: int) -> tuple[Region, ...]:
    """Return the regions for display, in order of discovery, with at most ``max_small`` regions that are too small.
    ``sum_dn`` is above ``black_dn``."""
    blobs = result.blobs
    if not len(blobs):
        return ()
    row, col = np.divmod(blobs.index, blobs.columns)
    value = pixels.ravel()[blobs.index].astype(float)
    at = blobs.start[:-1]
    left, top = np.minimum.reduceat(col, at), np.minimum.reduceat(row, at)
    right, bottom = np.maximum.reduceat(col, at), np.maximum.reduceat(row, at)
    peak, total = np.maximum.reduceat(value, at), np.add.reduceat(value - black_dn, at)
    area = blobs.area_px
    small = np.array([" < min " in r for r in result.rejected])
    shown = np.flatnonzero(~small | (np.cumsum(small) <= max_small))
    bounds = np.stack([left, top, right, bottom, area], axis=1)[shown].tolist()
    return tuple(
        Region(c0, r0, c1, r1, size, float(peak[k]), float(total[k]), result.rejected[k])
        for (c0, r0, c1, r1, size), k in zip(bounds, shown.tolist(), strict=True)
    )


def grid_median_dn(pixels: Pixels, step_px: int = 3) -> float:
    """Return the median of the search grid's pixels, which estimates the dark-sky level and is robust against stars."""
    sample = pixels[::step_px, ::step_px].ravel()
    if pixels.dtype == np.uint8:
        below = np.cumsum(np.bincount(sample, minlength=256))
        return float(np.searchsorted(below, (below[-1] + 1) // 2))
    return float(np.median(sample))


def lit_values(pixels: Pixels, blobs: Blobs, black_dn: float) -> tuple[Array, Array, Array]:
    """Return column, row and intensity above black of every pixel of the blobs."""
    row, col = np.divmod(blobs.index, blobs.columns)
    return col.astype(float), row.astype(float), pixels.ravel()[blobs.index].astype(float) - black_dn
