"""Optimum star width. Sharp stars are undersampled, and wide stars have a lower signal-to-noise ratio (Moniteq 1983
§4.2, Huffman 2006 §4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.calibration.robust import fit_linear

MONITEQ_GOOD = (2.0, 2.5)  # pixel over σ, with a window of three pixels
WINDOWS = (3, 5, 7, 9)
MAX_PX = 1000.0
FARTHEST = 1e6


@dataclass(frozen=True)
class FocusAdvice:
    """Advice on the focus. ``pixel_over_sigma``: d/σ of Moniteq. ``verdict``: "sharp", "good" or "soft".
    ``best_sigma_px``: width with the smallest total error of a mean locator at ``snr``. ``snr``: signal-to-noise ratio
    of the brightest pixel of a star with the same light and a width of σ = 1 px; NaN: the width is taken from Moniteq's
    range. ``interpolation_px``: error from sampling alone (rms over sub-pixel positions, best window); ``error_px``:
    error from sampling and noise."""

    sigma_px: float
    pixel_over_sigma: float
    verdict: str
    best_sigma_px: float
    good_range_px: tuple[float, float]
    window_px: int
    interpolation_px: float
    error_px: float
    text: str
    hint: str


def focus_advice(sigma_px: float, snr: float = float("nan")) -> FocusAdvice:
    """Return advice on the focus for stars of a measured ``sigma_px``."""
    if not 0 < sigma_px < 50:
        raise BadInput("this is not a valid width of a star", expected="σ above 0 px", got=f"{sigma_px:g} px")
    low, high = 1 / MONITEQ_GOOD[1], 1 / MONITEQ_GOOD[0]
    best = (low + high) / 2
    if np.isfinite(snr):
        widths = np.geomspace(0.25, 5.0, 60)
        errors = np.array([centroid_error_px(float(w), snr)[0] for w in widths])
        best = float(widths[int(np.argmin(errors))])
        # In Huffman's curve, a range of widths has an error within a tenth of the minimum.
        flat = widths[errors < 1.1 * errors.min()]
        low, high = float(flat.min()), float(flat.max())
    error, window = centroid_error_px(sigma_px, snr)
    verdict = "sharp" if sigma_px < low else "soft" if sigma_px > high else "good"
    text = f"σ {sigma_px:.2f} px, pixel over σ {1 / sigma_px:.2f}; best {low:.2f}–{high:.2f} px"
    hint = {
        "sharp": f"defocus until σ is {best:.2f} px: centroids jump towards pixel centres",
        "good": "leave it",
        "soft": f"focus until σ is {best:.2f} px: the light spreads over more noise than it needs",
    }[verdict]
    interpolation = interpolation_error_px(sigma_px, window)
    return FocusAdvice(sigma_px, 1 / sigma_px, verdict, best, (low, high), window, interpolation, error, text, hint)


def interpolation_error_px(sigma_px: float, window: int) -> float:
    """Return the error of a mean locator on noiseless spots, rms over sub-pixel positions, in a window of ``window``
    columns around the brightest column (Moniteq 1983 eq. 4.8, by direct summation)."""
    offset = np.linspace(-0.5, 0.5, 41)
    column = np.arange(window) - (window - 1) / 2
    share = ndtr((column[:, None] + 0.5 - offset) / sigma_px) - ndtr((column[:, None] - 0.5 - offset) / sigma_px)
    error = (column[:, None] * share).sum(axis=0) / share.sum(axis=0) - offset
    return float(np.sqrt(np.mean(error**2)))


def centroid_error_px(sigma_px: float, snr: float) -> tuple[float, int]:
    """Return (error per axis, window) of the best window, for a star whose brightest pixel has ``snr`` at σ 1 px. The
    error contains sampling and read-out noise, but not shot noise. If ``snr`` is NaN, it contains only sampling."""
    peak_share = float(np.diff(ndtr(np.array([-0.5, 0.5])))[0]) ** 2
    best = (np.inf, WINDOWS[0])
    for window in WINDOWS:
        systematic = interpolation_error_px(sigma_px, window)
        noise = 0.0
        if np.isfinite(snr):
            column = np.arange(window) - (window - 1) / 2
            inside = float(ndtr(window / 2 / sigma_px) - ndtr(-window / 2 / sigma_px)) ** 2
            # The noise is √(Σp² over the window plus the typical sub-pixel offset), divided by the light inside the
            # window.
            spread = window * float(np.sum(column**2)) + window**2 / 12
            noise = float(np.sqrt(spread)) * peak_share / max(snr, 1e-9) / inside
        total = float(np.hypot(systematic, noise))
        if total < best[0]:
            best = (total, window)
    return best


@dataclass(frozen=True)
class BestFocus:
    """Sharpest position in a series of focus settings, and the positions on both sides at which σ has the desired
    value; NaN if it is not reached."""

    position: float
    position_sigma: float
    smallest_sigma_px: float
    wished_sigma_px: float
    wished_positions: tuple[float, float]


def best_focus(position: Array, sigma_px: Array, wished_sigma_px: float = 0.45) -> BestFocus:
    """Compute the best focus from (n ≥ 4) lens settings on both sides and the measured widths, by fitting a parabola to σ²."""
    x, width = np.asarray(position, float), np.asarray(sigma_px, float)
    if len(x) < 4 or len(x) != len(width):
        raise BadInput("too few settings of the focus", expected="4 or more with their widths", got=str(len(x)))
    _check_run(x, width)
    s2 = width**2
    middle, reach = float(x.mean()), float(np.ptp(x))
    u = (x - middle) / reach
    fit = fit_linear(np.column_stack([np.ones(len(u)), u, u * u]), s2)
    c, b, a = (float(k) for k in fit.coefficients)
    if a <= 0:
        raise BadInput(
            "the widths have no minimum between these settings",
            expected="settings on both sides of the focus",
            got="no turn",
            hint="use settings further from the focus",
        )
    best = -b / (2 * a)
    slope = np.array([0.0, -1 / (2 * a), b / (2 * a * a)])
    sigma = float(np.sqrt(max(slope @ fit.covariance @ slope, 0.0))) * reach
    minimum = c - b * b / (4 * a)
    reach2 = (wished_sigma_px**2 - minimum) / a
    side = float(np.sqrt(reach2)) if reach2 >= 0 else float("nan")
    best_position = middle + reach * best
    return BestFocus(
        best_position,
        sigma,
        float(np.sqrt(max(minimum, 0.0))),
        wished_sigma_px,
        (best_position - reach * side, best_position + reach * side),
    )


def _check_run(position: Array, sigma_px: Array) -> None:
    ok = np.isfinite(sigma_px) & (sigma_px > 0) & (sigma_px <= MAX_PX)
    if not ok.all():
        expected = f"σ above 0 px, at most {MAX_PX:g} px"
        raise BadInput("this is not a valid width of a star", expected=expected, got=f"{sigma_px[~ok][0]:g} px")
    if not (np.abs(position) <= FARTHEST).all():
        raise BadInput(
            "this is not a valid focus setting of a lens", expected=f"within ±{FARTHEST:g}", got=f"{position}"
        )
    if len(np.unique(position)) < 3:
        raise BadInput(
            "too few different settings of the focus", expected="3 or more", got=str(len(np.unique(position)))
        )
    if np.ptp(sigma_px) <= 1e-9 * sigma_px.max():
        raise BadInput(
            "the widths are all equal",
            expected="widths that change with the setting",
            got=f"{sigma_px[0]:g} px at every setting",
            hint="use settings further from the focus on both sides",
        )
