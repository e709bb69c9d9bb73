"""Matching of all detections: once the attitude is verified, each detection is compared with the whole catalogue.

A detection is matched if exactly one star fits its position and brightness, no companion affects it, and the probability
of a chance coincidence is about 1 % or less. This does not affect the verification of the attitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.pipeline.identify.flux_line import FluxLine, flux_line
from gss.pipeline.identify.verify import SkyCatalogue, in_view
from gss.pipeline.refine import Refined, prediction_sigma_px
from gss.pipeline.small import distances2, median

Rows = NDArray[np.intp]
Refit = Callable[[Rows, Rows, Array], Refined]

ROUNDS = 2
MIN_MATCHES = 3
GATE_SIGMA = 3.5
MIN_FOR_EXCESS = 8
MEDIAN_SQUARE = 1.386  # median of the squared length of a two-dimensional normal deviate
ERROR_MARGIN = 1.3
FLOOR_PX = 0.05  # errors of lens calibration and proper motion that are not in the error budget
FIT_FLOOR_PX = 0.01  # least error of a position in the fit
MAX_GATE_PX = 4.0
MAX_EXCESS_PX = 1.0  # if the excess scatter is larger, the matches are accidental matches in wide gates
BRIGHTNESS_SIGMA = 3.5
VERIFIED_WINDOW_MAG = 1.8  # wide, because saturation and colour change the brightness of verified stars
MAX_CHANCE = 5e-4
CROWDED = 0.05  # if more stars are expected in a gate, the position does not identify a star
OWN_SHARE = 0.65  # minimum share of the light at a star's position that comes from the star
BLEND_REACH_SIGMA = 4.0
COMPARABLE = 0.5  # minimum flux ratio at which a companion and a star can blend into one detection between them
FEW_PAIRS = 20_000  # up to this number, computing all distances is faster than building a tree
UNRESOLVED_SIGMA = 2.8
RESOLVED = 0.28  # a detection closer to the star than this fraction of the companion's distance is the star


@dataclass(frozen=True)
class Spots:
    """Detections to match: (n, 2) pixels, their errors per axis, magnitudes with an arbitrary zero point, and the common
    width of the point-spread function."""

    pixels: Array
    sigma_px: Array
    magnitude: Array
    psf_sigma_px: float

    @property
    def magnitude_sigma(self) -> Array:
        """Return the (n,) magnitude errors from photon and sky noise. Assumes that the relative flux error equals the
        position error divided by the PSF width."""
        return np.asarray(1.0857 * np.minimum(self.sigma_px / self.psf_sigma_px, 0.5))


@dataclass(frozen=True)
class AllMatches:
    """Result of the matching: rows of the detections, their stars' rows in the catalogue, and the fit to all matches."""

    rows: Rows
    stars: Rows
    fit: Refined


@dataclass(frozen=True)
class _Expected:
    """m stars that can be detected, with their expected appearance. ``stars``: rows in the catalogue. ``catalogue_mag``: V
    magnitude. ``v_mag``: V magnitude including companions. ``shift_px``: (m, 2) displacement by companions. ``share``:
    fraction of the light that comes from the star. ``reach_px``: maximum distance of a detection; a more distant
    detection could be a blend with a comparable companion."""

    stars: Rows
    pixels: Array
    sigma_px: Array
    catalogue_mag: Array
    v_mag: Array
    shift_px: Array
    share: Array
    reach_px: Array


