"""How much of a lens a frame tells: focal length always, distortion only as far as the stars prove it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.pipeline.refine import Refined, refine

RADIAL = ("k1",)
FULL = ("k1", "k2", "p1", "p2")
FULL_HALF_DIAGONAL_RAD = np.radians(12.0)
FULL_STARS = 20
# χ² that coefficients of a perfect lens exceed once in 370 frames, by their number.
PROVED_CHI2 = {1: 9.0, 3: 14.16}


def fit_lens(pixels: Array, icrs: Array, sigma_px: Array, camera: Camera, cam_from_icrs: Array) -> Refined:
    """Attitude, focal length and the lens of an uncalibrated ``camera`` (with a Brown distortion) from (n, 2) pixels of
    (n, 3) stars. Coefficients that do not differ from 0 by more than their error are 0 and not fitted."""
    perfect = replace(camera, distortion=Brown())
    plain = refine(pixels, icrs, sigma_px, perfect, cam_from_icrs, fit_focal=True)
    radial = refine(pixels, icrs, sigma_px, perfect, cam_from_icrs, fit_focal=True, fit_lens=RADIAL)
    best = radial if proved(radial, RADIAL) else plain
    if camera.half_diagonal_rad > FULL_HALF_DIAGONAL_RAD and len(pixels) >= FULL_STARS:
        full = refine(pixels, icrs, sigma_px, camera, cam_from_icrs, fit_focal=True, fit_lens=FULL)
        if proved(full, FULL[1:]):
            best = full
    return best


def proved(fit: Refined, names: tuple[str, ...]) -> bool:
    """Whether these fitted coefficients together differ from 0 by more than chance."""
    at: NDArray[np.intp] = np.array([fit.parameters.index(n) for n in names], np.intp)
    value = np.array([getattr(fit.camera.distortion, n) for n in names])
    return float(value @ np.linalg.solve(fit.covariance[np.ix_(at, at)], value)) > PROVED_CHI2[len(names)]
