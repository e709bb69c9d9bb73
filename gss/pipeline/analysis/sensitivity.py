"""Detection limit: share of the catalogue stars in the field that were detected, as a function of magnitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.experiment import share_interval
from gss.pipeline.calibration.advice import Advice

FEWEST = 30
BIN_MAG = 0.25
ROUNDS = 50
RIDGE = 1e-6


@dataclass(frozen=True)
class Sensitivity:
    """Detection limit of a camera. ``mag_50`` ± ``sigma_50``: magnitude at which half of the stars are detected, NaN
    if not more than half of the bright stars are; ``mag_90``: magnitude at which nine of ten stars are detected;
    ``width_mag``: difference between both magnitudes. ``ceiling``: detected share of bright stars, which is below 1 if
    stars are missed at every magnitude. For each of k bins with the edges ``edges_mag`` (k+1,): numbers of ``stars``
    and of detected stars (``found``), and the bounds ``low``, ``high`` of the 95 % interval of the detected share."""

    mag_50: float
    sigma_50: float
    mag_90: float
    width_mag: float
    ceiling: float
    edges_mag: Array
    stars: NDArray[np.intp]
    found: NDArray[np.intp]
    low: Array
    high: Array
    warnings: tuple[Advice, ...]


def detection_limit(v_mag: Array, detected: NDArray[np.bool_]) -> Sensitivity:
    """Fit a logistic curve with a ceiling by maximum likelihood to (n,) catalogue magnitudes of stars on the detector
    and an (n,) mask of the detected stars. Raises BadInput with fewer than thirty stars, or if all or none were
    detected."""
    v, hit = np.asarray(v_mag, float), np.asarray(detected, bool)
    if len(v) < FEWEST or hit.all() or not hit.any():
        raise BadInput(
            "the limit cannot be determined",
            expected=f"{FEWEST} stars on both sides of it",
            got=f"{len(v)} stars, {int(hit.sum())} found",
            hint="use more frames, and a catalogue with fainter stars than the camera detects",
        )
    bright = hit[v <= np.quantile(v[hit], 0.3)]
    ceiling = float(np.clip(bright.mean(), 0.5, 1.0)) if len(bright) else 1.0
    level, slope, covariance = _logistic(v, hit, ceiling)
    mag_50 = _at(level, slope, 0.5 / ceiling)
    mag_90 = _at(level, slope, 0.9 / ceiling) if ceiling > 0.9 else float("nan")
    # mag_50 = (logit(0.5 / ceiling) − level) / slope
    gradient = np.array([-1 / slope, -mag_50 / slope])
    sigma = float(np.sqrt(max(gradient @ covariance @ gradient, 0.0)))
    edges = np.arange(np.floor(v.min() / BIN_MAG), np.ceil(v.max() / BIN_MAG) + 1) * BIN_MAG
    stars = np.histogram(v, edges)[0].astype(np.intp)
    detected_stars = np.histogram(v[hit], edges)[0].astype(np.intp)
    limits = np.array(
        [share_interval(int(s), int(n)) if n else (np.nan, np.nan) for s, n in zip(detected_stars, stars, strict=True)]
    )
    advice: list[Advice] = []
    if ceiling < 0.95:
        text = f"only {100 * ceiling:.0f} % even of the bright stars were found"
        advice.append(
            Advice("ceiling", text, "check for clouds, double stars, saturated stars or stars at the edge of the field")
        )
    if mag_50 > v.max() - 0.5:
        advice.append(
            Advice("shallow", "the limit is at the end of the catalogue", "use a catalogue with fainter stars", True)
        )
    return Sensitivity(
        mag_50,
        sigma,
        mag_90,
        mag_50 - mag_90,
        ceiling,
        edges,
        stars,
        detected_stars,
        limits[:, 0],
        limits[:, 1],
        tuple(advice),
    )


def _logistic(v: Array, hit: NDArray[np.bool_], ceiling: float) -> tuple[float, float, Array]:
    """Fit p = ceiling / (1 + exp(−(level + slope·V))) by Fisher scoring. Return level, slope and their (2, 2)
    covariance."""
    middle = float(v.mean())
    design = np.column_stack([np.ones(len(v)), v - middle])
    beta = np.array([0.0, -2.0])
    information = np.eye(2)
    for _ in range(ROUNDS):
        q = expit(design @ beta)
        p = np.clip(ceiling * q, 1e-9, 1 - 1e-9)
        slope = ceiling * q * (1 - q)
        weight = slope**2 / (p * (1 - p))
        information = design.T @ (design * weight[:, None]) + RIDGE * np.eye(2)
        step = np.linalg.solve(information, design.T @ ((hit - p) * slope / (p * (1 - p))))
        beta = beta + np.clip(step, -3, 3)
        if np.abs(step).max() < 1e-10:
            break
    covariance = np.linalg.inv(information)
    shift = np.array([[1.0, -middle], [0.0, 1.0]])
    level = float(beta[0] - beta[1] * middle)
    return level, float(min(beta[1], -1e-3)), shift @ covariance @ shift.T


def _at(level: float, slope: float, share: float) -> float:
    """Return the magnitude at which the curve reaches a share of the ceiling."""
    if not 0 < share < 1:
        return float("nan")
    return float((np.log(share / (1 - share)) - level) / slope)
