"""Stars of a solved frame that the chain rejected because of their residual.

A chain identifies a star only if its residual is small. Where the lens has an error, these are the stars whose noise
cancels the error, so the mean residual of the identified stars is too small. An estimate of a lens error therefore also
uses the rejected stars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.results import Matches, SolveResult
from gss.domain.stars import StarTable
from gss.pipeline.calibration.robust import robust_sigma

REACH_SIGMAS = 15.0
"""Largest residual of a rejected star, in units of the scatter of the identified stars."""
ALONE_PX = 6.0
"""Distance to the next star and to the next detection within which a detection is not paired with a star."""


@dataclass(frozen=True)
class SeenStars:
    """k stars of one frame. ``pixels`` (k, 2): measured positions; ``residual_px`` (k, 2): measured − predicted;
    ``weight`` (k,): weight in the attitude, 0 for rejected stars; ``hip`` (k,); ``sigma_px`` (k,): position errors."""

    pixels: Array
    residual_px: Array
    weight: Array
    hip: NDArray[np.int32]
    sigma_px: Array

    def with_others(self, others: SeenStars) -> SeenStars:
        """Return these stars followed by other stars of the same frame."""
        pairs = [(getattr(self, f.name), getattr(others, f.name)) for f in fields(self)]
        return SeenStars(*(np.concatenate(p) for p in pairs))


def identified_stars(result: SolveResult, matches: Matches) -> SeenStars:
    """Return the stars that the chain identified."""
    spots = result.centroids
    return SeenStars(
        spots.pixels[matches.centroid],
        matches.residual_px,
        matches.weight,
        matches.hip,
        spots.sigma_px[matches.centroid],
    )


def reach_of(results: Sequence[SolveResult | None]) -> float:
    """Return the largest residual in pixels up to which a detection is paired with a star."""
    residuals = [
        r.matches.residual_px[r.matches.weight > 0] for r in results if r is not None and r.matches is not None
    ]
    return REACH_SIGMAS * robust_sigma(np.concatenate(residuals).ravel()) if residuals else 0.0


def rejected_stars(result: SolveResult, stars: StarTable, reach_px: float) -> SeenStars:
    """Return the detections that are not identified but near exactly one star, with weight 0. ``stars``: apparent places
    at the frame, of all stars that it can show. Stars fainter than the faintest identified star are not returned, because
    they may be missing in the chain's catalogue, and their errors differ."""
    assert result.matches is not None  # noqa: S101 - the caller has checked that the frame is solved
    assert result.attitude is not None  # noqa: S101 - the caller has checked that the frame is solved
    identified = np.isin(stars.hip, result.matches.hip[result.matches.weight > 0])
    faintest_mag = float(np.max(stars.v_mag[identified], initial=-np.inf))
    others = np.setdiff1d(np.arange(len(result.centroids)), result.matches.centroid)
    cam = stars.icrs @ result.attitude.cam_from_icrs.T
    ahead = np.flatnonzero(cam[:, 2] > np.cos(min(result.camera.half_diagonal_rad + 0.02, 1.5)))
    expected = result.camera.project(cam[ahead])
    places = result.centroids.pixels
    pairs = []
    for d in others.tolist():
        distance = np.linalg.norm(expected - places[d], axis=1)
        s = int(np.argmin(distance)) if len(distance) else -1
        if s < 0 or distance[s] > reach_px or stars.v_mag[ahead[s]] > faintest_mag:
            continue
        if _crowded(expected, expected[s]) or _crowded(places, places[d]):
            continue
        pairs.append((d, s))
    spot, star = np.array(pairs, np.intp).reshape(-1, 2).T
    return SeenStars(
        places[spot],
        places[spot] - expected[star],
        np.zeros(len(spot)),
        stars.hip[ahead[star]].astype(np.int32),
        result.centroids.sigma_px[spot],
    )


def _crowded(places: Array, at: Array) -> bool:
    """True if more than one of the (n, 2) places is near a place."""
    return int(np.count_nonzero(np.linalg.norm(places - at, axis=1) < ALONE_PX)) > 1
