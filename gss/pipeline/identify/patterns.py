"""Dictionary of the blind solver: four-star figures with codes that do not depend on scale, position or roll.

The two stars that are farthest apart define the coordinates: A is at 0 and B is at 1 of the complex plane. The
positions of the other two stars are the code. The idea is from Lang et al. 2010 (astrometry.net); here the dictionary
is built from the star table in memory. A mirrored figure has a different code, so a mirrored image is not identified by
accident.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.pipeline.identify.verify import SkyCatalogue

STARS_PER_CIRCLE = 20.0
BRIGHTEST = 8
LEVEL_RATIO = 2**0.5
PAIRS = np.array(list(combinations(range(4), 2)))
OTHERS = np.array([[k for k in range(4) if k not in pair] for pair in PAIRS.tolist()])


@dataclass(frozen=True)
class PatternLevel:
    """Dictionary of figures of one size. ``radius_rad``: radius of the circles that contain the figures. ``stars``: (p,
    4) rows of the sky in the order A, B, C, D; ``size_rad``: (p,) distance A–B; ``tree``: over (p, 4) codes;
    ``bright``: tree over the circle's stars."""

    radius_rad: float
    stars: NDArray[np.int32]
    size_rad: Array
    tree: cKDTree
    bright: cKDTree
    bright_count: int


def radii_rad(lowest_fov_rad: float, highest_fov_rad: float) -> list[float]:
    """Return circle radii suitable for fields of view in this range (shorter side)."""
    low, high = 0.2 * lowest_fov_rad, max(0.45 * highest_fov_rad, 0.2 * lowest_fov_rad * 1.01)
    count = int(np.ceil(np.log(high / low) / np.log(LEVEL_RATIO))) + 1
    # All calls use the same grid of radii, so that a caller can cache levels.
    first = int(np.floor(np.log(low) / np.log(LEVEL_RATIO)))
    return [float(LEVEL_RATIO ** (first + k)) for k in range(count + 1)]


def build_level(sky: SkyCatalogue, radius_rad: float) -> PatternLevel:
    """Build all figures of a star that is among the eight brightest of its circle with three of the other seven."""
    share = (1 - np.cos(radius_rad)) / 2
    count = int(min(len(sky), max(STARS_PER_CIRCLE / share, 60)))
    unit = sky.icrs[:count]
    bright = cKDTree(unit)
    pairs = bright.query_pairs(2 * np.sin(radius_rad / 2), output_type="ndarray").astype(np.int64)
    packed = np.sort(np.concatenate([pairs[:, 0] << 32 | pairs[:, 1], pairs[:, 1] << 32 | pairs[:, 0]]))
    me, other = packed >> 32, packed & 0xFFFFFFFF
    offsets = np.searchsorted(me, np.arange(count + 1))
    rank = np.bincount(me[other < me], minlength=count)
    have = np.minimum(offsets[1:] - offsets[:-1], BRIGHTEST - 1)
    anchors = np.flatnonzero((rank < BRIGHTEST) & (have >= 3))
    quads = _quads(anchors, other, offsets, have)
    codes, stars, size = codes_of(unit[quads], quads)
    return PatternLevel(radius_rad, stars, size, cKDTree(codes), bright, count)


def _quads(
    anchors: NDArray[np.intp], other: NDArray[np.int64], offsets: NDArray[np.intp], have: NDArray[np.intp]
) -> NDArray[np.int32]:
    """Return the (p, 4) distinct quadruples."""
    parts = []
    for trio in combinations(range(BRIGHTEST - 1), 3):
        rows = anchors[have[anchors] > trio[2]]
        base = offsets[rows]
        parts.append(np.column_stack([rows, other[base + trio[0]], other[base + trio[1]], other[base + trio[2]]]))
    quads = np.sort(np.concatenate(parts), axis=1)
    key = ((quads[:, 0] << 48) | (quads[:, 1] << 32) | (quads[:, 2] << 16) | quads[:, 3]).astype(np.uint64)
    _, first = np.unique(key, return_index=True)
    return quads[first].astype(np.int32)


def codes_of(unit: Array, ids: NDArray[np.int32]) -> tuple[Array, NDArray[np.int32], Array]:
    """Return codes (p, 4), ids (p, 4) in the order A B C D, and sizes (p,) of the figures (p, 4, 3), given as unit
    vectors.

    Each figure is projected on the tangent plane at its centre, as a camera inside the sphere sees it.
    """
    middle = unit.mean(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    east = unit[:, 1] - unit[:, 0]
    east = east - middle * np.sum(east * middle, axis=1, keepdims=True)
    east /= np.maximum(np.linalg.norm(east, axis=1, keepdims=True), 1e-300)
    north = np.cross(middle, east)
    depth = np.einsum("pkj,pj->pk", unit, middle)
    z = (np.einsum("pkj,pj->pk", unit, east) + 1j * np.einsum("pkj,pj->pk", unit, north)) / depth
    return _canonical(z, unit, ids)


def _canonical(
    z: NDArray[np.complex128], unit: Array, ids: NDArray[np.int32]
) -> tuple[Array, NDArray[np.int32], Array]:
    span = np.abs(z[:, PAIRS[:, 0]] - z[:, PAIRS[:, 1]])
    widest = span.argmax(axis=1)
    order = np.concatenate([PAIRS[widest], OTHERS[widest]], axis=1)
    p = np.arange(len(z))[:, None]
    a, b, c, d = (z[p[:, 0], order[:, k]] for k in range(4))
    wc, wd = (c - a) / (b - a), (d - a) / (b - a)
    swap = wc.real + wd.real > 1
    order[swap] = order[swap][:, [1, 0, 2, 3]]
    wc, wd = np.where(swap, 1 - wc, wc), np.where(swap, 1 - wd, wd)
    turn = wc.real > wd.real
    order[turn] = order[turn][:, [0, 1, 3, 2]]
    wc, wd = np.where(turn, wd, wc), np.where(turn, wc, wd)
    chord = np.linalg.norm(unit[p[:, 0], order[:, 0]] - unit[p[:, 0], order[:, 1]], axis=1)
    codes = np.column_stack([wc.real, wc.imag, wd.real, wd.imag])
    return codes, ids[p, order], 2 * np.arcsin(np.minimum(1, chord / 2))
