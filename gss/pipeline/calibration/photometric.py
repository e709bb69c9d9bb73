"""Photometric calibration: zero point, colour, vignetting, linearity, saturation (Jacobs 1995 §6.3, app. C.1).

V = −2.5·log₁₀(flux / exposure) + zero point + colour·(B−V) + vignetting is fitted to the matched stars of many frames,
without outliers and variable stars. ``flux`` is the summed brightness, plus Jacobs' k_area·n·Δth if a threshold was
subtracted (eq. C.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.stars import Ids
from gss.domain.words import counted
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.histogram import Histogram, histogram
from gss.pipeline.calibration.photometric_design import MAG, Light, corner_radius, frame_variance, light_of, measure
from gss.pipeline.calibration.robust import Linear, fit_linear, robust_sigma
from gss.pipeline.calibration.screening import CLOUD_MAG, frame_offsets_mag
from gss.pipeline.calibration.sightings import FrameStars

ILLUMINANCE_V0_LUX = 2.65e-6
MIN_STARS = 15
BAR_MAG = 0.1  # Jacobs 1995 Fig. 6-9
LINEAR = 0.02


@dataclass(frozen=True)
class PhotometricCalibration:
    """Photometric calibration of a camera. ``zero_point_mag``: V of one DN per second, B−V = 0, on axis, with a σ that
    includes differences between the frames; ``zero_point_dn_s``: DN per second of V = 0, and ``zero_point_e_s`` in
    electrons (NaN without gain). ``k_illum_lux_per_dn``: illuminance per summed brightness at ``exposure_s`` (eq. C.2,
    6.24). ``k_area``: eq. C.1, 0 with σ NaN if no threshold was given or the fitted value is negative.

    ``vignetting``: light = 1 + v₂ρ² + v₄ρ⁴, where ρ is the distance from the optical centre divided by the distance of
    the corner; ``corner_loss`` = 1 − light at ρ = 1, 0 with σ NaN if all stars are near the centre. ``linearity``:
    change of measured magnitude per catalogue magnitude, 1 = linear. ``saturation_mag``: V of a star whose peak reaches
    ``saturation_dn``, NaN if unknown. ``sigma_mag``: standard deviation of measured − catalogue; ``robust_sigma_mag``:
    the same from the median. ``frame_offset_mag``: (frames,) light of each frame relative to the median frame, negative
    if light was lost. Per star, ``error_mag``: measured − catalogue, ``used``: in the fit.
    """

    zero_point_mag: float
    zero_point_sigma_mag: float
    zero_point_dn_s: float
    zero_point_e_s: float
    k_illum_lux_per_dn: float
    exposure_s: float
    k_area: float
    k_area_sigma: float
    colour_mag_per_mag: float
    colour_sigma: float
    vignetting: tuple[float, float]
    corner_loss: float
    corner_loss_sigma: float
    linearity: float
    linearity_sigma: float
    saturation_dn: float
    saturation_mag: float
    sigma_mag: float
    robust_sigma_mag: float
    histogram: Histogram
    frame_offset_mag: Array
    frame: NDArray[np.intp]
    hip: Ids
    v_mag: Array
    b_v: Array
    error_mag: Array
    used: NDArray[np.bool_]
    warnings: tuple[Advice, ...]

    def magnitude(self, flux_dn: Array, exposure_s: float, b_v: Array | float = 0.0) -> Array:
        """Return the V magnitude of on-axis stars with flux ``flux_dn``."""
        instrumental = -2.5 * np.log10(np.asarray(flux_dn, float) / exposure_s)
        return np.asarray(instrumental + self.zero_point_mag + self.colour_mag_per_mag * np.asarray(b_v))


def calibrate_photometry(
    frames: Sequence[FrameStars],
    camera: Camera,
    *,
    threshold_above_dark_dn: float | Sequence[float] = 0.0,
    gain_e_per_dn: float = float("nan"),
    limits_mag: tuple[float, float] | None = None,
) -> PhotometricCalibration:
    """Calibrate the photometry from the matched stars of frames.

    ``threshold_above_dark_dn``: Δth of eq. C.1, one value for all frames or one per frame. ``limits_mag``: brightest
    and faintest V of the fit. Raises BadInput with fewer than 15 usable stars.
    """
    warnings: list[Advice] = []
    offsets = frame_offsets_mag(frames)
    light = light_of(frames, camera, threshold_above_dark_dn)
    usable = _usable(light, offsets, limits_mag, warnings)
    if usable.sum() < MIN_STARS:
        raise BadInput(
            "too few stars with a flux and a magnitude",
            expected=f"{MIN_STARS}, not saturated and not dimmed by clouds",
            got=str(int(usable.sum())),
            hint="use more frames, or centroids with fluxes",
        )
    fit, k_area, names = measure(light, usable)
    value = dict(zip(names, fit.coefficients.tolist(), strict=True))
    sigma = dict(zip(names, np.sqrt(np.diag(fit.covariance)).tolist(), strict=True))
    powers = [k for k, name in enumerate(names) if name in ("rho2", "rho4")]
    if powers:
        # At the corner, ρ² = ρ⁴ = 1. The coefficients have a correlation near −1.
        sigma["corner"] = float(np.sqrt(fit.covariance[np.ix_(powers, powers)].sum()))
    error = _error_mag(light, fit, k_area, names)
    used = usable.copy()
    used[usable] = fit.used
    sigma["zero"] = float(np.sqrt(sigma["zero"] ** 2 + frame_variance(light.frame[used], error[used])))
    slope, slope_sigma = _linearity(light.v_mag[used], error[used], warnings)
    return _result(
        light, frames, offsets, value, sigma, k_area, error, used, (slope, slope_sigma), gain_e_per_dn, warnings
    )


def _usable(
    light: Light, offsets: Array, limits_mag: tuple[float, float] | None, warnings: list[Advice]
) -> NDArray[np.bool_]:
    good = np.isfinite(light.flux_dn) & (light.flux_dn > 0) & np.isfinite(light.v_mag)
    clipped = good & light.clipped
    if good.any() and clipped.sum() > 0.2 * good.sum():
        text = f"{int(clipped.sum())} of {int(good.sum())} stars are clipped and were left out"
        warnings.append(Advice("saturated", text, "expose shorter, or point away from bright stars"))
    dim = np.flatnonzero(offsets < -CLOUD_MAG)
    if len(dim):
        text = f"{counted(len(dim), 'frame')} left out: more than {CLOUD_MAG} mag of light lost"
        warnings.append(Advice("clouds", text, "repeat under a clear sky"))
    good &= ~light.clipped & ~np.isin(light.frame, dim)
    if limits_mag is not None:
        good &= (light.v_mag >= limits_mag[0]) & (light.v_mag <= limits_mag[1])
    return np.asarray(good)


def _error_mag(light: Light, fit: Linear, k_area: float, names: tuple[str, ...]) -> Array:
    """Return the (n,) measured − catalogue magnitudes of all stars, NaN without a flux."""
    columns = {"zero": np.ones(len(light.v_mag)), "colour": light.b_v, "rho2": light.rho**2, "rho4": light.rho**4}
    model = sum(c * columns[n] for n, c in zip(names, fit.coefficients.tolist(), strict=True) if n in columns)
    return np.asarray(light.instrumental_mag(k_area) + model - light.v_mag)


def _linearity(v_mag: Array, error_mag: Array, warnings: list[Advice]) -> tuple[float, float]:
    if len(v_mag) < MIN_STARS or np.ptp(v_mag) < 1.0:
        warnings.append(
            Advice(
                "linearity",
                "the stars' magnitudes are too similar to determine the linearity",
                "include brighter and fainter stars",
            )
        )
        return float("nan"), float("nan")
    fit = fit_linear(np.column_stack([np.ones(len(v_mag)), v_mag - v_mag.mean()]), error_mag)
    slope, sigma = float(fit.coefficients[1]), float(np.sqrt(fit.covariance[1, 1]))
    if abs(slope) > max(LINEAR, 4 * sigma):
        text = f"measured magnitudes change by {1 + slope:.3f} per magnitude"
        hint = "check for a threshold or background subtracted with the star, clipped peaks, or a nonlinear converter"
        warnings.append(Advice("linearity", text, hint))
    return 1 + slope, sigma


def _result(
    light: Light,
    frames: Sequence[FrameStars],
    offsets: Array,
    value: dict[str, float],
    sigma: dict[str, float],
    k_area: float,
    error: Array,
    used: NDArray[np.bool_],
    linearity: tuple[float, float],
    gain_e_per_dn: float,
    warnings: list[Advice],
) -> PhotometricCalibration:
    zero = value["zero"]
    dn_s = float(10 ** (0.4 * zero))
    exposure_s = float(np.median(light.exposure_s))
    corner_light = float(10 ** (0.4 * (value.get("rho2", 0.0) + value.get("rho4", 0.0))))
    # Vignetting dims a star, so its magnitude needs a negative correction.
    v2, v4 = _as_light(value.get("rho2", 0.0), value.get("rho4", 0.0))
    saturation_dn, saturation_mag = _saturation(light, frames, used, zero, exposure_s)
    used_errors = error[used]
    return PhotometricCalibration(
        zero,
        sigma["zero"],
        dn_s,
        dn_s * gain_e_per_dn,
        ILLUMINANCE_V0_LUX / (dn_s * exposure_s),
        exposure_s,
        k_area,
        sigma.get("area", float("nan")),
        value.get("colour", 0.0),
        sigma.get("colour", float("nan")),
        (v2, v4),
        1 - corner_light,
        corner_light * sigma.get("corner", float("nan")) / MAG,
        *linearity,
        saturation_dn,
        saturation_mag,
        float(used_errors.std(ddof=1)),
        robust_sigma(used_errors),
        histogram(used_errors, "measured − catalogue, mag", BAR_MAG),
        offsets,
        light.frame,
        light.hip,
        light.v_mag,
        light.b_v,
        error,
        used,
        tuple(warnings),
    )


def _as_light(rho2_mag: float, rho4_mag: float) -> tuple[float, float]:
    """Convert a polynomial in magnitudes to the best-fitting polynomial in light."""
    rho = np.linspace(0, 1, 50)
    light = 10 ** (0.4 * (rho2_mag * rho**2 + rho4_mag * rho**4))
    if rho4_mag == 0:
        return float(np.sum((light - 1) * rho**2) / np.sum(rho**4)), 0.0
    v2, v4 = np.linalg.lstsq(np.column_stack([rho**2, rho**4]), light - 1, rcond=None)[0]
    return float(v2), float(v4)


def _saturation(
    light: Light, frames: Sequence[FrameStars], used: NDArray[np.bool_], zero: float, exposure_s: float
) -> tuple[float, float]:
    """Return the peak level of saturation, and the V magnitude at which a typical star reaches this level above the typical
    sky at the typical exposure."""
    limit = min((f.saturation_dn for f in frames), default=float("inf"))
    share = light.peak_dn[used] / light.flux_dn[used]
    share = share[np.isfinite(share) & (share > 0)]
    above_dn = limit - float(np.median([f.sky_dn for f in frames]))
    if not np.isfinite(limit) or not len(share) or above_dn <= 0:
        return float("nan") if not np.isfinite(limit) else limit, float("nan")
    flux_dn = above_dn / float(np.percentile(share, 75))
    return limit, float(zero - 2.5 * np.log10(flux_dn / exposure_s))


__all__ = ["PhotometricCalibration", "calibrate_photometry", "corner_radius"]
