"""Limiting magnitude by the method of Jacobs 1995 §9 and app. H: compare the illumination of the pixel at a faint
star's edge with the dark signal non-uniformity. The document's units are used: volts, lux and kelvin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.design.camera import DesignCamera

MAG_0_LUX = 2.65e-6
DIODE_K = 6374.0
EDGE_PX = 1.5
MARGIN = float(np.sqrt(2.0))
SUM_REACH = 6.0


@dataclass(frozen=True)
class VideoChip:
    """Data sheet parameters of a CCD. Default: Sony ICX059 (Jacobs 1995 §9.2, H.3, H.4).

    ``scene_lux``, ``scene_v``: illumination of the detector and the resulting video voltage in ``scene_s``.
    ``dsnu_v_s``: peak dark signal non-uniformity per second at ``dsnu_k``. ``chip_k``: operating temperature.
    """

    scene_lux: float = float(np.pi * 706.0 / (4 * 8.0**2))
    scene_v: float = 0.240
    scene_s: float = 0.02
    dsnu_v_s: float = 1e-3 / 0.02
    dsnu_k: float = 333.0
    chip_k: float = 278.0

    @property
    def responsivity_v_lx_s(self) -> float:
        """Volts per lux and second (H.4): 1.385."""
        return self.scene_v / (self.scene_lux * self.scene_s)


ICX059 = VideoChip()


def star_lux(v_mag: float) -> float:
    """Illumination by a star (eq. C.4)."""
    return float(MAG_0_LUX * 2.512**-v_mag)


def dsnu_v(exposure_s: float, chip: VideoChip = ICX059) -> float:
    """Dark signal non-uniformity in one exposure (eq. 9.7, 9.8, H.2): 1.133 mV in 1 s at 5 °C."""
    return float(chip.dsnu_v_s * exposure_s * np.exp(DIODE_K * (1 / chip.dsnu_k - 1 / chip.chip_k)))


def peak_lux(camera: DesignCamera, v_mag: float) -> float:
    """Illumination at the centre of a star's image (eq. 9.13): its luminous flux divided by the pixel area, summed at
    pixel centres."""
    lumen = star_lux(v_mag) * camera.transmission * camera.aperture_cm2 * 1e-4
    reach = int(np.ceil(SUM_REACH * camera.psf_sigma_px)) + 1
    u = np.arange(-reach, reach + 1)
    total = np.exp(-(u**2) / (2 * camera.psf_sigma_px**2)).sum() ** 2
    return float(lumen / (camera.pitch_col_um * camera.pitch_row_um * 1e-12 * total))


def edge_v(camera: DesignCamera, v_mag: float, chip: VideoChip = ICX059) -> float:
    """Voltage of the worst pixel of a 3 x 3 star, 1.5 px from the centroid in both axes (eq. 9.14, 9.15)."""
    fall = np.exp(-(EDGE_PX**2) / camera.psf_sigma_px**2)
    return float(chip.responsivity_v_lx_s * camera.exposure_s * peak_lux(camera, v_mag) * fall)


def limit_mag(camera: DesignCamera, chip: VideoChip = ICX059) -> float:
    """Faintest V whose edge pixel is 3 dB above the dark signal non-uniformity (eq. 9.16). The result does not depend
    on the exposure."""
    margin = edge_v(camera, 0.0, chip) / MARGIN / dsnu_v(camera.exposure_s, chip)
    return float(np.log(margin) / np.log(2.512))
