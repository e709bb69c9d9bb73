"""Limiting magnitude by the method of Moniteq 1983 §4.4, with the corrections of the errata."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.design.camera import DesignCamera

STAR_V6_E_S_CM2 = 1.5e3


@dataclass(frozen=True)
class MoniteqDetector:
    """Detector parameters (Table 4.1). ``dark_share``: spread f of the dark current. ``fixed_e2``: σ²_fix, the sum of
    the squared read and clock noise."""

    dark_e_s: float = 4e3
    dark_share: float = 0.01
    fixed_e2: float = 70.0**2 + 20.0**2
    response_sigma: float = 0.005

    def noise_e(self, exposure_s: float) -> float:
        """Noise of a pixel: √(f²i²τ² + iτ + σ²_fix)."""
        dark_e = self.dark_e_s * exposure_s
        return float(np.sqrt((self.dark_share * dark_e) ** 2 + dark_e + self.fixed_e2))


def detector_of(camera: DesignCamera) -> MoniteqDetector:
    """Return the detector parameters of a camera, with the report's 1 % spread of the dark current."""
    fixed_e2 = camera.read_noise_e**2 + camera.gain_e_per_dn**2 / 12
    return MoniteqDetector(camera.dark_current_e_s + camera.background_e_s, 0.01, fixed_e2, camera.response_sigma)


def star_e_s(area_cm2: float, v_mag: float) -> float:
    """Electrons per second from a star (Table 4.1: 1.5·10³ per cm² at magnitude 6)."""
    return float(STAR_V6_E_S_CM2 * area_cm2 * 10 ** (-0.4 * (v_mag - 6)))


def snr(detector: MoniteqDetector, area_cm2: float, v_mag: float, exposure_s: float) -> float:
    """S/N = eAτ/√(f²i²τ² + iτ + σ²_fix): total signal of the star over the noise of one pixel (§4.4)."""
    return star_e_s(area_cm2, v_mag) * exposure_s / detector.noise_e(exposure_s)


def limit_for_snr_mag(detector: MoniteqDetector, area_cm2: float, exposure_s: float, required_snr: float) -> float:
    """Faintest V with the S/N ``required_snr``."""
    return float(2.5 * np.log10(snr(detector, area_cm2, 0.0, exposure_s) / required_snr))


def limit_mag(camera: DesignCamera) -> float:
    """Faintest V whose signal is the camera's threshold times the noise of its 3 x 3 window, that is, S/N ≥ 3 times the
    threshold."""
    return limit_for_snr_mag(detector_of(camera), camera.aperture_cm2, camera.exposure_s, 3 * camera.threshold_snr)
