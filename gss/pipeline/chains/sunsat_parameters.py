"""Constants of Sunsat's chain, sources of the constants, and values for a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.pipeline.centroid import PixelNoise

NAME = "sunsat"
FASTEST_RAD_S, FURTHEST_RAD = float(np.radians(0.241)), float(np.radians(2.0))
OLDEST_ATTITUDE_S = FURTHEST_RAD / FASTEST_RAD_S
"""Jacobs 1995 eq. 3.6: fastest rotation, largest error of the attitude from which tracking starts, and the resulting
maximum age of that attitude. If the attitude is older, stars are matched without tracking."""

SOURCES: dict[str, str] = {
    "threshold_dn": "Jacobs 1995 app. C.1: two to four of its levels above the dark average; GSS: 2.5 sigma of the dark "
    "sky, raised until a star 0.25 mag below the catalogue's limit covers fewer than min_area_px",
    "min_area_px": "Jacobs 1995 §2.2.1.2: ten",
    "max_area_px": "Jacobs 1995 §2.2.1.2: three hundred",
    "max_found": "Jacobs 1995 §2.3: the first twenty stars of the scan",
    "search_step_px": "Jacobs 1995 §2.2.1.3: every third pixel of every third row",
    "edge_rule": "Jacobs 1995 §2.2.1.3: regions at the border of the search area are rejected",
    "max_elongation_px": "Jacobs 1995 §2.2.3: ten for rotation and two for inaccuracy, without attitude history",
    "elongation_slack_px": "Jacobs 1995 eq. 2.9: two",
    "direction_from_px": "Jacobs 1995 §2.2.3: direction is evaluated from an elongation of five",
    "direction_rad": "Jacobs 1995 eq. 2.10: 30°",
    "dark_clip_dn": "GSS: the sky level of a row is the mean of its pixels within this range of the median; the document "
    "does not state how the background above the dark average is determined",
    "k_area": "Jacobs 1995 app. C.1: two",
    "k_illum_lux": "Jacobs 1995 app. C.1: the mean over stars of the range, with fixed k_area; GSS: over model stars of the "
    "profile and exposure, because eq. 6.24's 16e-9 applies to its exposure and levels",
    "distance_tolerance_rad": "Jacobs 1995 Table 3-6 row 4: 150 µrad; other cameras: the same 0.59 pixels",
    "magnitude_tolerance_mag": "Jacobs 1995 Table 3-6 row 4: 0.6",
    "max_observed": "Jacobs 1995 §3.1: eight",
    "max_rounds": "GSS: if eight stars give no reliable result, the next eight are tried, half of them new; the "
    "publication tries once",
    "min_group": "Jacobs 1995 §3.3.5: ICLim ends at one, which is three stars",
    "matcher": "match_groups is Jacobs 1995 §3.3, star_vectors §3.2.2 (Baldini)",
    "acceptance": "document: the largest group counts (Jacobs 1995 §3.3.5); bound (GSS): in addition, an accidental group must be "
    "improbable, the stars must determine the boresight, none may be displaced from the position predicted by the "
    "others, and the field must not indicate another focal length",
    "max_false_probability": "GSS: largest accepted bound on the probability of an accidental identification",
    "residual_tolerances": "GSS: largest residual of a matched star in the TRIAD attitude; three distance tolerances",
    "sure_mag": "GSS: a star 0.5 mag brighter than the catalogue's limit is always detected",
    "saturating_mag": "GSS: the region of a star 3 mag brighter than the published bright limit can be too large",
    "sure_named": "GSS: below six identified stars, the number of missing expected bright stars must be below half of them, or one",
    "confirm_windows": "GSS: windows searched after three stars match, to detect a false triple",
    "clique_budget": "GSS: maximum steps when a group is split, to bound the cost of every list",
    "hint_error_rad": "Jacobs 1995 §3.5: an initial estimate may be 2° off",
    "uncertain_adcs_px": "Jacobs 1995 eq. 4.20: 53 pixels for 0.5° per axis",
    "uncertain_least_px": "Jacobs 1995 eq. 4.20: two",
    "uncertain_reach_mm": "Jacobs 1995 eq. E.26: 12 mm times an error of half a pixel",
    "rotation_px": "Jacobs 1995 §4.1.6.3: half of ten pixels of elongation",
    "star_sigma_px": "from the profile's sensor: width of the star image, widened by the pixel",
    "noise": "from the profile's sensor; the floor of 0.03 px is the measured error of a noise-free centre of gravity",
    "focal_mm": "from the profile's lens",
    "exposure_s": "from the profile's sensor, or the exposure of the frame",
    "max_small_regions": "GSS: regions below min_area_px that a report of a frame lists, to bound its size",
}
LIMITS: dict[str, tuple[float, float]] = {
    "threshold_dn": (0.5, 20_000),
    "min_area_px": (1, 60),
    "max_area_px": (10, 100_000),
    "max_found": (3, 100),
    "search_step_px": (1, 30),
    "max_elongation_px": (0, 200),
    "elongation_slack_px": (0, 50),
    "direction_from_px": (0, 200),
    "direction_rad": (0.01, np.pi / 2),
    "dark_clip_dn": (0.1, 1_000),
    "k_area": (0, 100),
    "k_illum_lux": (1e-14, 1e-6),
    "distance_tolerance_rad": (1e-6, 2e-3),
    "magnitude_tolerance_mag": (0.05, 3),
    "max_observed": (3, 16),
    "max_rounds": (1, 20),
    "min_group": (3, 16),
    "max_false_probability": (1e-12, 1),
    "residual_tolerances": (0.1, 30),
    "sure_mag": (-5, 15),
    "saturating_mag": (-10, 10),
    "sure_named": (0, 100),
    "confirm_windows": (0, 30),
    "clique_budget": (1_000, 1_000_000),
    "hint_error_rad": (1e-3, 0.5),
    "uncertain_adcs_px": (1, 1_000),
    "uncertain_least_px": (0.1, 100),
    "uncertain_reach_mm": (0.1, 1_000),
    "rotation_px": (0, 200),
    "star_sigma_px": (0.2, 10),
    "focal_mm": (1, 1_000),
    "exposure_s": (1e-4, 100),
    "max_small_regions": (0, 10_000),
}
"""Lowest and highest value of each number that a rerun can change."""

ZERO_LUX = 2.65e-6  # Jacobs 1995 eq. C.4
MAGNITUDE_RATIO = 2.512
K_AREA = 2.0
NOISE_SIGMAS = 2.5
FAINTER_MAG = 0.25
DOCUMENT_PIXEL_RAD = 25.0**-1 * float(np.sqrt(0.0065 * 0.00625))
DOCUMENT_DISTANCE_RAD = 150e-6
CENTROID_ERROR_PX = 0.5


@dataclass(frozen=True)
class SunsatParameters:
    """Constants of the chain; see ``SOURCES`` for their sources. ``threshold_dn`` is above a row's dark average."""

    limits = LIMITS

    threshold_dn: float
    noise: PixelNoise
    focal_mm: float
    k_illum_lux: float
    distance_tolerance_rad: float
    exposure_s: float
    star_sigma_px: float
    sure_mag: float
    saturating_mag: float
    min_area_px: int = 10
    max_area_px: int = 300
    max_found: int = 20
    search_step_px: int = 3
    edge_rule: bool = True
    max_elongation_px: float = 12.0
    elongation_slack_px: float = 2.0
    direction_from_px: float = 5.0
    direction_rad: float = float(np.radians(30.0))
    dark_clip_dn: float = 4.0
    k_area: float = K_AREA
    magnitude_tolerance_mag: float = 0.6
    max_observed: int = 8
    max_rounds: int = 4
    min_group: int = 3
    matcher: str = "match_groups"
    acceptance: str = "bound"
    max_false_probability: float = 1e-3
    residual_tolerances: float = 3.0
    sure_named: int = 6
    confirm_windows: int = 3
    clique_budget: int = 200_000
    hint_error_rad: float = float(np.radians(2.0))
    uncertain_adcs_px: float = 53.0
    uncertain_least_px: float = 2.0
    uncertain_reach_mm: float = 12.0
    rotation_px: float = 5.0
    max_small_regions: int = 100

    def __post_init__(self) -> None:
        _one_of("matcher", self.matcher, ("match_groups", "star_vectors"))
        _one_of("acceptance", self.acceptance, ("bound", "document"))
        if not (self.threshold_dn > 0 and 1 <= self.min_area_px <= self.max_area_px and self.exposure_s > 0):
            raise BadInput(
                "invalid detection parameters",
                expected="threshold and exposure above zero, 1 ≤ smallest ≤ largest area",
                got=f"{self.threshold_dn}, {self.exposure_s}, {self.min_area_px}, {self.max_area_px}",
            )
        if not (self.distance_tolerance_rad > 0 and self.magnitude_tolerance_mag > 0 and self.min_group >= 3):
            raise BadInput(
                "invalid matching parameters",
                expected="tolerances above zero, groups of at least three",
                got=f"{self.distance_tolerance_rad}, {self.magnitude_tolerance_mag}, {self.min_group}",
            )

    @property
    def residual_tolerance_rad(self) -> float:
        """Return the maximum residual of a matched star."""
        return self.residual_tolerances * self.distance_tolerance_rad


