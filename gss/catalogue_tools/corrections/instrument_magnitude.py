"""Magnitude of a star as seen by a camera. The star is treated as a blackbody of its colour, seen through the camera's
spectral response (Liebe 1992, "Correction to CCD-sensitivity"). The light lost towards the edge of the field is added
(ibid.).

The constant C of the document is set so that a star of B−V = 0 has the same magnitude in both systems.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.response import SpectralResponse, response_of
from gss.domain.stars import StarTable

# Planck's hc/k, in nanometres times kelvin.
HC_OVER_K_NM_K = 1.438776877e7
# Outside this range, a blackbody does not represent a star. For example, carbon stars are redder.
B_V_RANGE = (-0.4, 2.5)
ROLL_OFFS = ("off", "average", "worst")
GRID_STEPS = 581
# Johnson's V passband for energy, 470 to 700 nm in steps of 10 nm (Bessell 1990, PASP 102, 1181, Table 2).
V_WAVELENGTH_NM = np.arange(470.0, 701.0, 10.0)
V_PASSBAND = (
    0.000, 0.030, 0.163, 0.458, 0.780, 0.967, 1.000, 0.973, 0.898, 0.792, 0.684, 0.574,
    0.461, 0.359, 0.270, 0.197, 0.135, 0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0.000,
)  # fmt: skip
WAVELENGTH_NM = np.arange(300.0, 1201.0, 2.0)


def temperature_k(b_v: Array | float) -> Array:
    """Blackbody temperature of a colour index (Ballesteros 2012, EPL 97, 34008, eq. 14); colours are clipped to
    B_V_RANGE."""
    reduced = 0.92 * np.clip(np.asarray(b_v, float), *B_V_RANGE)
    return np.asarray(4600.0 * (1 / (reduced + 1.7) + 1 / (reduced + 0.62)))


def planck(wavelength_nm: Array, kelvin: Array) -> Array:
    """Return the (n, m) spectral exitance of n temperatures at m wavelengths, in a common unit."""
    exponent = HC_OVER_K_NM_K / (np.asarray(wavelength_nm)[None, :] * np.asarray(kelvin)[:, None])
    return np.asarray(1 / (np.asarray(wavelength_nm)[None, :] ** 5 * np.expm1(exponent)))


def instrument_minus_v(b_v: Array, response: SpectralResponse, unknown_b_v: float) -> Array:
    """Return the correction to add to V of each star. Stars with the colour NaN get ``unknown_b_v``."""
    grid, correction = _table(response)
    colour = np.where(np.isnan(b_v), unknown_b_v, b_v)
    return np.asarray(np.interp(colour, grid, correction))


def as_seen_by(stars: StarTable, profile: CameraProfile) -> StarTable:
    """Return the table with the magnitude of the camera instead of V (Liebe 1992, "Correction to CCD-sensitivity"). Stars
    without a colour index are white, which is the zero point of the magnitude."""
    return replace(stars, v_mag=stars.v_mag + instrument_minus_v(stars.b_v, response_of(profile), 0.0))


def roll_off_mag(profile: CameraProfile, which: str) -> float:
    """Return the light loss of the lens in magnitudes: the average over the detector or the value in the corner.

    The loss grows with the square of the distance from the optical centre (``Defects.corner_loss``).
    """
    if which not in ROLL_OFFS:
        raise BadInput("unknown lens roll-off", expected=" | ".join(ROLL_OFFS), got=which)
    if which == "off":
        return 0.0
    loss = profile.defects.corner_loss
    if which == "average":
        loss *= _mean_square_share(profile)
    if not loss < 1:
        raise BadInput("the lens transmits no light to the corner", expected="a corner loss below 1", got=f"{loss:g}")
    return float(-2.5 * np.log10(1 - loss))


def _mean_square_share(profile: CameraProfile) -> float:
    """Return the mean of r² over the detector, divided by r² of the farthest corner."""
    camera = profile.camera
    centres = (camera.centre_col_px, camera.centre_row_px)
    spans = [(-0.5 - c, n - 0.5 - c) for n, c in zip((camera.columns, camera.rows), centres, strict=True)]
    mean = sum((b**3 - a**3) / (3 * (b - a)) for a, b in spans)
    return float(mean / sum(max(abs(a), abs(b)) ** 2 for a, b in spans))


@lru_cache(maxsize=32)
def _table(response: SpectralResponse) -> tuple[Array, Array]:
    """Return colour indices and the instrument magnitude minus V for each."""
    b_v = np.linspace(*B_V_RANGE, GRID_STEPS)
    light = planck(WAVELENGTH_NM, temperature_k(np.append(b_v, 0.0)))
    instrument = light @ response.at(WAVELENGTH_NM)
    visual = light @ np.interp(WAVELENGTH_NM, V_WAVELENGTH_NM, V_PASSBAND, left=0.0, right=0.0)
    ratio = instrument / visual
    return b_v, -2.5 * np.log10(ratio[:-1] / ratio[-1])
