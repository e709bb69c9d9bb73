"""Constants of CubeStar's chain, sources of the constants, and values for a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.pipeline.centroid import PixelNoise
from gss.pipeline.chains.modes import Mode

NAME = "cubestar"

MIN_VERIFIED = (
    "GSS: four without prior, three with a hint or in tracking, because two stars also match a mirrored frame; "
    "Erlank 2013 §4.5 requires two in tracking: acceptance 'document'"
)
SOURCES: dict[str, str] = {
    "threshold_dn": "Erlank 2013 §5.3.3 gives 6 above black for its camera and a semi-urban sky; GSS: raised until "
    "a star 0.25 mag below the catalogue's limit covers fewer than min_area_px, to match the content of the bank",
    "min_area_px": "Erlank 2013 §5.3.3: six",
    "max_area_px": "Erlank 2013 §5.3.3: sixty",
    "max_invalid": "Erlank 2013 §5.3.3: search stops at more than fifty",
    "max_centroids": "Erlank 2013 §5.3.3–4: twenty",
    "edge_rule": "Jacobs 1995 §2.2.3, because Erlank 2013 §4.1.2 adopts its region growing: the centroid of a star "
    "cut by the edge has an error of 0.9 px",
    "search_step_px": "Erlank 2013 §4.1.1: every third pixel of every third row",
    "window_px": "Erlank 2013 §4.1.3: 5 x 5",
    "tolerance_rad": "Erlank 2013 §4.3.5: 0.001 rad, about one pixel; other cameras: 1.12 pixels as well",
    "vote_margin": "Erlank 2013 §4.3.3: within one of the most votes",
    "min_verified_lost": MIN_VERIFIED,
    "min_verified_assisted": MIN_VERIFIED,
    "min_verified_tracking": MIN_VERIFIED,
    "acceptance": "GSS 'proved': no mirror-symmetric pattern, no star displaced from the position predicted by the others, "
    "no residuals of three or four stars that are less probable than an accidental match, and none if the field indicates "
    "another focal length; 'document': without these conditions (Erlank 2013 §4.3–4.5)",
    "max_false_probability": "GSS: largest accepted bound on the probability of an accidental identification",
    "tracking_radius_rad": "Erlank 2013 §4.5: 0.3°",
    "assisted_radius_rad": "Erlank 2013 §4.3.4: 35°; other cameras: half diagonal + 5°",
    "undistort": "exact inverse of the camera's model; 'document' is Erlank 2013 eq. 4.1.3–4 with inverted signs",
    "noise": "from the profile's sensor; the floor of 0.05 px is the size of Erlank 2013 §4.1.6's errors without noise",
    "max_small_regions": "GSS: regions below min_area_px that a report of a frame lists, to bound its size",
}
LIMITS: dict[str, tuple[float, float]] = {
    "threshold_dn": (1, 20_000),
    "min_area_px": (1, 60),
    "max_area_px": (10, 100_000),
    "max_invalid": (0, 1_000),
    "max_centroids": (3, 100),
    "search_step_px": (1, 30),
    "window_px": (3, 15),
    "tolerance_rad": (1e-5, 0.01),
    "vote_margin": (0, 10),
    "min_verified_lost": (2, 100),
    "min_verified_assisted": (2, 100),
    "min_verified_tracking": (2, 100),
    "max_false_probability": (1e-12, 1),
    "tracking_radius_rad": (1e-4, 0.1),
    "assisted_radius_rad": (0.01, np.pi),
    "max_small_regions": (0, 10_000),
}
"""Lowest and highest value of each number that a rerun can change."""


@dataclass(frozen=True)
class CubestarParameters:
    """Constants of the chain; see ``SOURCES`` for their sources. ``threshold_dn`` is above the frame's black level."""

    limits = LIMITS

    threshold_dn: float
    tolerance_rad: float
    assisted_radius_rad: float
    noise: PixelNoise
    min_area_px: int = 6
    max_area_px: int = 60
    max_invalid: int = 50
    max_centroids: int = 20
    edge_rule: bool = True
    search_step_px: int = 3
    window_px: int = 5
    vote_margin: int = 1
    min_verified_lost: int = 4
    min_verified_assisted: int = 3
    min_verified_tracking: int = 3
    acceptance: str = "proved"
    max_false_probability: float = 1e-3
    tracking_radius_rad: float = float(np.radians(0.3))
    undistort: str = "exact"
    max_small_regions: int = 100

    def __post_init__(self) -> None:
        if self.acceptance not in ("proved", "document"):
            raise BadInput("unknown acceptance", expected="proved | document", got=self.acceptance)
        if self.undistort not in ("exact", "document"):
            raise BadInput("unknown undistortion method", expected="exact | document", got=self.undistort)
        if not (self.threshold_dn > 0 and self.tolerance_rad > 0 and 1 <= self.min_area_px <= self.max_area_px):
            raise BadInput(
                "invalid detection parameters",
                expected="threshold and tolerance above zero, 1 ≤ smallest ≤ largest area",
                got=f"{self.threshold_dn}, {self.tolerance_rad}, {self.min_area_px}, {self.max_area_px}",
            )

    def min_verified(self, mode: Mode) -> int:
        """Return the minimum number of verified stars for an attitude."""
        if mode is Mode.TRACKING:
            return self.min_verified_tracking if self.proves else DOCUMENT_TRACKING
        return self.min_verified_assisted if mode is Mode.ASSISTED else self.min_verified_lost

    @property
    def proves(self) -> bool:
        """True if the chain checks handedness and focal length."""
        return self.acceptance == "proved"


FAINTER_MAG = 0.25
DOCUMENT_TRACKING = 2
DOCUMENT_THRESHOLD_DN = 6.0
DOCUMENT_RADIUS_RAD = float(np.radians(35.0))
NOISE_SIGMAS = 4.0
TOLERANCE_PX = 0.001 * 6.28 / 0.0056
HINT_ERROR_RAD = float(np.radians(5.0))


def default_parameters(profile: CameraProfile, exposure_s: float | None = None) -> CubestarParameters:
    """Return the parameters for a camera. Values in pixels and counts are those of the document; angles are scaled to
    the camera."""
    sensor, camera = profile.sensor, profile.camera
    exposure = sensor.exposure_s if exposure_s is None else exposure_s
    noise_dn = sensor.noise_e(exposure) / sensor.gain_e_per_dn
    own_radius_rad = DOCUMENT_RADIUS_RAD if profile.name == NAME else 0.0
    return CubestarParameters(
        threshold_dn=max(
            DOCUMENT_THRESHOLD_DN,
            round(NOISE_SIGMAS * noise_dn),
            round(_level_where_faintest_vanishes_dn(sensor, exposure)),
        ),
        tolerance_rad=TOLERANCE_PX * camera.pixel_rad,
        assisted_radius_rad=max(own_radius_rad, camera.half_diagonal_rad + HINT_ERROR_RAD),
        noise=PixelNoise(noise_dn, sensor.gain_e_per_dn, 0.05),
    )


def _level_where_faintest_vanishes_dn(sensor: Sensor, exposure_s: float) -> float:
    """Return the level above which a Gaussian star just below the limiting magnitude covers six pixels: 2πσ² ln(peak /
    level) = 6."""
    spread_px2 = 2 * np.pi * (sensor.psf_sigma_px**2 + 1 / 12)
    star_dn = float(sensor.star_e(sensor.faint_limit_mag + FAINTER_MAG, exposure_s)) / sensor.gain_e_per_dn
    return float(star_dn / spread_px2 * np.exp(-6 / spread_px2))
