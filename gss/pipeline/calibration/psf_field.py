"""Width and shape of stars over the field, which show lens aberrations, defocus and tilt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.gaussian_fit import Spot, fit_spots
from gss.pipeline.calibration.photometric_design import corner_radius
from gss.pipeline.calibration.residual_figures import ResidualMap, residual_map
from gss.pipeline.calibration.robust import fit_linear
from gss.pipeline.detect import find_stars

MIN_STARS = 12
BRIGHT_SNR = 25.0
TILT_SIGMAS = 5.0


@dataclass(frozen=True)
class PsfField:
    """Shape of n stars over the field. ``pixels`` (n, 2); ``sigma_px`` (n,): σ of a round Gaussian with the same area
    as the star, without the integration over pixels; ``ratio`` (n,): long axis divided by short axis; ``direction_rad``
    (n,): direction of the long axis, from +col to +row.

    σ² over the field is fitted as s₀ + s₁x + s₂y + s₃ρ², with x and y in half diagonals and ρ as the distance from the
    centre divided by that of the corner. ``surface``, ``surface_sigma`` (4,): coefficients and their σ;
    ``centre_sigma_px``, ``corner_sigma_px``: σ at centre and corner from this fit; ``lean``: relative change of σ² from
    one side to the other. ``map``: map over the detector, whose ``rms_px`` contains the σ of each cell."""

    pixels: Array
    sigma_px: Array
    ratio: Array
    direction_rad: Array
    surface: Array
    surface_sigma: Array
    centre_sigma_px: float
    corner_sigma_px: float
    typical_sigma_px: float
    lean: float
    map: ResidualMap
    warnings: tuple[Advice, ...]


def psf_over_field(
    images: Sequence[NDArray[Any]], camera: Camera, *, e_per_dn: float = 0.0, saturation_dn: float = float("inf")
) -> PsfField:
    """Measure star widths in frames of stars. Saturated, faint and blended stars are excluded. Raises BadInput with
    fewer than a dozen stars."""
    spots: list[Spot] = []
    for image in images:
        detections = find_stars(
            image, saturation_dn=None if np.isinf(saturation_dn) else saturation_dn, e_per_dn=e_per_dn
        )
        spots += fit_spots(image, detections, saturation_dn, BRIGHT_SNR)
    if len(spots) < MIN_STARS:
        raise BadInput(
            "too few bright stars to determine the width over the field",
            expected=f"{MIN_STARS} single stars, bright but not clipped",
            got=str(len(spots)),
            hint="use more frames or a longer exposure",
        )
    pixels = np.array([(s.col_px, s.row_px) for s in spots])
    sigma = np.array([s.sigma_px for s in spots])
    ratio = np.array([s.ratio for s in spots])
    direction = np.array([s.direction_rad for s in spots])
    surface, errors = _surface(pixels, sigma, camera)
    centre, corner = (float(np.sqrt(max(v, 0.01))) for v in (surface[0], surface[0] + surface[3]))
    lean = 2 * float(np.hypot(surface[1], surface[2])) / max(float(surface[0]), 0.01)
    size = (camera.columns, camera.rows)
    widths = residual_map(pixels, np.column_stack([sigma, sigma]), size, 6)
    return PsfField(
        pixels,
        sigma,
        ratio,
        direction,
        surface,
        errors,
        centre,
        corner,
        float(np.median(sigma)),
        lean,
        ResidualMap(widths.col_px, widths.row_px, np.zeros_like(widths.mean_px), widths.rms_px, widths.count),
        tuple(_advice(surface, errors, lean, centre, corner, ratio, direction)),
    )


def _surface(pixels: Array, sigma: Array, camera: Camera) -> tuple[Array, Array]:
    corner = corner_radius(camera)
    x = (pixels[:, 0] - camera.centre_col_px) / corner
    y = (pixels[:, 1] - camera.centre_row_px) * camera.focal_col_px / camera.focal_row_px / corner
    fit = fit_linear(np.column_stack([np.ones(len(x)), x, y, x * x + y * y]), sigma**2)
    return fit.coefficients, np.sqrt(np.diag(fit.covariance))


def _advice(
    surface: Array, errors: Array, lean: float, centre: float, corner: float, ratio: Array, direction: Array
) -> list[Advice]:
    advice: list[Advice] = []
    sure = float(np.hypot(surface[1], surface[2])) > TILT_SIGMAS * float(np.hypot(errors[1], errors[2]))
    if sure and lean > 0.2:
        towards = float(np.degrees(np.arctan2(surface[2], surface[1])))
        text = f"stars widen towards {towards:.0f}° from +col to +row, σ² by {lean:.0%} from side to side"
        advice.append(Advice("tilt", text, "the detector is tilted against the focal plane, or the lens is decentred"))
    if corner > 1.3 * centre and surface[3] > TILT_SIGMAS * errors[3]:
        text = f"σ grows from {centre:.2f} px in the middle to {corner:.2f} px in the corner"
        advice.append(
            Advice("curvature", text, "focus at two thirds of the distance to the corner, or stop the lens down")
        )
    long = ratio > 1.25
    together = float(np.abs(np.mean(np.exp(2j * direction[long])))) if long.any() else 0.0
    if long.mean() > 0.5 and together > 0.8:
        text = f"most stars are elongated in one direction,  {np.median(ratio):.1f} times"
        advice.append(Advice("streaks", text, "the camera moved during the exposure: fix it, or expose shorter"))
    return advice
