"""What the detector does to light: electrons, noise, digital numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array


@dataclass(frozen=True)
class Sensor:
    """Photometric model of detector and lens.

    ``zero_point_e_s`` are the electrons per second that a star of V = 0 leaves on the whole detector.
    """

    bits: int
    gain_e_per_dn: float
    bias_dn: float
    full_well_e: float
    read_noise_e: float
    dark_current_e_s: float
    background_e_s: float
    zero_point_e_s: float
    psf_sigma_px: float
    bright_limit_mag: float
    faint_limit_mag: float
    exposure_min_s: float
    exposure_max_s: float
    exposure_s: float

    @property
    def saturation_dn(self) -> int:
        """Largest value of the converter."""
        return (1 << self.bits) - 1

    def star_e(self, v_mag: Array | float, exposure_s: float) -> Array:
        """Expected electrons of stars of magnitude V in one exposure."""
        return np.asarray(self.zero_point_e_s * exposure_s * 10.0 ** (-0.4 * np.asarray(v_mag, float)))

    def magnitude(self, star_e: Array | float, exposure_s: float) -> Array:
        """Magnitude V that leaves ``star_e`` electrons."""
        return np.asarray(-2.5 * np.log10(np.asarray(star_e, float) / (self.zero_point_e_s * exposure_s)))

    def noise_e(self, exposure_s: float) -> float:
        """Standard deviation of a dark-sky pixel: read noise, dark and background shot noise, quantisation (Huffman 2006 §3.2)."""
        shot_e2 = (self.dark_current_e_s + self.background_e_s) * exposure_s
        return float(np.sqrt(self.read_noise_e**2 + shot_e2 + self.gain_e_per_dn**2 / 12))
