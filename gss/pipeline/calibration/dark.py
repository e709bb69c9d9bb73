"""Dark-frame calibration: median frame, fixed pattern, and hot, noisy and dead pixels (Huffman 2006 §4.1, Moniteq 1983
§4.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.words import counted
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import robust_sigma

HOT_SIGMAS = 7.0
NOISY_TIMES = 3.0
DEAD_RESPONSE = 0.5
FEW_FRAMES = 5
LIT_SHARE = 0.02
RAY_SIGMAS = 6.0

Frames = Sequence[NDArray[Any]] | NDArray[Any]


@dataclass(frozen=True)
class DarkCalibration:
    """Calibration from dark frames. (rows, columns) maps ``median_dn`` and ``noise_map_dn`` (standard deviation over
    the frames). ``noise_dn``: noise of the typical pixel. ``pattern_sigma_dn``: fixed differences between pixels as a
    standard deviation, corrected for noise; ``column_sigma_dn`` and ``row_sigma_dn``: the same for complete columns and
    rows. ``hot`` (k, 2): col, row of hot pixels, hottest first, and ``hot_excess_dn`` (k,): their excess over
    neighbouring pixels; ``noisy`` (m, 2): pixels that are three times noisier than the typical pixel. ``level_dn``:
    median of each frame."""

    exposure_s: float
    frames: int
    median_dn: NDArray[np.float32]
    noise_map_dn: NDArray[np.float32]
    typical_dn: float
    noise_dn: float
    pattern_sigma_dn: float
    column_sigma_dn: float
    row_sigma_dn: float
    hot: NDArray[np.intp]
    hot_excess_dn: Array
    noisy: NDArray[np.intp]
    level_dn: Array
    warnings: tuple[Advice, ...]

    def dark_e_s(self, bias_dn: float, gain_e_per_dn: float) -> float:
        """Return the dark current of the typical pixel in electrons per second, for a given bias."""
        return (self.typical_dn - bias_dn) * gain_e_per_dn / self.exposure_s


def calibrate_dark(frames: Frames, exposure_s: float) -> DarkCalibration:
    """Calibrate from three or more frames of equal exposure with the lens covered."""
    from scipy.stats import trim_mean  # imported here because the import takes half a second

    cube = _cube(frames, 3)
    median = np.median(cube, axis=0)
    noise = cube.std(axis=0, ddof=1)
    typical_noise = float(np.sqrt(np.mean(_middle(noise**2))))
    # A median of integers does not show patterns below one digital number. Therefore the pattern is computed from means
    # from which cosmic rays were removed.
    strays = cube.max(axis=0) - median > RAY_SIGMAS * max(typical_noise, 0.3)
    steady = np.where(strays, median, cube.mean(axis=0)).astype(float)
    middle = float(np.median(steady))
    flat = steady - middle
    columns, rows = (np.asarray(trim_mean(flat, 0.05, axis=k), float) for k in (0, 1))
    alone = flat - columns[None, :] - rows[:, None] + float(np.mean(_middle(flat)))
    spread = robust_sigma(alone.ravel())
    hot = np.argwhere(alone > HOT_SIGMAS * max(spread, 0.3))
    excess = alone[hot[:, 0], hot[:, 1]]
    order = np.argsort(-excess)
    noisy = np.argwhere(noise > NOISY_TIMES * max(typical_noise, 0.3))
    noise_of_mean = typical_noise**2 / len(cube)
    level = np.asarray(np.median(cube.reshape(len(cube), -1), axis=1), np.float64)
    return DarkCalibration(
        exposure_s,
        len(cube),
        median.astype(np.float32),
        noise.astype(np.float32),
        middle,
        typical_noise,
        float(np.sqrt(max(spread**2 - noise_of_mean, 0.0))),
        _spread_beyond(columns, spread, len(rows)),
        _spread_beyond(rows, spread, len(columns)),
        hot[order][:, ::-1],
        excess[order],
        noisy[:, ::-1],
        level,
        tuple(_advice(cube, level, alone, typical_noise)),
    )


def _spread_beyond(line: Array, spread: float, other: int) -> float:
    """Return the spread of columns or rows that exceeds the expected spread of averages of their pixels."""
    variance = float(np.var(line)) - spread**2 / other
    return float(np.sqrt(max(variance, 0.0)))


def _middle(values: Array) -> Array:
    """Return the values without the lowest and highest hundredth."""
    low, high = np.percentile(values, [1, 99])
    return np.asarray(values[(values >= low) & (values <= high)], float)


def _cube(frames: Frames, fewest: int) -> NDArray[np.float32]:
    shapes = {np.shape(f) for f in frames}
    if len(frames) < fewest or len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise BadInput(
            "these frames cannot be combined",
            expected=f"{fewest} or more of one size",
            got=f"{len(frames)} of sizes {', '.join(map(str, shapes)) or '-'}",
        )
    return np.stack([np.asarray(f, np.float32) for f in frames])


def _advice(cube: NDArray[np.float32], level: Array, alone: Array, noise: float) -> list[Advice]:
    advice: list[Advice] = []
    if len(cube) < FEW_FRAMES:
        advice.append(
            Advice("few-frames", counted(len(cube), "dark frame"), "take ten or more to reduce the noise of the median")
        )
    drift = float(np.ptp(level))
    if drift > max(2.0, noise):
        text = f"the level changed by {drift:.1f} DN between the frames"
        advice.append(Advice("drift", text, "wait until the temperature of the camera is stable, and cover the lens"))
    low = float(np.percentile(cube, 2))
    if float(np.mean(cube <= 0)) > LIT_SHARE and low <= 0:
        advice.append(
            Advice("bias", "many pixels are zero: part of the noise is clipped", "increase the bias of the read-out")
        )
    # A large, smooth structure in dark frames indicates stray light or a heat source.
    rows, columns = alone.shape
    if min(rows, columns) >= 32:
        blocks = alone[: rows // 8 * 8, : columns // 8 * 8].reshape(8, rows // 8, 8, columns // 8)
        middle = np.median(blocks, axis=(1, 3))
        if float(np.ptp(middle)) > max(3.0, 2 * noise):
            text = f"the level differs by {np.ptp(middle):.1f} DN over the detector"
            advice.append(
                Advice("light", text, "check for stray light and heat: cover the lens and switch off the room light")
            )
    return advice


@dataclass(frozen=True)
class Response:
    """Response of the pixels. ``response``: (rows, columns) relative to the local mean, 1 = typical;
    ``response_sigma``: fixed spread of the response; ``dead`` (k, 2): col, row of pixels with less than half the
    typical response."""

    response: NDArray[np.float32]
    response_sigma: float
    dead: NDArray[np.intp]
    warnings: tuple[Advice, ...]


def pixel_response(flats: Frames, dark_dn: NDArray[Any] | float) -> Response:
    """Measure the pixel response from three or more flat frames and the median dark frame of the same exposure. Smooth variations
    (vignetting, an uneven lamp) are removed by a second-order polynomial."""
    cube = _cube(flats, 3)
    light = np.median(cube, axis=0) - np.asarray(dark_dn, np.float32)
    rows, columns = light.shape
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=-1)
    step = max(1, min(rows, columns) // 64)
    small, sampled_terms = light[::step, ::step].ravel(), terms[::step, ::step].reshape(-1, 6)
    good = np.abs(small - np.median(small)) < 5 * max(float(np.std(small)), 1e-9)
    smooth = terms @ np.linalg.lstsq(sampled_terms[good], small[good], rcond=None)[0]
    if float(np.median(light)) <= 5 * float(np.median(cube.std(axis=0))) / np.sqrt(len(cube)):
        raise BadInput(
            "these flat frames contain no light",
            expected="an even level well above the dark",
            got=f"{np.median(light):.1f} DN above",
        )
    response = light / smooth
    noise = float(np.median(cube.std(axis=0, ddof=1) / smooth)) * float(np.sqrt(np.pi / 2 / len(cube)))
    spread = float(np.sqrt(max(robust_sigma(response.ravel()) ** 2 - noise**2, 0.0)))
    dead = np.argwhere(response < DEAD_RESPONSE)[:, ::-1]
    advice: tuple[Advice, ...] = ()
    if float(np.ptp(smooth)) > 0.5 * float(np.median(smooth)):
        text = "the light differs by more than half over the detector"
        advice = (Advice("uneven", text, "put a diffuser in front of the lens; measure vignetting from stars"),)
    return Response(response.astype(np.float32), spread, dead, advice)
