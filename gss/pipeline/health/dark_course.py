"""Dark current of a detector as a function of temperature and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gss.domain.angles import Array
from gss.pipeline.calibration.dark_temperature import EXPONENT_K
from gss.pipeline.calibration.robust import fit_linear
from gss.pipeline.health.trend import DAY_S, TIME_GAIN, Z95, Estimate

ZERO_C_K = 273.15
EXPONENTS_K = EXPONENT_K * np.geomspace(0.4, 2.2, 41)
REFINEMENTS = 4
CLIP_SIGMAS = 5.0
MIN_KELVIN = 5.0
MIN_SAMPLES = 20


@dataclass(frozen=True)
class DarkCourse:
    """Dark current of the typical pixel: ``at_reference_e_s`` at ``reference_c`` and the middle of the mission, growth
    per year relative to it, and the temperature increase that doubles it. ``law_known``: False if the temperatures do
    not determine the law. In this case the figures are NaN, and ``factor`` uses the law of silicon."""

    reference_c: float
    exponent_k: float
    law_known: bool
    at_reference_e_s: Estimate
    doubling_k: Estimate
    growth_per_year: Estimate

    def factor(self, temperature_c: ArrayLike) -> Array:
        """Return the dark current at temperatures relative to that at the reference; 1 if a temperature is unknown."""
        t = np.asarray(temperature_c, float)
        return np.where(np.isfinite(t), _law(self.exponent_k, t, self.reference_c), 1.0)


def _law(exponent_k: float, temperature_c: Array, reference_c: float) -> Array:
    """Return the dark current relative to that at the reference (Jacobs 1995 eq. H.1–H.2)."""
    step = 1 / (reference_c + ZERO_C_K) - 1 / (np.asarray(temperature_c) + ZERO_C_K)
    return np.asarray(np.exp(exponent_k * step))


def dark_course(
    times_s: Array, temperature_c: Array, exposure_s: Array, level_dn: Array, noise_dn: Array, e_per_dn: float
) -> DarkCourse:
    """Fit (n,) sky levels by a constant, light proportional to the exposure, and dark current, which follows the diode
    law and grows linearly with time."""
    good = np.isfinite(temperature_c) & np.isfinite(level_dn)
    t, warm = times_s[good], temperature_c[good]
    nothing = Estimate(float("nan"), float("nan"), float("nan"))
    reference_c = float(np.mean(warm)) if good.any() else float("nan")
    if np.count_nonzero(good) < MIN_SAMPLES or np.ptp(warm) < MIN_KELVIN:
        return DarkCourse(reference_c, EXPONENT_K, False, nothing, nothing, nothing)
    years = (t - (t[0] + t[-1]) / 2) / (365.25 * DAY_S)
    exposure, level = exposure_s[good], level_dn[good]
    sigma = np.maximum(noise_dn[good] / 30.0, 1e-3)
    sky = [exposure] if np.ptp(exposure) > 0.2 * float(np.median(exposure)) else []
    fits = []
    exponents = EXPONENTS_K
    for _ in range(REFINEMENTS):
        fits = [
            fit_linear(np.column_stack([d, d * years, np.ones(len(t)), *sky]), level, sigma)
            for d in (exposure * _law(e, warm, reference_c) for e in exponents)
        ]
        # Deviations are limited to the rejection threshold. Otherwise a law that rejects more frames would have an
        # advantage.
        chi2 = np.array([np.sum(np.minimum(np.abs(f.residual / sigma), CLIP_SIGMAS * f.sigma) ** 2) for f in fits])
        k = int(np.argmin(chi2))
        if not 0 < k < len(exponents) - 1:
            return DarkCourse(reference_c, EXPONENT_K, False, nothing, nothing, nothing)
        near = np.flatnonzero(chi2 <= chi2[k] * (1 + TIME_GAIN / max(1, len(t) - 5)))
        if len(near) > len(exponents) // 4:
            break
        exponents = np.linspace(
            exponents[max(0, near.min() - 1)], exponents[min(len(exponents) - 1, near.max() + 1)], len(exponents)
        )
    edges = exponents[[near.min(), near.max()]]
    fit = fits[k]
    constants, growths = np.array([f.coefficients[:2] for f in fits])[near].T
    dark, growth = (float(c) for c in fit.coefficients[:2])
    if not constants.min() > 0:
        return DarkCourse(reference_c, EXPONENT_K, False, nothing, nothing, nothing)
    spread = Z95 * float(np.sqrt(fit.covariance[0, 0]))
    relative, of_ratio = growths / constants, np.array([-growth / dark, 1.0]) / dark
    relative_spread = Z95 * float(np.sqrt(of_ratio @ fit.covariance[:2, :2] @ of_ratio))
    doubling = np.log(2) * (reference_c + ZERO_C_K) ** 2 / np.array([exponents[k], edges[1], edges[0]])
    return DarkCourse(
        reference_c,
        float(exponents[k]),
        True,
        Estimate(
            dark * e_per_dn,
            float(constants.min() - spread) * e_per_dn,
            float(constants.max() + spread) * e_per_dn,
        ),
        Estimate(*(float(d) for d in doubling)),
        Estimate(growth / dark, float(relative.min()) - relative_spread, float(relative.max()) + relative_spread),
    )