def _one_of(parameter: str, got: str, choices: tuple[str, ...]) -> None:
    if got not in choices:
        raise BadInput(f"unknown {parameter}", expected=" | ".join(choices), got=got)


def default_parameters(profile: CameraProfile, exposure_s: float | None = None) -> SunsatParameters:
    """Return the parameters for a camera. Values in pixels and counts are those of the document; angles are scaled to
    the camera."""
    sensor = profile.sensor
    exposure = sensor.exposure_s if exposure_s is None else exposure_s
    noise_dn = sensor.noise_e(exposure) / sensor.gain_e_per_dn
    threshold_dn = max(NOISE_SIGMAS * noise_dn, _level_where_faintest_vanishes_dn(sensor, exposure))
    return SunsatParameters(
        threshold_dn=round(threshold_dn, 1),
        noise=PixelNoise(noise_dn, sensor.gain_e_per_dn, 0.03),
        focal_mm=profile.focal_mm,
        k_illum_lux=_illuminance_per_level_lux(sensor, exposure, round(threshold_dn, 1)),
        distance_tolerance_rad=DOCUMENT_DISTANCE_RAD * profile.camera.pixel_rad / DOCUMENT_PIXEL_RAD,
        exposure_s=exposure,
        star_sigma_px=float(np.sqrt(sensor.psf_sigma_px**2 + 1 / 12)),
        sure_mag=sensor.faint_limit_mag - 0.5,
        saturating_mag=sensor.bright_limit_mag - 3.0,
        dark_clip_dn=max(1.0, 3.0 * noise_dn),
    )


