"""Limiting magnitude by the method of Huffman 2006 §3: compare the peak of a Gaussian star with the noise of a
pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.design.camera import DesignCamera

FFSR_A_W = 0.12
"""Fill factor times spectral response of the IBIS5-A-1300 (Huffman 2006 Table 7.1)."""
MAG_0 = 28.0


@dataclass(frozen=True)
class HuffmanImager:
    """Parameters of eq. 3.4 and 3.18.

    ``dark_e``: dark electrons in one exposure. ``extra_gain``: the factor g of eq. 3.4. The other terms of the equation
    already contain this factor (errata E1), but the tables of the document include g.
    """

    area_m2: float
    exposure_s: float
    psf_sigma_px: float
    dark_e: float
    read_noise_e: float
    ffsr_a_w: float = FFSR_A_W
    extra_gain: float = 1.0

    @property
    def noise_e(self) -> float:
        """Dark and readout noise, the only terms the document retains (§3.2.6)."""
        return float(np.sqrt(self.dark_e + self.read_noise_e**2))


def imager_of(camera: DesignCamera) -> HuffmanImager:
    """Return the parameters of a camera: its optics, exposure and noise, with the document's detector response."""
    dark_e = camera.dark_current_e_s * camera.exposure_s
    return HuffmanImager(
        camera.aperture_cm2 * 1e-4 * camera.transmission,
        camera.exposure_s,
        camera.psf_sigma_px,
        dark_e,
        camera.read_noise_e,
    )


def star_e(imager: HuffmanImager, v_mag: float) -> float:
    """Electrons of a whole star (eq. 3.4)."""
    return float(
        imager.area_m2 * imager.ffsr_a_w * imager.exposure_s * imager.extra_gain * 10 ** ((MAG_0 - v_mag) / 2.5)
    )


def magnitude(imager: HuffmanImager, electrons: float) -> float:
    """Inverse of eq. 3.4."""
    return float(
        MAG_0 - 2.5 * np.log10(electrons / (imager.area_m2 * imager.ffsr_a_w * imager.exposure_s * imager.extra_gain))
    )


def snr(imager: HuffmanImager, v_mag: float) -> float:
    """Signal-to-noise ratio of the peak pixel (eq. 3.18)."""
    return star_e(imager, v_mag) / (2 * np.pi * imager.psf_sigma_px**2 * imager.noise_e)


def limit_mag(camera: DesignCamera) -> float:
    """Faintest V whose peak pixel reaches the camera's threshold by eq. 3.18."""
    i = imager_of(camera)
    return magnitude(i, camera.threshold_snr * 2 * np.pi * i.psf_sigma_px**2 * i.noise_e)
