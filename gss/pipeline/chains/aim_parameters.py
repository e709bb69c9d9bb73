"""Constants of the AIM smart camera's chain, sources of the constants, and values for a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.pipeline.chains.modes import Mode
from gss.pipeline.mean_locator import bias_gain, column_shares

NAME = "aim"

MIN_VERIFIED = (
    "GSS: four without prior, three with a hint (Moniteq 1983 §2.1 requires three), two in tracking (Fig. 6.1 "
    "step 2f), where two may rotate the attitude by at most capture_rad, because two also match a mirrored frame; with acceptance "
    "'document' always two (Fig. 6.1 step 3h)"
)
SOURCES: dict[str, str] = {
    "threshold_dn": "GSS: five times the noise of a dark pixel above the dark mean; Moniteq 1983 gives no threshold",
    "coarse_block_px": "GSS: 4 x 4, the read-out block of Moniteq 1983 §3.8; Fig. 6.1 states no size for its coarse image",
    "coarse_sigmas": "GSS: five times the noise of a block",
    "window_px": "Moniteq 1983 §4.2: 3 x 3 adopted; the sensor reads 4 x 4",
    "gain": "Moniteq 1983 §4.2: linear bias corrector; its factor follows from the star's width "
    "and the window (mean_locator.bias_gain)",
    "dn_at_mag_0": "from the profile's sensor: converts the flux in a window to magnitudes",
    "light_share": "from the profile's sensor: fraction of a star's light in the window (K of Moniteq 1983 §4.3)",
    "magnitude_error": "Moniteq 1983 §2.1: ξ = 0.5 mag",
    "tolerance_rad": "GSS: a quarter of a pixel, ten times the error of V 6, so that faint companions have no effect; "
    "Moniteq 1983 §2.1 assumes δ = 0.01°, 0.74 px",
    "capture_rad": "GSS: 0.3°; Moniteq 1983 §6.1 expects shifts below 1° between pictures and predicts them",
    "assisted_radius_rad": "GSS: half diagonal + 5°; 'large subsection of sky' in Moniteq 1983 Fig. 6.1",
    "max_invalid": "GSS: as in Erlank 2013 §5.3.3, the search stops at more than fifty oversized regions",
    "saturation_dn": "from the profile's sensor",
    "min_area_px": "GSS: a single pixel above the threshold is a hot pixel or noise",
    "max_area_px": "GSS: a star of V −1.5 covers at most 25 pixels; larger regions are the Moon, a reflection or stray light",
    "floor_px": "GSS: systematic error of the corrected mean locator (1 %) and faint companions",
    "gain_e_per_dn": "from the profile's sensor",
    "max_hypotheses": "GSS: number of pairs of linked stars that a blind search tries, best first",
    "max_centroids": "GSS: a field of 3.45° has about ten stars to V 7.5",
    "min_verified_lost": MIN_VERIFIED,
    "min_verified_assisted": MIN_VERIFIED,
    "min_verified_tracking": MIN_VERIFIED,
    "max_false_probability": "GSS: largest accepted bound on the probability of an accidental identification",
    "acceptance": "GSS 'proved': residuals, displaced stars, the error of the boresight and the false-match bound decide; "
    "'document': a pattern of two linked stars is sufficient, which according to §2.1 is accidental in one of six cases",
    "noise_dn": "from the profile's sensor: Moniteq 1983 §4.3's third term; the floor of 0.03 px covers its systematic error "
    "of 1 % and companions",
    "max_small_regions": "GSS: regions below min_area_px that a report of a frame lists, to bound its size",
}
LIMITS: dict[str, tuple[float, float]] = {
    "threshold_dn": (1, 20_000),
    "coarse_block_px": (1, 32),
    "coarse_sigmas": (0.5, 50),
    "window_px": (3, 4),
    "gain": (0.3, 10),
    "dn_at_mag_0": (100, 1e8),
    "light_share": (0.05, 1),
    "magnitude_error": (0.05, 5),
    "tolerance_rad": (1e-6, 2e-3),
    "capture_rad": (1e-4, 0.1),
    "assisted_radius_rad": (0.01, np.pi),
    "max_invalid": (0, 1_000),
    "saturation_dn": (10, 1e6),
    "min_area_px": (1, 60),
    "max_area_px": (10, 100_000),
    "floor_px": (1e-3, 1),
    "gain_e_per_dn": (0.01, 10_000),
    "noise_dn": (0.05, 1_000),
    "max_hypotheses": (1, 40_000),
    "max_centroids": (3, 100),
    "min_verified_lost": (2, 100),
    "min_verified_assisted": (2, 100),
    "min_verified_tracking": (2, 100),
    "max_false_probability": (1e-12, 1),
    "max_small_regions": (0, 10_000),
}
"""Lowest and highest value of each number that a rerun can change."""


@dataclass(frozen=True)
class AimParameters:
    """Constants of the chain; see ``SOURCES`` for their sources. ``threshold_dn`` is above the frame's dark mean."""

    limits = LIMITS

    threshold_dn: float
    dn_at_mag_0: float
    tolerance_rad: float
    assisted_radius_rad: float
    saturation_dn: float
    noise_dn: float
    gain_e_per_dn: float
    gain: float
    light_share: float
    coarse_block_px: int = 4
    coarse_sigmas: float = 5.0
    window_px: int = 3
    min_area_px: int = 2
    max_area_px: int = 60
    max_invalid: int = 50
    max_centroids: int = 20
    magnitude_error: float = 0.5
    capture_rad: float = float(np.radians(0.3))
    max_hypotheses: int = 4000
    min_verified_lost: int = 4
    min_verified_assisted: int = 3
    min_verified_tracking: int = 2
    max_false_probability: float = 1e-3
    acceptance: str = "proved"
    floor_px: float = 0.03
    max_small_regions: int = 100

    def __post_init__(self) -> None:
        if self.acceptance not in ("proved", "document"):
            raise BadInput("unknown acceptance", expected="proved | document", got=self.acceptance)
        if self.window_px not in (3, 4) or self.coarse_block_px < 1:
            raise BadInput(
                "invalid window or block size",
                expected="a window of 3 or 4 px, a block of at least 1 px",
                got=f"{self.window_px}, {self.coarse_block_px}",
            )
        if not (self.threshold_dn > 0 and self.tolerance_rad > 0 and 1 <= self.min_area_px <= self.max_area_px):
            raise BadInput(
                "invalid detection parameters",
                expected="threshold and tolerance above zero, 1 ≤ smallest ≤ largest area",
                got=f"{self.threshold_dn}, {self.tolerance_rad}, {self.min_area_px}, {self.max_area_px}",
            )

    def min_verified(self, mode: Mode) -> int:
        """Return the minimum number of verified stars for an attitude."""
        if self.acceptance == "document":
            return DOCUMENT_VERIFIED
        if mode is Mode.TRACKING:
            return self.min_verified_tracking
        return self.min_verified_assisted if mode is Mode.ASSISTED else self.min_verified_lost

    @property
    def proves(self) -> bool:
        """True if the chain verifies its result."""
        return self.acceptance == "proved"


