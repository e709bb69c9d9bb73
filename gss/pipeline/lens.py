"""Lens parameters from one frame. The focal length is always fitted, the distortion only if it is statistically
significant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.pipeline.refine import Refined, refine, value_of

RADIAL = ("k1",)
CENTRE = ("col", "row")
FULL = ("k1", "k2", "p1", "p2")
FULL_HALF_DIAGONAL_RAD = np.radians(12.0)
FULL_STARS = 20
# Limit of χ² for each number of coefficients. One in 370 frames of a perfect lens exceeds it by chance.
PROVED_CHI2 = {1: 9.0, 2: 11.83, 3: 14.16}


def fit_lens(
    pixels: Array, icrs: Array, sigma_px: Array, camera: Camera, cam_from_icrs: Array, also: tuple[str, ...] = ()
) -> Refined:
    """Fit attitude, focal length and distortion of an uncalibrated ``camera`` (with a Brown distortion) to (n, 2) pixels of
    (n, 3) stars. Coefficients that do not differ significantly from 0 are set to 0 and not fitted.

    ``also``: further free parameters of :func:`refine`. If the optical centre does not differ significantly from the frame's
    middle, it is fixed there.
    """
    perfect = replace(camera, distortion=Brown())
    plain = refine(pixels, icrs, sigma_px, perfect, cam_from_icrs, fit_focal=True, fit_lens=also)
    radial = refine(pixels, icrs, sigma_px, perfect, cam_from_icrs, fit_focal=True, fit_lens=(*RADIAL, *also))
    best = radial if proved(radial, RADIAL) else plain
    if camera.half_diagonal_rad > FULL_HALF_DIAGONAL_RAD and len(pixels) >= FULL_STARS:
        full = refine(pixels, icrs, sigma_px, camera, cam_from_icrs, fit_focal=True, fit_lens=(*FULL, *also))
        if proved(full, FULL[1:]):
            best = full
    if CENTRE[0] in also and not proved(best, CENTRE):
        # The stars of a small field do not determine the optical centre. It is fixed, and the attitude refers to the
        # frame's middle.
        middle = replace(camera, centre_col_px=(camera.columns - 1) / 2, centre_row_px=(camera.rows - 1) / 2)
        return fit_lens(pixels, icrs, sigma_px, middle, cam_from_icrs, tuple(n for n in also if n not in CENTRE))
    return best


def proved(fit: Refined, names: tuple[str, ...]) -> bool:
    """True if these fitted coefficients together differ significantly from 0."""
    index: NDArray[np.intp] = np.array([fit.parameters.index(n) for n in names], np.intp)
    value = np.array([value_of(fit.camera, n) for n in names])
    return float(value @ np.linalg.solve(fit.covariance[np.ix_(index, index)], value)) > PROVED_CHI2[len(names)]
