"""Light of Sun, Earth and Moon that reaches a pixel, directly and through the baffle (Moniteq 1983 §5.2, Tables 5.2
and 5.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

E_PER_J = 1.155e18
"""0.185 A/W, the TI chip, in electrons per joule."""
SUN_W_CM2, ALBEDO_W_CM2, STAR_V6_W_CM2 = 0.135, 40e-3, 1.3e-15
SUN_RADIUS_RAD = float(np.radians(0.25))
# Table 5.3: degrees from the axis, effective lens area in cm² behind the 20° shade of the 85 mm f/1.4 lens.
PRINTED_AREA_CM2 = ((20.0, 2.58e-15), (21.0, 9.87e-16), (27.0, 6.69e-16), (37.0, 4.56e-16), (58.0, 2.54e-16))


@dataclass(frozen=True)
class LightSource:
    """A light source: ``irradiance_w_cm2`` at the lens, ``radiance_w_cm2_sr`` of its disc."""

    name: str
    irradiance_w_cm2: float
    radiance_w_cm2_sr: float


SUN = LightSource("Sun", SUN_W_CM2, float(SUN_W_CM2 / (np.pi * SUN_RADIUS_RAD**2)))
EARTH = LightSource("Earth", ALBEDO_W_CM2, ALBEDO_W_CM2 / np.pi)
MOON = LightSource("Moon", ALBEDO_W_CM2, ALBEDO_W_CM2 / np.pi)


def pixel_etendue_cm2_sr(pitch_col_um: float, pitch_row_um: float, f_number: float) -> float:
    """Pixel area times the solid angle of the lens's cone: 1.46e-6 for 20 µm and f/1.4."""
    cone_sr = 2 * np.pi * (1 - np.cos(np.arctan(1 / (2 * f_number))))
    return float(pitch_col_um * pitch_row_um * 1e-8 * cone_sr)


def imaged_e_s(source: LightSource, etendue_cm2_sr: float) -> float:
    """Electrons per second in a pixel that images the source's disc (Table 5.2)."""
    return source.radiance_w_cm2_sr * etendue_cm2_sr * E_PER_J


def stray_e_s(source: LightSource, effective_area_cm2: float) -> float:
    """Electrons per second and pixel through the baffle (Table 5.3)."""
    return source.irradiance_w_cm2 * effective_area_cm2 * E_PER_J


def effective_area_cm2(angle_rad: float, shade_rad: float = float(np.radians(20.0))) -> float:
    """Effective area of Table 5.3, interpolated in the logarithm; NaN inside the exclusion angle.

    For a baffle with another exclusion angle, the table is shifted by the difference of the angles.
    """
    degrees, area = np.array(PRINTED_AREA_CM2).T
    at = np.degrees(angle_rad - shade_rad) + degrees[0]
    return float(np.exp(np.interp(at, degrees, np.log(area)))) if at >= degrees[0] - 1e-9 else float("nan")