NOISE_SIGMAS = 5.0
DOCUMENT_VERIFIED = 2
TOLERANCE_PX = 0.25
HINT_ERROR_RAD = float(np.radians(5.0))
FAINTEST_AREA_PX = 3.0


def default_parameters(profile: CameraProfile, exposure_s: float | None = None, window_px: int = 3) -> AimParameters:
    """Return the parameters for a camera. Position errors are proportional to the size of a pixel, and the bias
    corrector to the width of the stars."""
    sensor, camera = profile.sensor, profile.camera
    exposure = sensor.exposure_s if exposure_s is None else exposure_s
    noise_dn = sensor.noise_e(exposure) / sensor.gain_e_per_dn
    ratio = 1.0 / sensor.psf_sigma_px
    return AimParameters(
        threshold_dn=max(2.0, float(np.ceil(NOISE_SIGMAS * noise_dn))),
        dn_at_mag_0=float(sensor.star_e(0.0, exposure)) / sensor.gain_e_per_dn,
        tolerance_rad=TOLERANCE_PX * camera.pixel_rad,
        assisted_radius_rad=camera.half_diagonal_rad + HINT_ERROR_RAD,
        saturation_dn=0.99
        * min(float(sensor.saturation_dn), sensor.bias_dn + sensor.full_well_e / sensor.gain_e_per_dn),
        noise_dn=noise_dn,
        gain_e_per_dn=sensor.gain_e_per_dn,
        gain=bias_gain(ratio, window_px),
        light_share=light_share(ratio, window_px),
        window_px=window_px,
    )


def light_share(ratio: float, window_px: int) -> float:
    """Return the mean share of a star's light in the window, for stars within half a pixel of its centre."""
    offset = np.linspace(-0.5, 0.5, 101)
    return float(np.mean(column_shares(offset, ratio, window_px).sum(axis=-1)) ** 2)


def detectable_mag(profile: CameraProfile) -> float:
    """Return the magnitude of a star with area ``FAINTEST_AREA_PX`` above the threshold; the area is 2πσ² ln(peak / threshold)."""
    sensor = profile.sensor
    spread_px2 = 2 * np.pi * (sensor.psf_sigma_px**2 + 1 / 12)
    threshold_dn = default_parameters(profile).threshold_dn
    star_e = spread_px2 * threshold_dn * np.exp(FAINTEST_AREA_PX / spread_px2) * sensor.gain_e_per_dn
    return float(sensor.magnitude(star_e, sensor.exposure_s))