def match_all(
    spots: Spots, sky: SkyCatalogue, fit: Refined, rows: Rows, stars: Rows, refit: Refit
) -> AllMatches | None:
    """Match all detections, given a verified ``fit`` and its matches (``rows`` of the spots are ``stars`` of the sky).

    ``sky`` is the whole catalogue, brightest first. ``refit(rows, stars, sigma_px)`` fits the attitude, and the camera
    if it is free, to all matches. Verified matches are tested in the same way, but with a wider brightness window.
    Returns None if the number of matches is less than half the number of verified stars, or if the residuals are too
    large. In this case the camera geometry is wrong, although the pointing can be correct.
    """
    verified = np.full(len(spots.pixels), -1, np.intp)
    verified[rows] = stars
    matched = AllMatches(rows, stars, fit)
    for _ in range(ROUNDS):
        line = flux_line(spots.magnitude[matched.rows], sky.v_mag[matched.stars], spots.magnitude_sigma[matched.rows])
        expected = _expect(spots, sky, matched.fit, line)
        excess = _excess_px(spots, matched)
        spot_rows, star_rows = _assign(spots, expected, line, max(excess, FLOOR_PX), verified, matched.fit)
        if len(spot_rows) < max(MIN_MATCHES, len(rows) // 2):
            return None
        shift2 = (expected.shift_px[star_rows] ** 2).sum(1)
        converged = _same(spot_rows, matched.rows) and _same(expected.stars[star_rows], matched.stars)
        if converged and not excess and not shift2.any():
            break  # the current fit already uses these stars and errors
        sigma = np.sqrt(spots.sigma_px[spot_rows] ** 2 + shift2 + excess**2)
        matched = AllMatches(spot_rows, expected.stars[star_rows], refit(spot_rows, expected.stars[star_rows], sigma))
        if converged:
            break
    return matched if matched.fit.rms_px <= np.hypot(MAX_EXCESS_PX, float(np.median(spots.sigma_px))) else None


def _same(a: Rows, b: Rows) -> bool:
    return len(a) == len(b) and bool((a == b).all())


def _excess_px(spots: Spots, matched: AllMatches) -> float:
    """Return the scatter per axis that the errors of the matches do not explain, caused by calibration errors; 0 if it is not
    significant."""
    good = matched.fit.weight > 0
    if good.sum() < MIN_FOR_EXCESS:
        return 0.0
    squares = (matched.fit.residual_px[good] ** 2).sum(1)
    error2 = median(spots.sigma_px[matched.rows[good]] ** 2)
    return float(np.sqrt(max(median(squares) / MEDIAN_SQUARE - ERROR_MARGIN * error2, 0.0)))


def _expect(spots: Spots, sky: SkyCatalogue, fit: Refined, line: FluxLine) -> _Expected:
    """Return the catalogue stars on the detector down to the faintest detection, with the effect of companions on each."""
    faintest = float((line.v_mag(spots.magnitude) + BRIGHTNESS_SIGMA * line.sigma(spots.magnitude)).max())
    brighter = int(np.searchsorted(sky.v_mag, min(faintest + 1.0, float(sky.v_mag[-1])), side="right"))
    part = SkyCatalogue(sky.hip[:brighter], sky.icrs[:brighter], sky.v_mag[:brighter])
    stars, pixels = in_view(part, fit.camera, fit.cam_from_icrs, MAX_GATE_PX)
    star_light = 10 ** (-0.4 * (sky.v_mag[stars] - 5))
    light, shift, reach = star_light.copy(), np.zeros((len(stars), 2)), np.full(len(stars), MAX_GATE_PX)
    a, b = _close(pixels, pixels, BLEND_REACH_SIGMA * spots.psf_sigma_px)
    a, b = a[a != b], b[a != b]
    if len(a):
        offset = pixels[b] - pixels[a]
        # Light that a second Gaussian adds to the matched filter of the first Gaussian. This light also shifts the
        # fitted centre.
        overlap = star_light[b] * np.exp(-(offset**2).sum(1) / (4 * spots.psf_sigma_px**2))
        np.add.at(light, a, overlap)
        np.add.at(shift, a, overlap[:, None] * offset)
        equal = star_light[b] > COMPARABLE * star_light[a]
        apart = np.linalg.norm(offset[equal], axis=1)
        np.minimum.at(reach, a[equal], np.where(apart > UNRESOLVED_SIGMA * spots.psf_sigma_px, RESOLVED * apart, 0.0))
    v_mag = 5 - 2.5 * np.log10(light)
    return _Expected(
        stars,
        pixels,
        prediction_sigma_px(fit, sky.icrs[stars]),
        sky.v_mag[stars],
        v_mag,
        shift / light[:, None],
        star_light / light,
        reach,
    )


def _assign(
    spots: Spots, expected: _Expected, line: FluxLine, extra_px: float, verified: Rows, fit: Refined
) -> tuple[Rows, Rows]:
    """Return unambiguous (spot, expected star) pairs, spots in ascending order."""
    e, s = _close(expected.pixels, spots.pixels, MAX_GATE_PX)
    moved2 = (expected.shift_px[e] ** 2).sum(1)
    variance = spots.sigma_px[s] ** 2 + expected.sigma_px[e] ** 2 + moved2 / 4 + extra_px**2
    gate = np.minimum(GATE_SIGMA * np.sqrt(variance), MAX_GATE_PX)
    offset = spots.pixels[s] - expected.pixels[e]
    inside = ((offset - expected.shift_px[e]) ** 2).sum(1) <= gate**2
    inside &= (offset * offset).sum(1) <= expected.reach_px[e] ** 2
    s, e, gate = s[inside], e[inside], gate[inside]
    noise = np.hypot(line.sigma(spots.magnitude[s]), spots.magnitude_sigma[s])
    difference = np.abs(line.v_mag(spots.magnitude[s]) - expected.v_mag[e])
    window = BRIGHTNESS_SIGMA * noise
    bright = difference <= window
    same_star = (verified[s] == expected.stars[e]) & (difference <= VERIFIED_WINDOW_MAG) & ~bright
    window = np.where(same_star, VERIFIED_WINDOW_MAG, window)
    fits = (bright | same_star) & (expected.share[e] >= OWN_SHARE)
    s, e, gate, window = s[fits], e[fits], gate[fits], window[fits]
    chance = _chance(s, e, gate, window, expected, len(spots.pixels), fit)
    rivals = np.bincount(s, minlength=len(spots.pixels))[s] + np.bincount(e, minlength=len(expected.stars))[e]
    ok = np.flatnonzero((rivals == 2) & (chance <= MAX_CHANCE))
    order = ok[np.argsort(s[ok], kind="stable")]
    return s[order], e[order]


def _close(first: Array, second: Array, within_px: float) -> tuple[Rows, Rows]:
    """Return the row pairs of (n, 2) and (m, 2) pixels with a distance of at most ``within_px``."""
    if len(first) * len(second) <= FEW_PAIRS:
        a, b = np.nonzero(distances2(first, second) <= within_px**2)
        return a, b
    close = cKDTree(second).query_ball_point(first, within_px)
    rows = np.repeat(np.arange(len(first)), [len(c) for c in close])
    return rows, np.concatenate([np.asarray(c, np.intp) for c in close]) if len(rows) else np.zeros(0, np.intp)


def _chance(s: Rows, e: Rows, gate: Array, window: Array, expected: _Expected, spots: int, fit: Refined) -> Array:
    """Return the (pairs,) probabilities that a detection is not a catalogue star but fits the star by chance: the
    estimated share of such detections × the expected number of stars of this brightness in the gate; 1 in crowded
    fields."""
    ranked = np.sort(expected.catalogue_mag)
    v = expected.v_mag[e]
    among = np.searchsorted(ranked, v + window, side="right") - np.searchsorted(ranked, v - window)
    expected_stars = np.minimum(among * np.pi * gate**2 / (fit.camera.columns * fit.camera.rows), 1.0)
    typical = median(expected_stars) if len(expected_stars) else 0.0
    unexplained = spots - len(np.unique(s)) + 1
    false_share = min(1.0, unexplained / (spots + 1) / max(1 - typical, 0.1))
    return np.asarray(np.where(expected_stars <= CROWDED, false_share * expected_stars, 1.0))
