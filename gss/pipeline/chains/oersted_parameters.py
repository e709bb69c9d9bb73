"""Constants of the Oersted star imager's chain, sources of the constants, and values for a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.pipeline.centroid import PixelNoise
from gss.pipeline.chains.modes import Mode

NAME = "oersted"

MIN_VERIFIED = "GSS: four without prior, three with a hint, two in tracking; with acceptance 'document' two"
SOURCES: dict[str, str] = {
    "threshold_dn": "GSS: five times the noise of a dark pixel above the frame's median; Liebe 1992 states no level, but "
    "detects 8000 stars and uses the 1100 brightest, so that the level detects stars and brightness selects them",
    "dn_at_mag_0": "from the profile's sensor: the flux that converts the brightness limit from a magnitude",
    "uncertainty_rad": "Liebe 1992, 'Inclusion of Position-Uncertainty': 3′ = 1.08 px of its camera; other cameras: "
    "the same number of pixels",
    "window_px": "GSS: the hyperaccuracy technique is not described; 5 x 5 inside a border of one pixel",
    "min_area_px": "GSS: rejects hot pixels",
    "max_area_px": "GSS: the brightest star covers about fifty pixels",
    "max_invalid": "GSS: as in Erlank 2013 §5.3.3, the search stops at more than fifty oversized regions",
    "max_centroids": "GSS: the densest field of 30° has about fifty stars to V 4.5",
    "capture_rad": "GSS: 0.5°; the publication states only that the coarse attitude is known, to 0.1° after the initial estimate",
    "assisted_radius_rad": "GSS: half diagonal + 5°; the publication has no mode with a boresight only",
    "min_verified_lost": MIN_VERIFIED,
    "min_verified_assisted": MIN_VERIFIED,
    "min_verified_tracking": MIN_VERIFIED,
    "triplets_alone": "GSS: number of candidates tried one by one if the vote of Liebe 1992 identifies fewer than five "
    "stars; 0 as published",
    "max_false_probability": "GSS: largest accepted bound on the probability of an accidental identification",
    "acceptance": "GSS 'proved': residuals, displaced stars, the error of the boresight, the false-match bound and the focal "
    "length indicated by the field decide; 'document': the vote or the least-distance fit is the result "
    "(Liebe 1992 states no test, and Table 2 shows failures)",
    "averaged": "Liebe 1992, 'Predictional Estimate': several successive estimates averaged; 1 disables averaging, "
    "because frames may "
    "be at unequal intervals",
    "saturation_dn": "from the profile's sensor",
    "noise": "from the profile's sensor; the floor of 0.045 px is the scatter of stars of V 3 to 4 in "
    "rendered frames with all stars to V 7, whose light also falls into the window",
    "max_small_regions": "GSS: regions below min_area_px that a report of a frame lists, to bound its size",
}
LIMITS: dict[str, tuple[float, float]] = {
    "threshold_dn": (1, 20_000),
    "dn_at_mag_0": (100, 1e8),
    "uncertainty_rad": (1e-5, 0.01),
    "window_px": (5, 31),
    "min_area_px": (1, 60),
    "max_area_px": (10, 100_000),
    "max_invalid": (0, 1_000),
    "max_centroids": (3, 200),
    "capture_rad": (1e-4, 0.1),
    "assisted_radius_rad": (0.01, np.pi),
    "min_verified_lost": (2, 100),
    "min_verified_assisted": (2, 100),
    "min_verified_tracking": (2, 100),
    "triplets_alone": (0, 1_000),
    "max_false_probability": (1e-12, 1),
    "averaged": (1, 20),
    "saturation_dn": (10, 1e6),
    "max_small_regions": (0, 10_000),
}
"""Lowest and highest value of each number that a rerun can change."""


@dataclass(frozen=True)
class OerstedParameters:
    """Constants of the chain; see ``SOURCES`` for their sources. ``threshold_dn`` is above the frame's black level."""

    limits = LIMITS

    threshold_dn: float
    dn_at_mag_0: float
    uncertainty_rad: float
    assisted_radius_rad: float
    saturation_dn: float
    noise: PixelNoise
    min_area_px: int = 3
    max_area_px: int = 200
    max_invalid: int = 50
    max_centroids: int = 60
    window_px: int = 7
    capture_rad: float = float(np.radians(0.5))
    triplets_alone: int = 100
    min_verified_lost: int = 4
    min_verified_assisted: int = 3
    min_verified_tracking: int = 2
    max_false_probability: float = 1e-3
    acceptance: str = "proved"
    averaged: int = 1
    max_small_regions: int = 100

    def __post_init__(self) -> None:
        if self.acceptance not in ("proved", "document"):
            raise BadInput("unknown acceptance", expected="proved | document", got=self.acceptance)
        if not (self.threshold_dn > 0 and self.uncertainty_rad > 0 and 1 <= self.min_area_px <= self.max_area_px):
            raise BadInput(
                "invalid detection parameters",
                expected="threshold and uncertainty above zero, 1 ≤ smallest ≤ largest area",
                got=f"{self.threshold_dn}, {self.uncertainty_rad}, {self.min_area_px}, {self.max_area_px}",
            )
        if self.window_px < 5 or self.window_px % 2 == 0 or self.averaged < 1:
            raise BadInput(
                "invalid window or number of averaged estimates",
                expected="an odd window of at least 5 px, at least 1 estimate",
                got=f"{self.window_px}, {self.averaged}",
            )

    def min_verified(self, mode: Mode) -> int:
        """Return the minimum number of verified stars for an attitude."""
        if self.acceptance == "document" or mode is Mode.TRACKING:
            return self.min_verified_tracking
        return self.min_verified_assisted if mode is Mode.ASSISTED else self.min_verified_lost

    @property
    def proves(self) -> bool:
        """True if the chain verifies its result."""
        return self.acceptance == "proved"


