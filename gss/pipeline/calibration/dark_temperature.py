"""Dark current against temperature: the diode law and its doubling temperature (Jacobs 1995 eq. H.1–H.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import fit_linear

EXPONENT_K = 6374.0  # V_BG·q/2k with a band gap of 1.1 V
EV_PER_K = 2 * 8.617333e-5


@dataclass(frozen=True)
class DarkLaw:
    """Law of the dark current: ``at_reference_e_s``·exp(``exponent_k``·(1/``reference_k`` − 1/T)). ``band_gap_ev``:
    band gap that corresponds to the exponent. ``doubling_k``: temperature increase that doubles the dark current at the
    reference. ``residual``: (n,) measured over fitted − 1."""

    at_reference_e_s: float
    reference_k: float
    exponent_k: float
    exponent_sigma_k: float
    band_gap_ev: float
    doubling_k: float
    doubling_sigma_k: float
    residual: Array
    warnings: tuple[Advice, ...]

    def dark_e_s(self, temperature_k: ArrayLike) -> Array:
        """Return the dark current in electrons per second at a temperature."""
        step = 1 / self.reference_k - 1 / np.asarray(temperature_k, float)
        return np.asarray(self.at_reference_e_s * np.exp(self.exponent_k * step))


def dark_against_temperature(temperature_k: Array, dark_e_s: Array, relative_sigma: Array | None = None) -> DarkLaw:
    """Fit the law to (n,) temperatures in kelvin and positive dark currents. Needs at least three points over at least 5 K."""
    t, dark = np.asarray(temperature_k, float), np.asarray(dark_e_s, float)
    if len(t) != len(dark) or len(t) < 3 or np.ptp(t) < 5 or not (dark > 0).all() or not (t > 150).all():
        raise BadInput(
            "these points do not determine a dark-current law",
            expected="three or more dark currents above zero at temperatures in kelvin that span 5 K",
            got=f"{len(t)} points over {np.ptp(t) if len(t) else 0:.1f} K",
        )
    reference = float(1 / np.mean(1 / t))
    design = np.column_stack([np.ones(len(t)), 1 / reference - 1 / t])
    fit = fit_linear(design, np.log(dark), relative_sigma)
    level, exponent = (float(c) for c in fit.coefficients)
    sigma = float(np.sqrt(fit.covariance[1, 1]))
    # d(ln D)/dT = exponent / T².
    doubling = float(np.log(2)) * reference**2 / exponent if exponent > 0 else float("inf")
    advice: list[Advice] = []
    if not 0.4 * EXPONENT_K < exponent < 2.2 * EXPONENT_K:
        text = f"the exponent is {exponent:.0f} K; silicon has {EXPONENT_K:.0f} to twice that"
        advice.append(
            Advice("law", text, "check that the temperature is that of the detector and that the bias was subtracted")
        )
    return DarkLaw(
        float(np.exp(level)),
        reference,
        exponent,
        sigma,
        exponent * EV_PER_K,
        doubling,
        doubling * sigma / abs(exponent) if exponent else float("nan"),
        np.expm1(fit.residual),
        tuple(advice),
    )
