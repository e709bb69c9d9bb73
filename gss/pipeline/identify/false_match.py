"""How likely an identification is an accident.

The question is put before looking at the answer: of all the places tried on the sky, how many would show so many
coincidences between predicted and detected stars if the detections were scattered at random? Positions give a
binomial tail, brightness an independent second figure, and the number of places tried multiplies them.
"""

from __future__ import annotations

import numpy as np
from scipy.special import betainc, chdtr

from gss.domain.angles import Array

SMALLEST = 1e-300
LEVELS = 30


def binomial_tail(at_least: int, trials: int, chance: float) -> float:
    """Probability of at least that many successes in independent trials."""
    if at_least <= 0:
        return 1.0
    if at_least > trials:
        return 0.0
    if chance <= 0:
        return SMALLEST
    return max(float(betainc(at_least, trials - at_least + 1, min(chance, 1.0))), SMALLEST)


def brightness_tail(observed_mag: Array, catalogue_mag: Array, spread_mag: float) -> float:
    """Probability that stars picked at random agree in relative brightness as well as these pairs do.

    ``spread_mag``: standard deviation of a random difference, from the catalogue in view and the detections. The zero
    point is free. Never above 1, so poor photometry cannot spoil a good match, it only does not help.
    """
    m = len(observed_mag)
    if m < 2 or not spread_mag > 0:
        return 1.0
    difference = np.asarray(observed_mag) - catalogue_mag
    quadratic = float(np.sum((difference - difference.mean()) ** 2)) / spread_mag**2
    return float(np.clip(chdtr(m - 1, quadratic), SMALLEST, 1.0))


def match_tail(at_least: int, trials: int, chance: float, brightness: float) -> float:
    """Chance of a coincidence count and a brightness agreement whose product is as small as here.

    For a discrete tail T_k and an independent uniform brightness figure, P(T·b ≤ x) ≤ x (1 + number of k with T_k > x),
    because P(count = k) ≤ T_k. Fisher's x (1 − ln x) is the same for continuous figures, and needlessly dear here.
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


def false_match_probability(hypotheses: float, tail: float) -> float:
    """Upper bound of the chance that any of the hypotheses tried would look this good by accident."""
    return float(min(1.0, max(hypotheses, 1.0) * tail))
