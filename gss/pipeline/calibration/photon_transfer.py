"""Gain and read noise from pairs of flat frames. The variance of photon noise is proportional to the signal (Janesick
2001 §2.2).

The difference of two equal exposures contains no fixed pattern, so half its variance is the noise variance of one
frame. A variance below this line shows that the full well or the limit of the converter is reached.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import fit_linear

CLIP_SIGMAS = 5.0
MIN_SPREAD_DN = 0.8
TURN_SHARE = 0.8
NOT_LINEAR = 0.1
MIN_LEVELS = 3


@dataclass(frozen=True)
class FlatPair:
    """Two (rows, columns) flat frames of the same light level and exposure."""

    first: NDArray[Any]
    second: NDArray[Any]


@dataclass(frozen=True)
class PhotonTransfer:
    """Result of a photon transfer measurement. ``read_noise_e``: read noise including quantisation, from the dark pair,
    NaN without a dark pair or if its frames are equal. ``bias_dn``: bias from the dark pair, NaN without a dark pair.
    ``response_sigma``: relative spread of the pixels' response. ``full_well_e``: signal at which the variance starts to
    decrease, NaN if not reached. Both are NaN if the level without light is unknown. Per level: ``signal_dn`` above
    this level, or above zero if it is unknown, ``variance_dn2`` of one frame, ``fitted``.
    ``nonlinearity``: largest relative deviation of the variance of a fitted level from the line."""

    gain_e_per_dn: float
    gain_sigma: float
    read_noise_e: float
    read_noise_sigma_e: float
    bias_dn: float
    response_sigma: float
    full_well_e: float
    nonlinearity: float
    signal_dn: Array
    variance_dn2: Array
    fitted: NDArray[np.bool_]
    warnings: tuple[Advice, ...]


def photon_transfer(
    pairs: Sequence[FlatPair],
    dark_pair: FlatPair | None = None,
    saturation_dn: float | None = None,
    dark_dn: float = float("nan"),
) -> PhotonTransfer:
    """Measure from pairs at several levels. ``dark_pair``: two dark frames of the shortest exposure, from which bias
    and read noise are measured. Both need it: the line through the levels only gives read² − bias/gain. ``dark_dn``:
    level without light, used for the signals without a dark pair. Raises BadInput for too few levels, a pair of equal
    frames, frames of different sizes, and if the variance does not increase."""
    levels = [_level(p) for p in pairs]
    dark = None if dark_pair is None else _level(dark_pair)
    zero_dn = dark_dn if dark is None else dark[0]
    signal = np.array([mean - (zero_dn if np.isfinite(zero_dn) else 0.0) for mean, _, _, _ in levels])
    variance = np.array([v for _, v, _, _ in levels])
    pixels = float(np.mean([n for *_, n in levels])) if levels else 0.0
    clipped = np.array([_clips(p, saturation_dn) for p in pairs], bool)
    equal = np.flatnonzero((variance <= 0) & ~clipped)
    if len(equal):
        raise BadInput(
            "the two frames of a pair are equal",
            expected="two exposures of the same light",
            got=f"pair {equal[0] + 1} without noise",
        )
    fitted = _rising(signal, variance) & ~clipped
    noisy_dark = dark if dark is not None and dark[1] > 0 else None
    if fitted.sum() < MIN_LEVELS - (noisy_dark is not None):
        raise BadInput(
            "too few levels of light for a photon transfer curve",
            expected=f"{MIN_LEVELS} below saturation, {MIN_LEVELS - 1} with a dark pair",
            got=str(int(fitted.sum())),
            hint="take pairs of flats from nearly dark to half the converter's range",
        )
    slope, gain_sigma, departure = _line(signal[fitted], variance[fitted], noisy_dark, pixels)
    gain = 1 / slope
    read = read_sigma = float("nan")
    if noisy_dark is not None:
        read = float(np.sqrt(noisy_dark[1])) * gain
        # A variance measured on n pixels has a relative error of √(2/n).
        read_sigma = read * float(np.hypot(np.sqrt(2 / pixels) / 2, gain_sigma / gain))
    full = response = float("nan")
    if np.isfinite(zero_dn):
        full = float(signal[~fitted].min() * gain) if (~fitted).any() else full
        response = _response([lv for lv, f in zip(levels, fitted, strict=True) if f], signal[fitted])
    advice = tuple(_advice(dark is not None, departure, bool(fitted.all()), float(zero_dn)))
    bias_dn = float("nan") if dark is None else dark[0]
    return PhotonTransfer(
        gain, gain_sigma, read, read_sigma, bias_dn, response, full, departure, signal, variance, fitted, advice
    )


def _line(
    signal: Array, variance: Array, dark: tuple[float, float, float, int] | None, pixels: float
) -> tuple[float, float, float]:
    """Return the slope of the variance, the σ of the gain, and the largest relative deviation from the line."""
    x, y = (signal, variance) if dark is None else (np.append(signal, 0.0), np.append(variance, dark[1]))
    fit = fit_linear(np.column_stack([x, np.ones(len(x))]), y, y * np.sqrt(2 / pixels))
    slope, floor = (float(c) for c in fit.coefficients)
    if slope <= 0:
        raise BadInput(
            "the variance does not increase with the light",
            expected="photon noise, which increases with the light",
            got=f"slope {slope:g}",
            hint="use raw frames, not processed frames",
        )
    departure = float(np.max(np.abs(fit.residual / (slope * x + floor)), initial=0.0))
    return slope, float(np.sqrt(fit.covariance[0, 0])) / slope**2, departure


def _advice(with_dark: bool, departure: float, below_full: bool, zero_dn: float) -> list[Advice]:
    advice: list[Advice] = []
    if not with_dark:
        unknown = "bias and read noise" if np.isfinite(zero_dn) else "bias, read noise, full well and response"
        text = f"no dark pair of the shortest exposure: {unknown} are unknown"
        advice.append(Advice("no-dark", text, "add two frames with the lens covered, shortest exposure"))
    if departure > NOT_LINEAR:
        text = f"variances depart by up to {departure:.0%} from a line"
        advice.append(Advice("not-linear", text, "use even light, no automatic gain, and raw frames"))
    if below_full:
        text = "no level reached saturation: the full well is unknown"
        advice.append(Advice("no-full-well", text, "add brighter pairs"))
    return advice


def _level(pair: FlatPair) -> tuple[float, float, float, int]:
    """Return the mean, the variance of one frame, the variance of the fixed pattern, and the number of pixels. Outliers
    (hot pixels, cosmic rays) are excluded."""
    first, second = np.asarray(pair.first, float), np.asarray(pair.second, float)
    if first.shape != second.shape or first.ndim != 2:
        raise BadInput(
            "the two frames of a pair have different sizes", expected=str(first.shape), got=str(second.shape)
        )
    # Scale one frame to the level of the other, because the lamp can change between the frames.
    second = second * (np.median(first) / np.median(second)) if np.median(second) > 0 else second
    difference, mean = first - second, (first + second) / 2
    keep = _unstray(difference) & _unstray(mean)
    variance = float(np.var(difference[keep])) / 2
    pattern = max(float(np.var(mean[keep])) - variance / 2, 0.0)
    return float(mean[keep].mean()), variance, pattern, int(keep.sum())


def _unstray(values: Array) -> NDArray[np.bool_]:
    middle = np.median(values)
    # The median deviation of differences of integers is often zero.
    spread = max(1.4826 * float(np.median(np.abs(values - middle))), MIN_SPREAD_DN)
    return np.asarray(np.abs(values - middle) < CLIP_SIGMAS * spread)


def _clips(pair: FlatPair, saturation_dn: float | None) -> bool:
    return saturation_dn is not None and float(np.mean(np.asarray(pair.first) >= saturation_dn)) > 1e-3


def _rising(signal: Array, variance: Array) -> NDArray[np.bool_]:
    """Return a mask of the levels before the variance decreases."""
    order = np.argsort(signal)
    highest, good = 0.0, np.ones(len(signal), bool)
    for k in order:
        if variance[k] < TURN_SHARE * highest:
            good[k] = False
        highest = max(highest, float(variance[k]))
    low = signal[~good].min() if (~good).any() else np.inf
    return np.asarray(signal < low)


def _response(levels: list[tuple[float, float, float, int]], signal: Array) -> float:
    """Return the spread of the response, measured at the brightest level, where noise affects the pattern least."""
    if not len(signal) or signal.max() <= 0:
        return float("nan")
    k = int(np.argmax(signal))
    return float(np.sqrt(levels[k][2]) / signal[k])
