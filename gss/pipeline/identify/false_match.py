"""Probability that an identification is accidental (a false match).

The bound is the expected number of pointings that would have at least as many coincidences between predicted and
detected stars if the detections were scattered at random. It is the product of a binomial tail from the positions, an
independent factor from the brightness, and the number of tried hypotheses.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betainc, chdtr

from gss.domain.angles import Array

SMALLEST = 1e-300
LEVELS = 30


def brightness_tail(observed_mag: Array, catalogue_mag: Array, spread_mag: float) -> float:
    """Return the probability that randomly chosen stars agree in relative brightness as well as these pairs.

    ``spread_mag``: standard deviation of a random difference, from the catalogue in view and the detections. The zero
    point is fitted. The result is at most 1, so poor photometry cannot make a good match worse.
    """
    m = len(observed_mag)
    if m < 2 or not spread_mag > 0:
        return 1.0
    difference = np.asarray(observed_mag) - catalogue_mag
    quadratic = float(np.sum((difference - difference.mean()) ** 2)) / spread_mag**2
    return float(np.clip(chdtr(m - 1, quadratic), SMALLEST, 1.0))


def match_tail(at_least: int, trials: int, chance: float, brightness: float) -> float:
    """Return the probability that the product of coincidence tail and brightness tail is as small as the observed
    product.

    For a discrete tail T_k and an independent uniform brightness tail b, P(T·b ≤ x) ≤ x (1 + number of k with T_k > x),
    because P(count = k) ≤ T_k. For continuous tails, the corresponding formula is Fisher's x (1 − ln x), which would be
    too pessimistic here.
    """
    met = max(at_least, 0)
    if met > trials:
        return 1.0
    counts = np.arange(max(met, 1), min(trials, met + LEVELS) + 1)
    tails = np.asarray(betainc(counts, trials - counts + 1.0, min(max(chance, 0.0), 1.0)))
    if met == 0:
        tails = np.concatenate([[1.0], tails])
    product = max(float(tails[0]) * brightness, SMALLEST)
    above = int((tails > product).sum())
    levels = met + (trials - met if above == len(tails) else above)
    return float(min(1.0, product * (1 + levels)))


def not_credible(matched: int, stars: int, probability: float, limit: float, where: str = "") -> str:
    """Return the reason why a best candidate with ``matched`` of the ``stars`` was not accepted. ``where``: restriction of the
    search."""
    return (
        f"no credible match: the best candidate{where and f' {where}'} has {matched} of {stars} stars and a false-match "
        f"probability of {probability:.1e} (limit {limit:.0e})"
    )


def false_match_probability(hypotheses: float, tail: float) -> float:
    """Return an upper bound on the probability that at least one of the tried hypotheses is this good by chance.

    A search that can stop early counts the hypotheses up to each candidate. The bound then applies to the candidate, and
    that of the whole search is larger by the factor in ``anchor_search.Trial``.
    """
    return float(min(1.0, max(hypotheses, 1.0) * tail))
