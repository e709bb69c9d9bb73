"""Name everything else that was seen: once the attitude is proved, each remaining detection is compared with the whole catalogue.

A detection gets a name when exactly one star fits it in place and in brightness, no companion spoils it, and a star would
be there by chance in less than one of some hundred cases. The proof of the attitude is not touched by this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.pipeline.identify.flux_line import FluxLine, flux_line
from gss.pipeline.identify.verify import Sky, in_view
from gss.pipeline.refine import Refined, prediction_sigma_px
from gss.pipeline.small import distances2, median

Rows = NDArray[np.intp]
Refit = Callable[[Rows, Rows, Array], Refined]

ROUNDS = 2
LEAST_NAMED = 3
GATE_SIGMA = 3.5
LEAST_FOR_EXCESS = 8
MEDIAN_SQUARE = 1.386  # median of the squared length of a two-dimensional normal deviate
CHANCE_EXCESS = 1.3
FLOOR_PX = 0.05  # lens calibration and proper motion that no error budget holds
MAX_GATE_PX = 4.0
MAX_EXCESS_PX = 1.0  # matches that scatter more beyond their own errors were made by wide gates, not by stars
BRIGHTNESS_SIGMA = 3.5
PROVED_WINDOW_MAG = 1.8  # for stars of the identification: saturation and colour may dim or brighten them
CHANCE = 5e-4
CROWDED = 0.05  # more stars than that in a gate: no place tells one from another
OWN_SHARE = 0.65  # of the light at its place that must be a star's own
BLEND_REACH_SIGMA = 4.0
COMPARABLE = 0.5  # of a star's light: a companion with which it can melt into one detection between the two
FEW_PAIRS = 20_000  # so many distances are computed sooner than a tree is built
UNRESOLVED_SIGMA = 2.8
RESOLVED = 0.28  # of the way to such a companion: nearer to the star than that, the detection is the star's own


@dataclass(frozen=True)
class Spots:
    """Detections to name: (n, 2) pixels, their errors per axis, magnitudes of any zero point, and the point-spread
    function's width, shared by all."""

    pixels: Array
    sigma_px: Array
    magnitude: Array
    psf_sigma_px: float

    @property
    def magnitude_sigma(self) -> Array:
        """(n,) photon and sky noise: a position known to a share of the width has a flux known to about that share."""
        return np.asarray(1.0857 * np.minimum(self.sigma_px / self.psf_sigma_px, 0.5))


@dataclass(frozen=True)
class Named:
    """Rows of the detections with the rows of the sky they are, the fit on all of them, and (m,) chance of each match."""

    rows: Rows
    stars: Rows
    fit: Refined
    chance: Array


@dataclass(frozen=True)
class _Expected:
    """Stars that may show, as the frame should show them: rows of the sky, pixels, errors of these, brightness with
    companions (V), (m, 2) displacement by them, the share of the light that is the star's own, and how far from its
    place a detection may be and still be this star alone and not its blend with an equal."""

    stars: Rows
    pixels: Array
    sigma_px: Array
    v_mag: Array
    shift_px: Array
    share: Array
    reach_px: Array


