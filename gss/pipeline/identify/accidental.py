"""Expected number of accidental identifications for hypotheses that result from votes (CubeStar's chain)."""

from __future__ import annotations

import numpy as np
from scipy.special import bdtrc

PAIR = 2


def chance_within(stars_per_sr: float, radius_rad: float) -> float:
    """Return the probability that a random direction is within ``radius_rad`` of a star, for ``stars_per_sr``."""
    return min(1.0, float(stars_per_sr * np.pi * radius_rad**2))


def tracking_hypotheses(centroids: int, stars_per_sr: float, tolerance_rad: float, radius_rad: float) -> float:
    """Return the expected number of centroid pairs that by chance are within the radius of predicted stars and have
    their separation."""
    same_distance = min(1.0, 1.1 * tolerance_rad / radius_rad)
    return centroids * (centroids - 1) / 2 * chance_within(stars_per_sr, radius_rad) ** 2 * same_distance


def accidental_bound(hypotheses: float, identified: int, centroids: int, chance: float) -> float:
    """Return an upper bound on the expected number of accidental identifications with at least ``identified`` stars.

    A pair of centroids defines a hypothesis. Each other centroid then coincides with a star with probability
    ``chance``. The bound is hypotheses x P(binomial(centroids − 2, chance) ≥ identified − 2), at most 1.
    """
    other_centroids = 1.0 if identified <= PAIR else float(bdtrc(identified - 3, centroids - PAIR, chance))
    return float(min(1.0, hypotheses * other_centroids))
