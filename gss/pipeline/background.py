"""Sky background: a mesh of robust levels and noise estimates, interpolated bilinearly.

The values of a tile are the clipped mean and standard deviation of a regular subset of its pixels, so stars, hot pixels
and cosmic rays do not raise them. A 3x3 median over the tiles removes single bright tiles. Moon glow, clouds and
vignetting remain in the mesh. The method follows SExtractor's mesh (Bertin & Arnouts 1996 §4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gss.domain.angles import Array
from gss.pipeline.kernels import NUMPY, Kernels
from gss.pipeline.small import median

TILE_PX = 32
SAMPLES_PER_TILE = 64  # the error of the level is a sixth of the noise of a pixel
CLIP_SIGMA = 3.0
CLIP_ROUNDS = 2
OUT_OF_REACH = 1e30
FLAT_PER_SIGMA = 0.08  # a tile's level is only accurate to about a tenth of the noise
# Lower limit of a tile's noise, as a share of the typical noise and in DN. A tile of dead or clipped pixels has none.
LEAST_SHARE, LEAST_NOISE = 0.2, 1e-6


@dataclass(frozen=True)
class Background:
    """Mesh of sky level and single-pixel noise, both in the unit of the image. ``tile_px``: side of a tile."""

    level: Array
    noise: Array
    tile_px: int

    def at(self, col: Array | NDArray[np.intp], row: Array | NDArray[np.intp]) -> tuple[Array, Array]:
        """Return (level, noise) at pixel positions: bilinear between tile centres, constant outside them."""
        rows, cols = self.level.shape
        r = np.minimum(np.maximum((row + 0.5) / self.tile_px - 0.5, 0), rows - 1)
        c = np.minimum(np.maximum((col + 0.5) / self.tile_px - 0.5, 0), cols - 1)
        r0, c0 = r.astype(np.intp), c.astype(np.intp)
        fr, fc = r - r0, c - c0
        corner = r0 * cols + c0
        right, below = c0 < cols - 1, (r0 < rows - 1) * cols
        values = []
        for mesh in (self.level.ravel(), self.noise.ravel()):
            top = mesh[corner] * (1 - fc) + mesh[corner + right] * fc
            bottom = mesh[corner + below] * (1 - fc) + mesh[corner + below + right] * fc
            values.append(top * (1 - fr) + bottom * fr)
        return values[0], values[1]

    def on_grid(self, cols: Array | NDArray[np.intp], rows: Array | NDArray[np.intp]) -> Array:
        """Return the (rows, cols) levels at every combination of these rows and columns."""
        return np.asarray(self._between(rows, 0) @ self.level @ self._between(cols, 1).T)

    def _between(self, position: Array | NDArray[np.intp], axis: int) -> Array:
        """Return the (n, tiles) interpolation weights of the tiles at positions along one axis."""
        tiles = self.level.shape[axis]
        tile_position = np.minimum(np.maximum((position + 0.5) / self.tile_px - 0.5, 0), tiles - 1)
        return np.asarray(np.maximum(0.0, 1 - np.abs(tile_position[:, None] - np.arange(tiles))))

    def scaled(self, level_factor: float, noise_factor: float) -> Background:
        """Return the mesh in another unit: level and noise multiplied by the factors."""
        return Background(self.level * level_factor, self.noise * noise_factor, self.tile_px)

    def lowest_threshold(self, sigma: float) -> Array:
        """Return, per tile, a lower bound of ``level + sigma·noise`` inside the tile."""
        lowest = self.level + sigma * self.noise
        for mesh in (lowest, lowest.T):  # minimum of three neighbours along rows, then along columns
            pairs = np.minimum(mesh[1:], mesh[:-1])
            mesh[1:] = pairs
            np.minimum(mesh[:-1], pairs, out=mesh[:-1])
        return lowest


def _clipped(samples: Array, loops: Kernels = NUMPY) -> tuple[Array, Array]:
    """Return the clipped mean and standard deviation of each row, ignoring NaN samples."""
    # Few processors sort integers of less than 32 bits with vector instructions.
    kind = np.int32 if samples.dtype.kind == "u" and samples.itemsize < 4 else samples.dtype
    ordered: NDArray[Any] = samples.astype(kind)
    ordered.sort(axis=1)  # one sort gives median and spread; NaN last
    count, missing = np.full(len(ordered), ordered.shape[1]), None
    if ordered.dtype.kind == "f" and np.isnan(ordered[:, -1]).any():
        missing = np.isnan(ordered)
        count -= np.count_nonzero(missing, axis=1)
    if loops.frames is not None:
        return loops.frames.clip(ordered, count)
    row = np.arange(len(ordered))

    def quantile(share: float) -> Array:
        return ordered[row, np.maximum((share * (count - 1) + 0.5).astype(np.intp), 0)].astype(float)

    middle, low, high = quantile(0.5), quantile(0.1587), quantile(0.8413)
    off = ordered - middle[:, None]
    if missing is not None:
        off[missing] = 0.0
    mean_off = np.abs(off).sum(axis=1) / np.maximum(count, 1)
    # The quantiles of a noisy frame can be equal if the frame is coarsely quantised.
    spread = np.maximum((high - low) / 2, np.minimum(mean_off, 0.5))
    mean = np.zeros(len(ordered))
    if missing is not None:
        off[missing] = OUT_OF_REACH
    for _ in range(CLIP_ROUNDS):
        # A sum of products takes one pass over the data. Masks and copies would take several passes.
        keep = (np.abs(off - mean[:, None]) <= CLIP_SIGMA * spread[:, None] + 1e-12).astype(float)
        n = np.maximum(keep.sum(axis=1), 1)
        mean = np.einsum("ij,ij->i", keep, off) / n
        off_kept = keep * (off - mean[:, None])
        variance = np.einsum("ij,ij->i", off_kept, off_kept) / n
        spread = np.sqrt(variance) * 1.014  # corrects the effect of clipping a normal distribution at 3 sigma
    return middle + mean, spread


def _tile_samples(image: NDArray[Any], tile_px: int, step: int, loops: Kernels) -> tuple[NDArray[Any], tuple[int, int]]:
    """Return (tiles, samples) of every ``step``-th pixel and the mesh's shape. Pixels past the last whole tile form partial
    tiles, padded with NaN."""
    rows, cols = image.shape
    shape = (-(-rows // tile_px), -(-cols // tile_px))
    per = -(-tile_px // step)
    if loops.frames is not None and rows % tile_px == cols % tile_px == 0:
        return loops.frames.tile_samples(image, tile_px, step), shape
    picked = image[step // 2 :: step, step // 2 :: step]
    side = (shape[0] * per, shape[1] * per)
    if tile_px % step == 0 and picked.shape == side:
        padded = picked if picked.dtype.kind == "u" else picked.astype(np.float32)
    else:
        padded = np.full(side, np.nan, np.float32)
        sampled = [np.arange(step // 2, n, step) for n in (rows, cols)]
        index = [(a // tile_px) * per + (a % tile_px) // step for a in sampled]
        padded[np.ix_(index[0], index[1])] = picked
    tiles = padded.reshape(shape[0], per, shape[1], per).transpose(0, 2, 1, 3).reshape(shape[0] * shape[1], per * per)
    return np.asarray(tiles), shape


def measure_background(image: NDArray[Any], tile_px: int = TILE_PX, loops: Kernels = NUMPY) -> Background:
    """Measure the background mesh of an image of any real type.

    If the tile levels agree within their error, all are set to their mean.
    """
    tile = int(min(tile_px, *image.shape))
    step = max(1, int(tile / np.sqrt(SAMPLES_PER_TILE)))
    step = next(s for s in range(step, 0, -1) if tile % s == 0)
    samples, shape = _tile_samples(image, tile, step, loops)
    level, noise = _tile_levels(samples, loops)
    meshes = _fill(level.reshape(shape)), _fill(noise.reshape(shape))
    return Background(*(_smooth_mesh if loops.frames is None else loops.frames.smooth_mesh)(*meshes), tile)


def _smooth_mesh(level: Array, noise: Array) -> tuple[Array, Array]:
    """Return level and noise of the mesh without its outliers. Levels that agree within their error become their mean."""
    level, noise = _median_of_nine(np.stack([level, noise]))
    typical = median(noise.ravel())
    if np.std(level) < FLAT_PER_SIGMA * typical:
        level = np.full(level.shape, float(np.mean(level)))
    return level, np.maximum(noise, max(LEAST_SHARE * typical, LEAST_NOISE))


def _tile_levels(samples: Array, loops: Kernels) -> tuple[Array, Array]:
    """Return level and noise of each tile; NaN for partial tiles at the right and bottom edges with too few pixels."""
    # A tile has pixels outside the frame only if its last pixel is outside.
    if samples.dtype.kind == "u" or not np.isnan(samples[:, -1]).any():
        return _clipped(samples, loops)
    short = np.isnan(samples).mean(axis=1) > 0.7
    level, noise = np.full(len(samples), np.nan), np.full(len(samples), np.nan)
    use = ~short if not short.all() else short
    with np.errstate(invalid="ignore"):
        level[use], noise[use] = _clipped(samples[use], loops)
    return level, noise


def _median_of_nine(meshes: Array) -> Array:
    """Return the 3x3 medians of (m, r, c) meshes, same shape; edge tiles are repeated."""
    m, rows, cols = meshes.shape
    wide = np.empty((m, rows + 2, cols + 2))
    wide[:, 1:-1, 1:-1] = meshes
    wide[:, 0, 1:-1], wide[:, -1, 1:-1] = meshes[:, 0], meshes[:, -1]
    wide[:, :, 0], wide[:, :, -1] = wide[:, :, 1], wide[:, :, -2]
    nine = np.empty((m, rows, cols, 9))
    for k in range(9):
        nine[..., k] = wide[:, k // 3 : k // 3 + rows, k % 3 : k % 3 + cols]
    nine.partition(4, axis=-1)
    return nine[..., 4]


def pixel_noise(image: NDArray[Any], background: Background, max_samples: int = 3_000, loops: Kernels = NUMPY) -> float:
    """Return the typical standard deviation of a sky pixel, from a regular subset of about ``max_samples`` pixels."""
    step = max(
        1, int(np.sqrt(image.size / max_samples)) | 1
    )  # odd, to avoid the periods of tiles and two-pixel patterns
    find = _residuals if loops.frames is None else loops.frames.residuals
    _, spread = _clipped(find(image, background.level, background.tile_px, step)[None], loops)
    return float(max(spread[0], LEAST_NOISE))


def _residuals(image: NDArray[Any], level: Array, tile_px: int, step: int) -> Array:
    """Return the (n,) differences of every ``step``-th pixel from the mesh of sky levels."""
    rows, cols = np.arange(step // 2, image.shape[0], step), np.arange(step // 2, image.shape[1], step)
    sky = Background(level, level, tile_px).on_grid(cols, rows)
    return np.asarray(image[step // 2 :: step, step // 2 :: step] - sky).ravel()


def _fill(mesh: Array) -> Array:
    """Replace non-finite tiles by the value of the nearest finite tile (all zeros if there is none)."""
    bad = ~np.isfinite(mesh)
    if not bad.any():
        return mesh
    if bad.all():
        return np.zeros_like(mesh)
    nearest = ndimage.distance_transform_edt(bad, return_distances=False, return_indices=True)
    return np.asarray(mesh[tuple(nearest)])
