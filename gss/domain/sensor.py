"""Detector model: electrons, noise and digital numbers from light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.dark_columns import NO_DARK_COLUMNS, DarkColumns


@dataclass(frozen=True)
class Sensor:
    """Photometric model of detector and lens.

    ``zero_point_e_s``: electrons per second from a star of V = 0, summed over its image. ``dark_columns``:
    columns that are shielded from light.
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
    dark_columns: DarkColumns = NO_DARK_COLUMNS

    @property
    def saturation_dn(self) -> int:
        """Maximum output of the analogue-to-digital converter."""
        return (1 << self.bits) - 1

    def star_e(self, v_mag: Array | float, exposure_s: float) -> Array:
        """Return the expected electrons in one exposure from stars of magnitude V."""
        return np.asarray(self.zero_point_e_s * exposure_s * 10.0 ** (-0.4 * np.asarray(v_mag, float)))

    def magnitude(self, star_e: Array | float, exposure_s: float) -> Array:
        """Return the magnitude V of a star that yields ``star_e`` electrons in one exposure."""
        return np.asarray(-2.5 * np.log10(np.asarray(star_e, float) / (self.zero_point_e_s * exposure_s)))

    def noise_e(self, exposure_s: float) -> float:
        """Return the standard deviation of a pixel without stars, in electrons: read noise, shot noise of dark current and
        background, and quantisation (Huffman 2006 §3.2)."""
        shot_e2 = (self.dark_current_e_s + self.background_e_s) * exposure_s
        return float(np.sqrt(self.read_noise_e**2 + shot_e2 + self.gain_e_per_dn**2 / 12))


@dataclass(frozen=True)
class Defects:
    """Defects of a detector and its lens. The chip's random seed determines their positions. All values are zero for a perfect
    detector.

    ``response_sigma``: spread of the pixels' relative response. ``offset_sigma_dn``, ``column_sigma_dn``: spread of the
    fixed offsets of pixels and of whole columns. ``dark_sigma``: relative spread of the dark current. ``hot_share``:
    fraction of pixels with an additional dark current, exponentially distributed with mean ``hot_e_s`` electrons per
    second. ``dead_share``: fraction of pixels without response. ``corner_loss``: fraction of light lost in the corner; the
    loss grows with the square of the distance from the optical centre. ``corner_blur_px``: additional standard deviation
    of a star image in the corner of a lens with a curved field; the defocus grows with the square of the same distance.
    ``row_skew_ms``: time from the exposure of the first row to that of the last row of a rolling shutter.
    ``coupling_px``: time constant of an ac-coupled video amplifier in pixel periods; 0: dc coupled.
    """

    response_sigma: float = 0.0
    offset_sigma_dn: float = 0.0
    column_sigma_dn: float = 0.0
    dark_sigma: float = 0.0
    hot_share: float = 0.0
    hot_e_s: float = 0.0
    dead_share: float = 0.0
    corner_loss: float = 0.0
    corner_blur_px: float = 0.0
    row_skew_ms: float = 0.0
    coupling_px: float = 0.0


NO_DEFECTS = Defects()


@dataclass(frozen=True)
class Baffle:
    """Stray-light limits of a camera. Angles are from the boresight to the Sun's centre and to the Earth's limb.

    If the Sun is at its limit, its stray light is ``reference_e_s`` electrons per second and pixel. Outside the limit the
    stray light falls slowly. Inside, it grows by a factor of e every ``decay_rad``. Within ``blind_rad`` the Sun
    illuminates the lens and no star is detected.
    """

    sun_limit_rad: float = float(np.radians(30.0))
    earth_limit_rad: float = float(np.radians(25.0))
    blind_rad: float = float(np.radians(15.0))
    decay_rad: float = float(np.radians(3.0))
    reference_e_s: float = 20.0
