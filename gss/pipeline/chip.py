"""Manufacturing defects of one simulated detector: hot and dead pixels, and the response of each pixel. The seed
identifies the chip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.sensor import Defects, Sensor

Map = NDArray[np.float32]
FULL_LOSS_LIMIT = 0.95


@dataclass(frozen=True)
class Chip:
    """Detector with manufacturing defects, as (rows, columns) maps. ``response``: factor of the light, including
    vignetting, 0 for dead pixels; ``dark_e_s``: added to the mean dark current; ``offset_dn``: added to the bias.
    ``hot``, ``dead``: flat pixel indices, ascending."""

    response: Map
    dark_e_s: Map
    offset_dn: Map
    hot: NDArray[np.intp]
    dead: NDArray[np.intp]


def make_chip(defects: Defects, sensor: Sensor, camera: Camera, seed: int) -> Chip:
    """Generate a chip. The same seed gives the same chip on every machine."""
    _check(defects)
    rows, columns = camera.rows, camera.columns
    rng = np.random.default_rng(np.random.SeedSequence([seed, rows, columns]))

    def spread(sigma: float, shape: tuple[int, int] = (rows, columns)) -> Map:
        return np.float32(sigma) * rng.standard_normal(shape, dtype=np.float32)

    response = np.maximum(np.float32(0), np.float32(1) + spread(defects.response_sigma)) * _vignetting(defects, camera)
    dark_e_s = np.maximum(np.float32(-1), spread(defects.dark_sigma)) * np.float32(sensor.dark_current_e_s)
    offset_dn = spread(defects.offset_sigma_dn) + spread(defects.column_sigma_dn, (1, columns))
    shuffled = rng.permutation(rows * columns)
    hot_count, dead_count = round(defects.hot_share * rows * columns), round(defects.dead_share * rows * columns)
    hot, dead = np.sort(shuffled[:hot_count]), np.sort(shuffled[hot_count : hot_count + dead_count])
    dark_e_s.ravel()[hot] += rng.exponential(defects.hot_e_s, hot_count).astype(np.float32)
    response.ravel()[dead] = 0
    return Chip(response, dark_e_s, offset_dn, hot, dead)


def _vignetting(defects: Defects, camera: Camera) -> Map:
    x = (np.arange(camera.columns) - camera.centre_col_px) / camera.focal_col_px
    y = (np.arange(camera.rows) - camera.centre_row_px) / camera.focal_row_px
    corner2 = np.max(x**2) + np.max(y**2)
    return np.asarray(1 - defects.corner_loss * (x[None, :] ** 2 + y[:, None] ** 2) / corner2, np.float32)


def _check(defects: Defects) -> None:
    shares = defects.hot_share + defects.dead_share
    if not (min(vars(defects).values()) >= 0 and shares <= 1 and defects.corner_loss <= FULL_LOSS_LIMIT):
        raise BadInput(
            "invalid detector defects",
            expected=f"no negative value, hot_share + dead_share at most 1, corner_loss at most {FULL_LOSS_LIMIT:g}",
            got=str(defects),
        )