NOISE_SIGMAS = 5.0
DOCUMENT_UNCERTAINTY_RAD = float(np.radians(0.05))
OWN_PIXEL_RAD = 8.073e-4
UNCERTAINTY_PX = DOCUMENT_UNCERTAINTY_RAD / OWN_PIXEL_RAD
ANGLE_CLASS_RAD = float(np.radians(5.0))  # Liebe 1992, 'Inclusion of Position-Uncertainty'
BRIGHTNESS_ERROR = 0.25  # Liebe 1992, 'Inclusion of Magnitude-Uncertainty': 25 %
BLEND_PX = 3.0
HINT_ERROR_RAD = float(np.radians(5.0))
FLOOR_PX = 0.045
FAINTEST_AREA_PX = 6.0


def default_parameters(profile: CameraProfile, exposure_s: float | None = None) -> OerstedParameters:
    """Return the parameters for a camera. The document's position errors are converted to pixels."""
    sensor, camera = profile.sensor, profile.camera
    exposure = sensor.exposure_s if exposure_s is None else exposure_s
    noise_dn = sensor.noise_e(exposure) / sensor.gain_e_per_dn
    return OerstedParameters(
        threshold_dn=max(2.0, float(np.ceil(NOISE_SIGMAS * noise_dn))),
        dn_at_mag_0=float(sensor.star_e(0.0, exposure)) / sensor.gain_e_per_dn,
        uncertainty_rad=uncertainty_rad(profile),
        assisted_radius_rad=camera.half_diagonal_rad + HINT_ERROR_RAD,
        saturation_dn=_full_dn(profile),
        noise=PixelNoise(noise_dn, sensor.gain_e_per_dn, FLOOR_PX),
        capture_rad=max(float(np.radians(0.5)), 4 * uncertainty_rad(profile)),
    )


def uncertainty_rad(profile: CameraProfile) -> float:
    """Return the largest error of one star's position."""
    return UNCERTAINTY_PX * profile.camera.pixel_rad


def detectable_mag(profile: CameraProfile) -> float:
    """Return the magnitude of a star with area ``FAINTEST_AREA_PX`` above the threshold; the area is 2πσ² ln(peak / threshold)."""
    sensor = profile.sensor
    spread_px2 = 2 * np.pi * (sensor.psf_sigma_px**2 + 1 / 12)
    threshold_dn = default_parameters(profile).threshold_dn
    star_e = spread_px2 * threshold_dn * np.exp(FAINTEST_AREA_PX / spread_px2) * sensor.gain_e_per_dn
    return float(sensor.magnitude(star_e, sensor.exposure_s))


def _full_dn(profile: CameraProfile) -> float:
    """Return the saturation level of a pixel: slightly below the limit of the converter or the full well, whichever is lower."""
    s = profile.sensor
    return min(float(s.saturation_dn), s.bias_dn + s.full_well_e / s.gain_e_per_dn) * 0.99
