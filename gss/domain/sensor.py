"""Detector model: from light to electrons, noise and digital numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array


@dataclass(frozen=True)
class Sensor:
    """Photometric model of detector and lens.

    ``zero_point_e_s``: electrons per second over the whole image of a star of V = 0.
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
        """Largest value of the analogue-to-digital converter."""
        return (1 << self.bits) - 1

    def star_e(self, v_mag: Array | float, exposure_s: float) -> Array:
        """Expected electrons of stars of magnitude V in one exposure."""
        return np.asarray(self.zero_point_e_s * exposure_s * 10.0 ** (-0.4 * np.asarray(v_mag, float)))

    def magnitude(self, star_e: Array | float, exposure_s: float) -> Array:
        """Magnitude V of a star that yields ``star_e`` electrons."""
        return np.asarray(-2.5 * np.log10(np.asarray(star_e, float) / (self.zero_point_e_s * exposure_s)))

    def noise_e(self, exposure_s: float) -> float:
        """Standard deviation of a dark-sky pixel: read noise, dark and background shot noise, quantisation (Huffman 2006 §3.2)."""
        shot_e2 = (self.dark_current_e_s + self.background_e_s) * exposure_s
        return float(np.sqrt(self.read_noise_e**2 + shot_e2 + self.gain_e_per_dn**2 / 12))


@dataclass(frozen=True)
class Defects:
    """Defects of a detector and its lens; the chip's random seed determines their positions. All zero: a perfect detector.

    ``response_sigma``: spread of the pixels' relative response. ``offset_sigma_dn``, ``column_sigma_dn``: fixed offsets
    of pixels and of whole columns. ``dark_sigma``: relative spread of the dark current. ``hot_share``: fraction of
    pixels with an extra ``hot_e_s`` electrons per second on average (exponential). ``dead_share``: fraction of pixels
    without response. ``corner_loss``: fraction of light lost in the corner, growing with the square of the distance
    from the optical centre.
    """

    response_sigma: float = 0.0
    offset_sigma_dn: float = 0.0
    column_sigma_dn: float = 0.0
    dark_sigma: float = 0.0
    hot_share: float = 0.0
    hot_e_s: float = 0.0
    dead_share: float = 0.0
    corner_loss: float = 0.0


NO_DEFECTS = Defects()


@dataclass(frozen=True)
class Baffle:
    """Stray-light limits of a camera. Angles are from the boresight to the Sun's centre and to the Earth's limb.

    At the limit the stray light from the Sun is ``reference_e_s`` electrons per second and pixel; outside it falls
    slowly, inside it grows e-fold every ``decay_rad``. Within ``blind_rad`` the Sun illuminates the lens and no star is
    detected.
    """

    sun_limit_rad: float = float(np.radians(30.0))
    earth_limit_rad: float = float(np.radians(25.0))
    blind_rad: float = float(np.radians(15.0))
    decay_rad: float = float(np.radians(3.0))
    reference_e_s: float = 20.0
