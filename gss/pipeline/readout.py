"""Detector read-out model: electrons, noise, digital numbers. The caller supplies the random generator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.dark_columns import NO_DARK_COLUMNS, DarkColumns
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.pipeline.chip import Chip

Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class HotPixel:
    """A pixel that adds ``rate_e_s`` electrons per second."""

    col: int
    row: int
    rate_e_s: float


@dataclass(frozen=True)
class FixedPattern:
    """Constant pixel-to-pixel differences: relative response, and offset in digital numbers. The seed identifies the chip."""

    seed: int
    response_sigma: float = 0.01
    offset_sigma_dn: float = 0.3


def expose(
    light_e: Array,
    sensor: Sensor,
    exposure_s: float,
    rng: np.random.Generator,
    *,
    noise: bool = True,
    hot_pixels: Sequence[HotPixel] = (),
    fixed_pattern: FixedPattern | None = None,
    veil_e_s: NDArray[np.float32] | None = None,
    chip: Chip | None = None,
    dark_factor: float = 1.0,
    dark_columns: DarkColumns = NO_DARK_COLUMNS,
    coupling_px: float = 0.0,
) -> Image:
    """Simulate the read-out of (rows, columns) expected electrons of light. Returns the image, whose rows include the
    ``dark_columns``. ``coupling_px``: see :func:`drift_dn`.

    Shot noise of light is Poisson. Dark current, sky, stray light and read-out noise are drawn as one normal deviate:
    for 15 e and more, this differs from a Poisson distribution only by a skewness of a few hundredths.
    """
    rows, columns = light_e.shape
    dark = _dark_pixels(sensor, exposure_s, dark_factor, rows, dark_columns, coupling_px, rng if noise else None)
    extra_e = _with_hot_pixels(light_e, hot_pixels, exposure_s)
    response, offset_dn = _pattern(fixed_pattern, rows, columns) if chip is None else (chip.response, chip.offset_dn)
    if chip is not None or veil_e_s is not None or dark_factor != 1.0:
        own_dark_e_s = None if chip is None else chip.dark_e_s
        smooth_e = _smooth_electrons(sensor, exposure_s, response, veil_e_s, own_dark_e_s, dark_factor, light_e.shape)
        signal_e = _uneven_electrons(extra_e, smooth_e, sensor, response, rng if noise else None)
        return _read_out(signal_e, offset_dn, sensor, dark)
    even_e = (sensor.dark_current_e_s + sensor.background_e_s) * exposure_s
    expected_e = (extra_e * response).ravel()
    lit = np.flatnonzero(expected_e > 1e-3)
    if noise:
        spread_e = np.float32(np.sqrt(even_e + sensor.read_noise_e**2))
        signal_e = rng.standard_normal(rows * columns, dtype=np.float32)
        signal_e *= spread_e
        signal_e += np.float32(even_e)
        signal_e[lit] += rng.poisson(expected_e[lit]).astype(np.float32)
    else:
        signal_e = np.full(rows * columns, even_e, np.float32)
        signal_e[lit] += expected_e[lit].astype(np.float32)
    return _read_out(signal_e.reshape(rows, columns), offset_dn, sensor, dark)


@dataclass(frozen=True)
class _DarkPixels:
    """Dark pixels of an exposure: (rows, count) electrons, and their mean ``level_e``."""

    columns: DarkColumns
    signal_e: NDArray[np.float32]
    level_e: float
    coupling_px: float


def _dark_pixels(
    sensor: Sensor,
    exposure_s: float,
    dark_factor: float,
    rows: int,
    columns: DarkColumns,
    coupling_px: float,
    rng: np.random.Generator | None,
) -> _DarkPixels:
    """Return the dark pixels, which have dark current and read-out noise, but no defects of single pixels."""
    level_e = dark_factor * sensor.dark_current_e_s * exposure_s
    signal_e = np.full((rows, columns.count), level_e, np.float32)
    if rng is not None and columns.count:
        # A separate generator keeps the light-sensitive pixels independent of the number of dark columns.
        deviate = rng.spawn(1)[0].standard_normal(signal_e.shape, dtype=np.float32)
        signal_e += np.float32(np.sqrt(level_e + sensor.read_noise_e**2)) * deviate
    return _DarkPixels(columns, signal_e, level_e, coupling_px)


def _read_out(
    signal_e: NDArray[np.float32], offset_dn: NDArray[np.float32] | np.float32, sensor: Sensor, dark: _DarkPixels
) -> Image:
    """Return the complete rows in digital numbers, with the drift of the video amplifier."""
    columns = signal_e.shape[1]
    drift: NDArray[np.float32] | np.float32 = np.float32(0)
    if dark.coupling_px:
        row_px = columns + dark.columns.count
        light_e = np.minimum(signal_e, np.float32(sensor.full_well_e)).sum(axis=1) - columns * dark.level_e
        drift = drift_dn(light_e / row_px / sensor.gain_e_per_dn, row_px, dark.coupling_px)[:, None]
    image = _digitise(signal_e, offset_dn + drift, sensor)
    if not dark.columns.count:
        return image
    joined: Image = dark.columns.join(image, _digitise(dark.signal_e, drift, sensor))
    return joined


def drift_dn(row_light_dn: Array, row_px: int, coupling_px: float) -> NDArray[np.float32]:
    """Return the (rows,) offsets of the rows behind an ac-coupled video amplifier (Jacobs 1995 eq. 8.2).

    ``row_light_dn``: (rows,) mean of each row above the dark level, rows in read-out order; ``row_px``: pixels per row;
    ``coupling_px``: time constant in pixel periods. The dark rows before the frame set the capacitor to the dark level. Then its
    voltage follows the video signal. The odd field (rows 0, 2, …) is read before the even field (§2.2.1.2). The change
    within a row is neglected: 909 pixels at full scale are needed for one of the document's levels (eq. 8.3).
    """
    offsets, voltage = np.zeros(len(row_light_dn), np.float32), 0.0
    share = 1.0 - np.exp(-row_px / coupling_px)
    for row in (*range(0, len(offsets), 2), *range(1, len(offsets), 2)):
        offsets[row] = -voltage
        voltage += (float(row_light_dn[row]) - voltage) * share
    return offsets


def _smooth_electrons(
    sensor: Sensor,
    exposure_s: float,
    response: Array | NDArray[np.float32] | float,
    veil_e_s: NDArray[np.float32] | None,
    own_dark_e_s: NDArray[np.float32] | None,
    dark_factor: float,
    shape: tuple[int, ...],
) -> NDArray[np.float32]:
    """Return the (rows, columns) expected electrons of dark current, sky and veil, if they vary over the detector."""
    even_e = (dark_factor * sensor.dark_current_e_s + sensor.background_e_s) * exposure_s
    smooth_e = np.full(shape, even_e, np.float32)
    if own_dark_e_s is not None:
        smooth_e += own_dark_e_s * np.float32(dark_factor * exposure_s)
    if veil_e_s is not None:
        smooth_e += veil_e_s * response * np.float32(exposure_s)
    return np.maximum(smooth_e, 0, out=smooth_e)


def _uneven_electrons(
    light_e: Array,
    smooth_e: NDArray[np.float32],
    sensor: Sensor,
    response: Array | NDArray[np.float32] | float,
    rng: np.random.Generator | None,
) -> NDArray[np.float32]:
    """Return (rows, columns) electrons: a normal deviate with a separate width for each pixel, plus Poisson light."""
    # All values above the full well give the same output. They are limited to keep the Poisson generator within its
    # range.
    expected_e = (np.minimum(light_e, 2 * sensor.full_well_e) * response).ravel()
    lit = np.flatnonzero(expected_e > 1e-3)
    signal_e = smooth_e.ravel()
    if rng is None:
        signal_e[lit] += expected_e[lit].astype(np.float32)
    else:
        spread_e = np.sqrt(signal_e + np.float32(sensor.read_noise_e**2))
        spread_e *= rng.standard_normal(signal_e.size, dtype=np.float32)
        signal_e += spread_e
        signal_e[lit] += rng.poisson(expected_e[lit]).astype(np.float32)
    return signal_e.reshape(smooth_e.shape)


def _with_hot_pixels(light_e: Array, hot_pixels: Sequence[HotPixel], exposure_s: float) -> Array:
    if not hot_pixels:
        return light_e
    hot = light_e.copy()
    rows, columns = hot.shape
    for pixel in hot_pixels:
        if not (0 <= pixel.row < rows and 0 <= pixel.col < columns):
            raise BadInput(
                "hot pixel is not on the detector", expected=f"{columns} x {rows}", got=f"{pixel.col}, {pixel.row}"
            )
        hot[pixel.row, pixel.col] += pixel.rate_e_s * exposure_s
    return hot


def _pattern(
    pattern: FixedPattern | None, rows: int, columns: int
) -> tuple[Array | float, NDArray[np.float32] | np.float32]:
    if pattern is None:
        return 1.0, np.float32(0)
    chip = np.random.default_rng(pattern.seed)
    response = np.maximum(0.0, 1.0 + pattern.response_sigma * chip.standard_normal((rows, columns)))
    return response, np.float32(pattern.offset_sigma_dn) * chip.standard_normal((rows, columns), dtype=np.float32)


def _digitise(signal_e: NDArray[np.float32], offset_dn: NDArray[np.float32] | np.float32, sensor: Sensor) -> Image:
    """Convert electrons to digital numbers: full well, gain, bias, rounding, converter range."""
    dn = np.minimum(signal_e, np.float32(sensor.full_well_e), out=signal_e)
    dn *= np.float32(1.0 / sensor.gain_e_per_dn)
    dn += np.float32(sensor.bias_dn + 0.5) + offset_dn
    # Truncation after adding 0.5 rounds correctly because negative values are clipped to zero first.
    np.clip(dn, 0, sensor.saturation_dn, out=dn)
    return dn.astype(np.uint8) if sensor.bits <= 8 else dn.astype(np.uint16)
