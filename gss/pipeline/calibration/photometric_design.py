"""Star measurements of all frames as arrays, and the linear fit of magnitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.stars import Ids
from gss.pipeline.calibration.robust import Linear, fit_linear
from gss.pipeline.calibration.sightings import FrameStars

COLOUR_RANGE = 0.4  # smallest spread of colours that determines a colour term
FOURTH_POWER_STARS = 100
AREA_ROUNDS = 8
MAG = 2.5 / float(np.log(10))


@dataclass(frozen=True)
class Light:
    """Measurements of the n stars of all frames. ``peak_dn``: above the sky; ``rho``: distance from the optical centre
    divided by the distance of the farthest corner. ``below_dn``: n·Δth of eq. C.1."""

    frame: NDArray[np.intp]
    hip: Ids
    v_mag: Array
    b_v: Array
    flux_dn: Array
    peak_dn: Array
    exposure_s: Array
    rho: Array
    below_dn: Array
    clipped: NDArray[np.bool_]

    def instrumental_mag(self, k_area: float) -> Array:
        """Return −2.5·log₁₀ of the brightness per second, NaN if it is not positive."""
        flux = self.flux_dn + k_area * self.below_dn
        return -2.5 * np.log10(np.where(flux > 0, flux, np.nan) / self.exposure_s)


def corner_radius(camera: Camera) -> float:
    """Return the distance from the optical centre to the farthest corner, in pixels of the column axis."""
    aspect = camera.focal_col_px / camera.focal_row_px
    col = max(camera.centre_col_px + 0.5, camera.columns - 0.5 - camera.centre_col_px)
    row = max(camera.centre_row_px + 0.5, camera.rows - 0.5 - camera.centre_row_px) * aspect
    return float(np.hypot(col, row))


def light_of(frames: Sequence[FrameStars], camera: Camera, threshold_dn: float | Sequence[float]) -> Light:
    """Concatenate the stars of all frames. An unknown exposure is replaced by 1 s, and an unknown colour by the Sun's
    B−V of 0.6."""
    thresholds = (
        [float(threshold_dn)] * len(frames)
        if isinstance(threshold_dn, int | float)
        else [float(t) for t in threshold_dn]
    )
    if len(thresholds) != len(frames):
        raise BadInput(
            "the number of thresholds differs from the number of frames",
            expected=str(len(frames)),
            got=str(len(thresholds)),
        )
    if not frames:
        raise BadInput("no frames", expected="at least one solved frame", got="0")
    aspect = camera.focal_col_px / camera.focal_row_px
    pixels = np.concatenate([f.pixels for f in frames])
    rho = np.hypot(pixels[:, 0] - camera.centre_col_px, (pixels[:, 1] - camera.centre_row_px) * aspect)
    counts = [len(f) for f in frames]
    exposure = [f.exposure_s if f.exposure_s > 0 else 1.0 for f in frames]
    b_v = np.concatenate([f.b_v for f in frames])
    return Light(
        np.repeat(np.arange(len(frames)), counts),
        np.concatenate([f.hip for f in frames]),
        np.concatenate([f.v_mag for f in frames]),
        np.where(np.isfinite(b_v), b_v, 0.6),
        np.concatenate([f.flux_dn for f in frames]),
        np.concatenate([f.peak_dn - f.sky_dn for f in frames]),
        np.repeat(exposure, counts),
        rho / corner_radius(camera),
        np.concatenate([f.area_px * t for f, t in zip(frames, thresholds, strict=True)]),
        np.concatenate([f.saturated for f in frames]),
    )


def measure(light: Light, usable: NDArray[np.bool_]) -> tuple[Linear, float, tuple[str, ...]]:
    """Return the robust fit, k_area, and the names of its coefficients: zero; colour and powers of ρ if the stars
    determine them; area if a threshold was subtracted and k_area is positive."""
    names = ["zero"]
    if np.ptp(np.percentile(light.b_v[usable], [10, 90])) > COLOUR_RANGE:
        names.append("colour")
    if np.percentile(light.rho[usable], 90) > 0.5:
        names.append("rho2")
    if usable.sum() >= FOURTH_POWER_STARS and np.percentile(light.rho[usable], 95) > 0.8:
        names.append("rho4")
    areas = bool(np.any(light.below_dn[usable] > 0))
    columns = {"zero": np.ones(len(light.v_mag)), "colour": light.b_v, "rho2": light.rho**2, "rho4": light.rho**4}
    base = np.column_stack([columns[n][usable] for n in names])
    k_area = 0.0
    fit = fit_linear(base, (light.v_mag - light.instrumental_mag(k_area))[usable])
    if "rho4" in names and abs(fit.coefficients[-1]) < 3 * np.sqrt(fit.covariance[-1, -1]):
        names.pop()
        base = base[:, :-1]
        fit = fit_linear(base, (light.v_mag - light.instrumental_mag(k_area))[usable])
    if not areas:
        return fit, 0.0, tuple(names)
    for _ in range(AREA_ROUNDS):
        flux = (light.flux_dn + k_area * light.below_dn)[usable]
        slope = -MAG * light.below_dn[usable] / flux
        with_area = fit_linear(np.column_stack([base, slope]), (light.v_mag - light.instrumental_mag(k_area))[usable])
        k_area = max(0.0, k_area + float(with_area.coefficients[-1]))
    return (with_area, k_area, (*names, "area")) if k_area > 0 else (fit, 0.0, tuple(names))


def frame_variance(frame: NDArray[np.intp], error_mag: Array) -> float:
    """Return the variance of the mean of (n,) errors that is due to different light in different frames (haze), beyond the
    scatter of the stars. Zero if there is one frame or one star per frame, from which it cannot be determined."""
    _, index, stars = np.unique(frame, return_inverse=True, return_counts=True)
    n, frames = len(error_mag), len(stars)
    if not 1 < frames < n:
        return 0.0
    means = np.bincount(index, error_mag) / stars
    within = float(np.sum((error_mag - means[index]) ** 2)) / (n - frames)
    between = float(np.sum(stars * (means - error_mag.mean()) ** 2))
    share = float(np.sum(stars**2)) / n
    return max(0.0, between - (frames - 1) * within) / (n - share) * share / n