def _level_where_faintest_vanishes_dn(sensor: Sensor, exposure_s: float) -> float:
    """Return the level above which a Gaussian star just below the limiting magnitude covers ten pixels: 2πσ² ln(peak /
    level) = 10."""
    spread_px2 = 2 * np.pi * (sensor.psf_sigma_px**2 + 1 / 12)
    star_dn = float(sensor.star_e(sensor.faint_limit_mag + FAINTER_MAG, exposure_s)) / sensor.gain_e_per_dn
    return float(star_dn / spread_px2 * np.exp(-10 / spread_px2))


def _illuminance_per_level_lux(sensor: Sensor, exposure_s: float, threshold_dn: float) -> float:
    """Return k_illum, the ratio of illuminance to brightness (eq. C.1) of Gaussian stars. It is the geometric mean over
    the magnitude range."""
    v_mag = np.linspace(max(sensor.bright_limit_mag, sensor.faint_limit_mag - 3), sensor.faint_limit_mag, 31)
    spread_px2 = 2 * np.pi * (sensor.psf_sigma_px**2 + 1 / 12)
    level = np.asarray(sensor.star_e(v_mag, exposure_s)) / sensor.gain_e_per_dn / spread_px2 / threshold_dn
    level = np.maximum(level, 1.001)
    # In units of threshold times spread, the light above threshold is level − 1 − ln level and the area is ln level.
    brightness = (level - 1 - np.log(level) + K_AREA * np.log(level)) * spread_px2 * threshold_dn
    return float(np.exp(np.mean(np.log(ZERO_LUX * MAGNITUDE_RATIO**-v_mag / brightness))))
