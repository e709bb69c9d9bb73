"""Limiting magnitude by the method of Erlank 2013 §3.4.4: compare the photons on a pixel with the number that the data
sheet requires for SNR 10."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.design.camera import DesignCamera

PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 2.99792458e8
SNR10_W_CM2, WAVELENGTH_M = 25e-9, 535e-9


@dataclass(frozen=True)
class Lens:
    """Parameters of eq. 3.4.2. The default is the document's example, a lens of 1 cm radius."""

    area_cm2: float = float(np.pi)
    transmission: float = 0.6
    bandwidth_angstrom: float = 3000.0


def photons_s(power_w: float, wavelength_m: float = WAVELENGTH_M) -> float:
    """Photons per second at one wavelength (eq. 3.4.1)."""
    return power_w * wavelength_m / (PLANCK_J_S * LIGHT_M_S)


def needed_photons_s(pitch_col_um: float, pitch_row_um: float, snr10_w_cm2: float = SNR10_W_CM2) -> float:
    """Photons per second and pixel for SNR 10: 21 115 with 5.6 µm."""
    return photons_s(snr10_w_cm2) * pitch_col_um * pitch_row_um * 1e-8


def star_photons_s(lens: Lens, v_mag: float) -> float:
    """Photons per second from a star (eq. 3.4.2 with T = 1 s)."""
    return float(lens.area_cm2 * lens.transmission * lens.bandwidth_angstrom * 10 ** ((15 - 2 * v_mag) / 5))


def limit_of_lens_mag(lens: Lens, needed_s: float, pixels: float) -> float:
    """Faintest V that gives SNR 10 in each of the pixels that a star covers."""
    return float(2.5 * np.log10(star_photons_s(lens, 0.0) / (pixels * needed_s)))


def pixels_covered(sigma_px: float) -> int:
    """Pixels of the grid that contains a star, 1 x 1, 3 x 3, 5 x 5 … (§3.4.4, §4.1.1): the smallest odd side of at
    least 2.5 σ."""
    side = int(np.ceil(2.5 * sigma_px))
    return (side + 1 - side % 2) ** 2


def limit_mag(camera: DesignCamera) -> float:
    """Faintest V by this method, with this camera's lens, pixels and spread, and the Melexis sensitivity.

    The threshold is SNR 10; the exposure has no effect.
    """
    lens = Lens(camera.aperture_cm2, camera.transmission, camera.bandwidth_nm * 10)
    return limit_of_lens_mag(
        lens, needed_photons_s(camera.pitch_col_um, camera.pitch_row_um), pixels_covered(camera.psf_sigma_px)
    )


def fov_rad(size_mm: float, focal_mm: float) -> float:
    """Field of view across ``size_mm`` of detector (eq. 3.5.2–3 with the factor ½ that Table 3.5 uses)."""
    return float(2 * np.arctan(size_mm / 2 / focal_mm))


def equal_circle_rad(fov_col_rad: float, fov_row_rad: float) -> float:
    """Diameter of the circle of the same area, treating both angles as flat (eq. 3.5.4)."""
    return float(2 * np.sqrt(fov_col_rad * fov_row_rad / np.pi))
