"""Search for warm pixels over a mission: selection of the pixels to follow frame by frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.calibration.robust import robust_sigma

Map = NDArray[np.float32]
TRIMMED = 0.2
"""Share of the lowest values and share of the highest values of a pixel that a block ignores. These values can be
caused by particles and uncatalogued stars."""
MAX_BLOCKS = 40
MIN_FRAMES = 5
"""Minimum number of frames in a block."""
STEP_SIGMAS = 5.0
ALWAYS_SIGMAS = 6.0
MAX_CANDIDATES = 20_000
SAMPLED = 7
"""Step between the flat indices of the pixels on which the noise is measured."""
WINDOWS = (1, 2, 4, 8, MAX_BLOCKS)
"""Numbers of blocks that are averaged after an onset. Small numbers detect pixels that anneal after a short time."""


def block_edges(count: int) -> list[int]:
    """Divide ``count`` frames in order into blocks. Returns the first frame of each block, and the end of the last block."""
    blocks = max(1, min(MAX_BLOCKS, count // MIN_FRAMES))
    return [round(count * b / blocks) for b in range(blocks + 1)]


class BlockMaps:
    """Trimmed mean of each pixel's excess over blocks of frames. Frames are added in order."""

    def __init__(self, edges: list[int]) -> None:
        self._edges, self._waiting = edges, list[Map]()
        self._maps: list[Map] = []

    def add(self, excess_dn: Map) -> None:
        """Add the next frame: (rows, columns), NaN under stars."""
        self._waiting.append(excess_dn)
        block = len(self._maps)
        if len(self._waiting) == self._edges[block + 1] - self._edges[block]:
            self._maps.append(trimmed_mean(np.stack(self._waiting)))
            self._waiting.clear()

    @property
    def maps(self) -> NDArray[np.float32]:
        """Return the (blocks, rows, columns) trimmed means."""
        return np.stack(self._maps)


def trimmed_mean(values: NDArray[np.float32]) -> Map:
    """Return the (rows, columns) mean of (n, rows, columns) values without the lowest and highest fifth; 0 if all
    values are NaN."""
    ordered = np.sort(values, axis=0)  # NaN last
    n = len(values)
    if not np.isnan(ordered[-1]).any():
        cut = min(int(np.ceil(TRIMMED * n)), (n - 1) // 2)
        return np.asarray(ordered[cut : n - cut].mean(axis=0), np.float32)
    count = n - np.count_nonzero(np.isnan(ordered), axis=0)
    rank = np.arange(n)[:, None, None]
    cut = np.minimum(np.ceil(TRIMMED * count), np.maximum(count - 1, 0) // 2).astype(np.intp)
    inside = (rank >= cut) & (rank < count - cut)
    total = np.where(inside, ordered, 0).sum(axis=0)
    return np.asarray(total / np.maximum(inside.sum(axis=0), 1), np.float32)


def candidates(maps: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the flat indices of the pixels that are brighter than typical pixels or become brighter. ``maps``:
    (blocks, rows, columns) means.

    This is a preselection. Several candidates per megapixel are false and are rejected by
    :mod:`gss.pipeline.health.pixel_course`.
    """
    blocks = len(maps)
    flat = maps.reshape(blocks, -1)
    noise = _block_noise(flat)
    mean = flat.mean(axis=0)
    best = (mean - np.median(mean)) / max(robust_sigma(mean[::SAMPLED].astype(float)), 1e-9) - ALWAYS_SIGMAS
    for z in _steps(flat, noise):
        np.maximum(best, z - STEP_SIGMAS, out=best)
    changed = np.flatnonzero(best > 0)
    if len(changed) > MAX_CANDIDATES:
        changed = np.sort(changed[np.argsort(best[changed])[-MAX_CANDIDATES:]])
    return changed


def _block_noise(flat: NDArray[np.float32]) -> Array:
    """Return the (blocks,) noise of the means, from differences of neighbouring blocks, in which the fixed pattern cancels."""
    sample = flat[:, ::SAMPLED].astype(float)
    if len(flat) < 2:
        return np.array([robust_sigma(sample[0])])
    step = np.array([robust_sigma(sample[b + 1] - sample[b]) for b in range(len(flat) - 1)]) / np.sqrt(2)
    return np.asarray(np.maximum(np.concatenate([step[:1], (step[1:] + step[:-1]) / 2, step[-1:]]), 1e-9))


def _steps(flat: NDArray[np.float32], noise: Array) -> Iterator[Array]:
    """Yield the (pixels,) significance of an increase at each block, for each number of averaged blocks."""
    blocks = len(flat)
    total = np.cumsum(flat, axis=0, dtype=np.float32)
    power = np.cumsum(noise**2)
    for start in range(1, blocks):
        before, before_variance = total[start - 1] / start, power[start - 1] / start**2
        for width in sorted({min(w, blocks - start) for w in WINDOWS}):
            end = start + width - 1
            variance = (power[end] - power[start - 1]) / width**2 + before_variance
            yield ((total[end] - total[start - 1]) / width - before) / np.float32(np.sqrt(variance))
