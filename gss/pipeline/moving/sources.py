"""Fit of a group of pixels as a point or a line, and removal of sources that are parts of a line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.sensor import Sensor
from gss.pipeline.moving.groups import PixelGroup
from gss.pipeline.moving.line_fit import LINE, POINT, WIDTH, Cutout, LineFit, cut_out, fit_line

MIN_SNR = 5.0
LONGER, LENGTH_SIGMA = 25.0, 3.0
"""Minimum improvement of χ² by a line over a point."""
MIN_LINE_LENGTH = 2.0
"""Minimum length of a line in widths of the point-spread function."""
LONG_WIDTHS = 5.0
"""Length, in widths of the point-spread function, above which a line is fitted again from longer first guesses."""
PIECE_WIDTHS = 2.0
STRETCHES = (1.0, 1.5, 2.2)
FIRST_REACHES = (0.65, 1.3, 2.6)
"""Half widths of the cut-out as multiples of a group's length. A star on the trail divides it into groups; if an end of
the line is outside the first cut-out, the pixels do not determine it, and the next one is used."""
REACH = 1.3
"""Half width of the cut-out of a long line, as a multiple of the length of the line."""
SHARPER = 25.0
SHARP_SHARE = 0.6
"""A source did not come through the lens if its width is below this share of the width of stars and the narrower width
improves χ² by this value."""
MAX_HALF_PX = 150


@dataclass(frozen=True)
class Source:
    """Fitted group: middle pixel, point or line fit, longest trail that agrees with the fit, and True if narrower than stars."""

    pixel: tuple[int, int]
    fit: LineFit
    longest_px: float
    sharp: bool


def fitted_source(
    images: tuple[NDArray[np.float32], NDArray[np.float32]],
    noise: float,
    group: PixelGroup,
    ceiling: float,
    sensor: Sensor,
    variance: float,
) -> Source | None:
    """Fit a group as a point and a line; None if neither is significant. ``images``: with and without stars."""
    image, free_image = images
    length = float(np.hypot(*group.trail))
    trail = group.trail if length > 1 else np.array([1.0, 0.5])
    for reach, picture in zip(FIRST_REACHES, (image, free_image, free_image), strict=True):
        half = int(min(np.ceil(4 * np.sqrt(variance) + reach * length), MAX_HALF_PX))
        cut = cut_out(picture, noise, group.col, group.row, half, ceiling, sensor.gain_e_per_dn)
        point = fit_line(cut, np.array([group.flux_dn, 0.0, 0.0, 0.0, 0.0, variance]), POINT)
        line = fit_line(cut, np.array([group.flux_dn, 0.0, 0.0, *trail, variance]), LINE)
        if line is not None or length <= MIN_LINE_LENGTH * np.sqrt(variance):
            break
    best, longest = point, 0.0
    free: tuple[int, ...] = POINT
    if line is not None:
        longest = line.length_px + LENGTH_SIGMA * line.length_sigma_px
        significant = point is None or (point.chi2 - line.chi2) / line.excess > LONGER
        if significant and line.length_px > MIN_LINE_LENGTH * np.sqrt(variance):
            best, free = line, LINE
            if line.length_px > LONG_WIDTHS * np.sqrt(variance):
                cut, best = _whole_line(free_image, noise, group, line, ceiling, sensor, variance) or (cut, best)
                half = max(half, int(np.ceil(REACH * line.length_px)))
                longest = best.length_px + LENGTH_SIGMA * best.length_sigma_px
    if best is None or best.snr < MIN_SNR or np.abs(best.centre_px).max() > half:
        return None
    return Source((group.col, group.row), best, longest, _is_sharp(cut, best, free, variance))


def _whole_line(
    image: NDArray[np.float32],
    noise: float,
    group: PixelGroup,
    line: LineFit,
    ceiling: float,
    sensor: Sensor,
    variance: float,
) -> tuple[Cutout, LineFit] | None:
    """Fit a long line again, on more pixels and from longer first guesses, because only part of a faint trail exceeds
    the threshold. The centre stays relative to the group. None if no fit succeeds."""
    half = int(min(np.ceil(4 * np.sqrt(variance) + REACH * line.length_px), MAX_HALF_PX))
    cut = cut_out(image, noise, group.col, group.row, half, ceiling, sensor.gain_e_per_dn)
    fits = []
    for stretch in STRETCHES:
        for shift in (-0.5, 0.0, 0.5) if stretch > 1 else (0.0,):
            centre = line.centre_px + shift * (stretch - 1) * line.trail_px
            start = np.array([stretch * line.flux_dn, *centre, *(stretch * line.trail_px), variance])
            fit = fit_line(cut, start, LINE)
            if fit is not None:
                fits.append(fit)
    return (cut, min(fits, key=lambda f: f.chi2)) if fits else None


def without_pieces(sources: list[Source], variance: float) -> list[Source]:
    """Drop sources that are parts of a brighter line: a faint trail can exceed the threshold in several pieces."""
    complete: list[Source] = []
    margin_px = PIECE_WIDTHS * float(np.sqrt(variance))
    for source in sorted(sources, key=lambda s: -s.fit.flux_dn):
        centre = np.array(source.pixel) + source.fit.centre_px
        for line in complete:
            length = line.fit.length_px
            if length <= LONG_WIDTHS * np.sqrt(variance):
                continue
            off, along = centre - np.array(line.pixel) - line.fit.centre_px, line.fit.trail_px / length
            beside = abs(float(along[0] * off[1] - along[1] * off[0]))
            if beside < margin_px and abs(float(along @ off)) < length / 2 + margin_px:
                break
        else:
            complete.append(source)
    return complete


def _is_sharp(cut: Cutout, fit: LineFit, free: tuple[int, ...], variance: float) -> bool:
    start = np.array([fit.flux_dn, *fit.centre_px, *fit.trail_px, variance])
    with_width = fit_line(cut, start, (*free, WIDTH))
    if with_width is None:
        return True  # all the light is in one pixel, which does not determine a width
    better = (fit.chi2 - with_width.chi2) / with_width.excess
    return bool(with_width.variance_px2 < SHARP_SHARE**2 * variance and better > SHARPER)
