"""Star detection of FAR-MST: dark frame, n·σ threshold, 5x5 pre-filter, 8-connected clusters (Huffman 2006 §4.1–4.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import Centroids
from gss.pipeline.centroid import brightest_first
from gss.pipeline.chains.far_mst_centroid import ClusterMoments, Signal, refine_mle, shapes_of, weighted_sum
from gss.pipeline.chains.far_mst_parameters import PREFILTER_PX, FarMstParameters
from gss.pipeline.chains.onboard import Detection
from gss.pipeline.regions import Blobs, Pixels, SearchResult, region_records

Mask = NDArray[np.bool_]
HALF = PREFILTER_PX // 2


def find_centroids(pixels: Pixels, parameters: FarMstParameters) -> Detection:
    """Find the stars in a (rows, columns) frame, brightest first."""
    if pixels.ndim != 2 or min(pixels.shape) < PREFILTER_PX:
        raise BadInput("not a frame", expected="rows and columns of at least 5 pixels", got=f"shape {pixels.shape}")
    if pixels.dtype.kind == "f" and not np.isfinite(pixels).all():
        raise BadInput("the frame contains invalid pixel values", expected="finite pixels", got="NaN or infinity")
    p = parameters
    dark_dn, noise_dn = _levels(pixels, p)
    threshold_dn = p.threshold_sigma * max(noise_dn, p.noise_dn) if p.threshold_dn is None else p.threshold_dn
    lit = _above(pixels, dark_dn, threshold_dn, p)
    black_dn = float(np.median(dark_dn))
    share = np.count_nonzero(lit) / lit.size
    if share > p.max_lit_share:
        note = f"{100 * share:.0f} % of the pixels exceed the threshold: the sky is not dark"
        return Detection((), Centroids.from_pixels(np.empty((0, 2))), 0, black_dn, (note,))
    filtered = prefiltered(lit, p.prefilter, p.prefilter_count)
    blobs = clusters(filtered)
    signal = Signal(pixels, dark_dn)
    shapes = shapes_of(signal, blobs)
    reasons, limit = _verdicts(pixels.shape, blobs, shapes, p)
    accepted = np.flatnonzero([r == "" for r in reasons])
    regions = SearchResult(blobs, reasons, accepted, sum(" > max " in r for r in reasons), "")
    stars = weighted_sum(shapes, threshold_dn, max(noise_dn, p.noise_dn), p).take(accepted)
    if p.centroider == "mle":
        stars = refine_mle(signal, max(noise_dn, p.noise_dn), stars, p)
    order = brightest_first(stars)[: p.max_centroids]
    return Detection(
        region_records(pixels, regions, black_dn, p.max_small_regions),
        stars.take(order),
        regions.invalid,
        black_dn,
        _notes(shapes, accepted, len(stars) - len(order), limit, p),
    )


def _levels(pixels: Pixels, p: FarMstParameters) -> tuple[Array, float]:
    """Return the dark level, a scalar array or (rows, columns), and the noise of the frame about this level."""
    sample = pixels[::3, ::3].astype(float)
    if p.dark_dn is not None:
        if p.dark_dn.shape != pixels.shape:
            raise BadInput(
                "the dark frame has another size than the frame", expected=str(pixels.shape), got=str(p.dark_dn.shape)
            )
        sample = sample - p.dark_dn[::3, ::3]
        middle, high = np.quantile(sample, [0.5, 0.8413])
        return p.dark_dn, float(high - middle)
    middle, high = np.quantile(sample, [0.5, 0.8413])
    return np.asarray(float(middle)), float(high - middle)


def _above(pixels: Pixels, dark_dn: Array, threshold_dn: float, p: FarMstParameters) -> Mask:
    """Return a mask of the pixels above dark level plus threshold."""
    if dark_dn.ndim == 0 and np.issubdtype(pixels.dtype, np.integer):
        # Integer pixels are compared with the floor of the level, so the frame does not need to be converted to float.
        level = int(np.floor(float(dark_dn) + threshold_dn))
        return np.asarray(pixels > level) if level < int(pixels.max()) else np.zeros(pixels.shape, bool)
    return np.asarray(pixels - dark_dn > threshold_dn)


def prefiltered(lit: Mask, kind: str, count: int) -> Mask:
    """Return the lit pixels with enough lit neighbours (§4.1, §4.2.2).

    sliding: at least ``count`` lit pixels in the 5x5 square around the pixel. block: at least ``count`` lit pixels in
    the pixel's block of a regular 5x5 grid, truncated at the right and lower edges.
    """
    if kind == "none":
        return lit
    if kind == "block":
        return lit & _block_counts(lit, count)
    return lit & (_sliding_counts(lit) >= count)


def _sliding_counts(lit: Mask) -> NDArray[np.uint8]:
    """Return the (rows, columns) numbers of lit pixels in the 5x5 square around each pixel. Pixels outside the frame
    count as dark."""
    rows, columns = lit.shape
    padded = np.zeros((rows + 2 * HALF, columns + 2 * HALF), np.uint8)
    padded[HALF:-HALF, HALF:-HALF] = lit
    across = padded[:, :columns].copy()
    for k in range(1, PREFILTER_PX):
        across += padded[:, k : k + columns]
    down = across[:rows].copy()
    for k in range(1, PREFILTER_PX):
        down += across[k : k + rows]
    return down


def _block_counts(lit: Mask, count: int) -> Mask:
    """Return a (rows, columns) mask, True for pixels whose block has at least ``count`` lit pixels."""
    rows, columns = lit.shape
    high, wide = -(-rows // PREFILTER_PX), -(-columns // PREFILTER_PX)
    padded = np.zeros((high * PREFILTER_PX, wide * PREFILTER_PX), np.uint8)
    padded[:rows, :columns] = lit
    full = padded.reshape(high, PREFILTER_PX, wide, PREFILTER_PX).sum(axis=(1, 3), dtype=np.uint8) >= count
    return np.repeat(np.repeat(full, PREFILTER_PX, axis=0), PREFILTER_PX, axis=1)[:rows, :columns]


def clusters(lit: Mask) -> Blobs:
    """Return the 8-connected components in raster order of their first pixels (§4.2.1)."""
    columns = lit.shape[1]
    index = np.flatnonzero(lit)
    if not len(index):
        return Blobs(index, np.zeros(1, np.intp), columns)
    col = index % columns
    left, right = [], []
    for step, allowed in (
        (1, col < columns - 1),
        (columns - 1, col > 0),
        (columns, None),
        (columns + 1, col < columns - 1),
    ):
        neighbour = np.minimum(np.searchsorted(index, index + step), len(index) - 1)
        joined = index[neighbour] == index + step
        joined = np.flatnonzero(joined if allowed is None else joined & allowed)
        left.append(joined)
        right.append(neighbour[joined])
    a, b = np.concatenate(left), np.concatenate(right)
    graph = coo_array((np.ones(len(a), np.int8), (a, b)), shape=(len(index), len(index)))
    count, label = connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    rank = np.empty(count, np.intp)
    rank[np.argsort(first)] = np.arange(count)
    owner = rank[label]
    order = np.argsort(owner, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))]).astype(np.intp)
    return Blobs(index[order], start, columns)


def _verdicts(
    shape: tuple[int, ...], blobs: Blobs, shapes: ClusterMoments, p: FarMstParameters
) -> tuple[tuple[str, ...], float]:
    """Return why each cluster is rejected, or "", and the maximum aspect ratio in this frame."""
    area = blobs.area_px
    row, col = np.divmod(blobs.index, blobs.columns)
    border = (row == 0) | (row == shape[0] - 1) | (col == 0) | (col == shape[1] - 1)
    at_edge = (np.bincount(blobs.owner, border, len(blobs)) > 0) & p.edge_rule
    sized = (area >= p.min_area_px) & (area <= p.max_area_px) & ~at_edge
    limit = p.max_aspect_ratio
    if np.count_nonzero(sized):
        limit = max(limit, 2 * float(np.median(shapes.aspect[sized])))
    long = shapes.aspect > limit
    return tuple(_reason(*x, limit, p) for x in zip(area, at_edge, long, shapes.aspect, strict=True)), limit


def _reason(area: int, edge: bool, long: bool, aspect: float, limit: float, p: FarMstParameters) -> str:
    if area > p.max_area_px:
        return f"area {area} px > max {p.max_area_px}"
    if area < p.min_area_px:
        return f"area {area} px < min {p.min_area_px}"
    if edge:
        return "touches the edge of the frame"
    return f"aspect ratio {aspect:.1f} over {limit:.1f}" if long else ""


def _notes(
    shapes: ClusterMoments, accepted: NDArray[np.intp], left_out: int, limit: float, p: FarMstParameters
) -> tuple[str, ...]:
    notes = []
    if left_out > 0:
        notes.append(f"{left_out} faintest centroids not used: at most {p.max_centroids}")
    if limit > p.max_aspect_ratio:
        length = float(np.median(shapes.length_px[accepted])) if len(accepted) else 0.0
        notes.append(f"the stars are streaks of about {length:.0f} px: a shorter exposure fits the rate of turn")
    return tuple(notes)