def name_the_rest(spots: Spots, sky: Sky, fit: Refined, rows: Rows, stars: Rows, refit: Refit) -> Named | None:
    """Match all detections, given a proved ``fit`` and its matches (``rows`` of the spots are ``stars`` of the sky).

    ``sky`` is the whole table, brightest first. ``refit(rows, stars, sigma_px)`` fits attitude, and camera where it is free,
    to all matches. Proved matches are judged like the others, but in a wider window of brightness. None where fewer than half of
    them pass or all scatter: then the place on the sky may be right, but the geometry is not.
    """
    proved = np.full(len(spots.pixels), -1, np.intp)
    proved[rows] = stars
    named = Named(rows, stars, fit, np.zeros(len(rows)))
    for _ in range(ROUNDS):
        line = flux_line(spots.magnitude[named.rows], sky.v_mag[named.stars], spots.magnitude_sigma[named.rows])
        expected = _expect(spots, sky, named.fit, line)
        excess = _excess_px(spots, named)
        found, which, chance = _assign(spots, expected, line, max(excess, FLOOR_PX), proved, named.fit)
        if len(found) < max(LEAST_NAMED, len(rows) // 2):
            return None
        shift2 = (expected.shift_px[which] ** 2).sum(1)
        settled = _same(found, named.rows) and _same(expected.stars[which], named.stars)
        if settled and not excess and not shift2.any():
            named = replace(named, chance=chance)  # the fit at hand is of these stars with these errors
            break
        sigma = np.sqrt(spots.sigma_px[found] ** 2 + shift2 + excess**2)
        named = Named(found, expected.stars[which], refit(found, expected.stars[which], sigma), chance)
        if settled:
            break
    return named if named.fit.rms_px <= np.hypot(MAX_EXCESS_PX, float(np.median(spots.sigma_px))) else None


def _same(a: Rows, b: Rows) -> bool:
    return len(a) == len(b) and bool((a == b).all())


def _excess_px(spots: Spots, named: Named) -> float:
    """Scatter of the matches so far beyond their own errors, per axis: what the calibration leaves. 0 within chance."""
    good = named.fit.weight > 0
    if good.sum() < LEAST_FOR_EXCESS:
        return 0.0
    squares = (named.fit.residual_px[good] ** 2).sum(1)
    own2 = median(spots.sigma_px[named.rows[good]] ** 2)
    return float(np.sqrt(max(median(squares) / MEDIAN_SQUARE - CHANCE_EXCESS * own2, 0.0)))


def _expect(spots: Spots, sky: Sky, fit: Refined, line: FluxLine) -> _Expected:
    """The catalogue down to the faintest detection, on the detector, with what companions do to each star."""
    faintest = float((line.v_mag(spots.magnitude) + BRIGHTNESS_SIGMA * line.sigma(spots.magnitude)).max())
    brighter = int(np.searchsorted(sky.v_mag, min(faintest + 1.0, float(sky.v_mag[-1])), side="right"))
    part = Sky(sky.hip[:brighter], sky.icrs[:brighter], sky.v_mag[:brighter])
    stars, pixels = in_view(part, fit.camera, fit.cam_from_icrs, MAX_GATE_PX)
    own = 10 ** (-0.4 * (sky.v_mag[stars] - 5))
    light, shift, reach = own.copy(), np.zeros((len(stars), 2)), np.full(len(stars), MAX_GATE_PX)
    a, b = _close(pixels, pixels, BLEND_REACH_SIGMA * spots.psf_sigma_px)
    a, b = a[a != b], b[a != b]
    if len(a):
        offset = pixels[b] - pixels[a]
        # How much a second Gaussian adds to the matched filter of the first, and where it draws its fitted middle.
        overlap = own[b] * np.exp(-(offset**2).sum(1) / (4 * spots.psf_sigma_px**2))
        np.add.at(light, a, overlap)
        np.add.at(shift, a, overlap[:, None] * offset)
        equal = own[b] > COMPARABLE * own[a]
        apart = np.linalg.norm(offset[equal], axis=1)
        np.minimum.at(reach, a[equal], np.where(apart > UNRESOLVED_SIGMA * spots.psf_sigma_px, RESOLVED * apart, 0.0))
    v_mag = 5 - 2.5 * np.log10(light)
    return _Expected(
        stars,
        pixels,
        prediction_sigma_px(fit, sky.icrs[stars]),
        v_mag,
        shift / light[:, None],
        own / light,
        reach,
    )


def _assign(
    spots: Spots, expected: _Expected, line: FluxLine, extra_px: float, proved: Rows, fit: Refined
) -> tuple[Rows, Rows, Array]:
    """Unambiguous (spot, expected star) pairs, spots in ascending order, and the chance of each."""
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
    known = (proved[s] == expected.stars[e]) & (difference <= PROVED_WINDOW_MAG) & ~bright
    window = np.where(known, PROVED_WINDOW_MAG, window)
    fits = (bright | known) & (expected.share[e] >= OWN_SHARE)
    s, e, gate, window = s[fits], e[fits], gate[fits], window[fits]
    chance = _chance(s, e, gate, window, expected, len(spots.pixels), fit)
    rivals = np.bincount(s, minlength=len(spots.pixels))[s] + np.bincount(e, minlength=len(expected.stars))[e]
    ok = np.flatnonzero((rivals == 2) & (chance <= CHANCE))
    order = ok[np.argsort(s[ok], kind="stable")]
    return s[order], e[order], chance[order]


def _close(first: Array, second: Array, within_px: float) -> tuple[Rows, Rows]:
    """Rows of (n, 2) and (m, 2) pixels that are near each other."""
    if len(first) * len(second) <= FEW_PAIRS:
        a, b = np.nonzero(distances2(first, second) <= within_px**2)
        return a, b
    close = cKDTree(second).query_ball_point(first, within_px)
    rows = np.repeat(np.arange(len(first)), [len(c) for c in close])
    return rows, np.concatenate([np.asarray(c, np.intp) for c in close]) if len(rows) else np.zeros(0, np.intp)


def _chance(s: Rows, e: Rows, gate: Array, window: Array, expected: _Expected, spots: int, fit: Refined) -> Array:
    """(pairs,) probability that a detection which is no catalogue star meets one that fits: how many detections may be
    such strangers, times the stars of that brightness in a gate of that size."""
    ranked = np.sort(expected.v_mag)
    v = expected.v_mag[e]
    among = np.searchsorted(ranked, v + window, side="right") - np.searchsorted(ranked, v - window)
    meets = np.minimum(among * np.pi * gate**2 / (fit.camera.columns * fit.camera.rows), 1.0)
    typical = median(meets) if len(meets) else 0.0
    unexplained = spots - len(np.unique(s)) + 1
    strangers = min(1.0, unexplained / (spots + 1) / max(1 - typical, 0.1))
    return np.asarray(np.where(meets <= CROWDED, strangers * meets, 1.0))
