"""Constants of the FAR-MST chain, sources of the constants, and values for a camera."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import bdtrc, ndtr

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput

NAME = "far_mst"

PREFILTERS = ("sliding", "block", "none")
CENTROIDERS = ("weighted_sum", "mle")
SIGMA_MODELS = ("measured", "document")
MATCHERS = ("auto", "n3", "n4", "n5", "pyramid", "pivot")
ATTITUDES = ("quest", "q_method", "svd", "foam", "pad")
ACCEPTANCES = ("bound", "document")

SOURCES: dict[str, str] = {
    "threshold_dn": "Huffman 2006 §4.1: n·σ_noise; if not set, threshold_sigma times σ; "
    "σ is that of the sensor, or of the frame if larger",
    "threshold_sigma": "Huffman 2006 §4.1: n of n·σ_noise, 1 … 5; GSS: with 2, the pre-filter keeps the most pixels of a star at "
    "the magnitude limit",
    "noise_dn": "from the profile's sensor",
    "gain_e_per_dn": "from the profile's sensor",
    "saturation_dn": "from the profile's sensor",
    "psf_sigma_px": "from the profile's sensor",
    "prefilter": "Huffman 2006 §4.2.2: sliding (starCentroid2) is better above 1.75 σ (Table 8.1), block is starCentroid3",
    "prefilter_count": "Huffman 2006 §4.1 uses 9, §4.2.2 more than half of 25, both for spots of 10 px at 1 σ; GSS: the smallest "
    "count that passes less than one noise pixel per frame at this n",
    "min_area_px": "Huffman 2006 §4.2.2: fewer than 4 pixels are a noise spike or a hot pixel",
    "max_area_px": "GSS: V −1.5 smeared over 60 px at the published 15°/s",
    "max_aspect_ratio": "Huffman 2006 §4.2.2 uses the ratio for streaks without a limit; GSS: 2.5, or twice the "
    "median if all stars are "
    "streaks",
    "edge_rule": "GSS: a star cut by the frame's edge has a wrong centroid (dossier §4.4: it causes the published scatter)",
    "max_lit_share": "GSS: twice the 16 % of pixels above 1 σ from noise alone (Huffman 2006 §4.1); more indicates a bright sky",
    "centroider": "Huffman 2006 §4.2.2 chose the weighted sum; 'mle' is Winick's, 0.1 px better according to Huffman, but too slow",
    "sigma_model": "'document' is Huffman 2006 eq. 4.2, fitted to spots of 10 px; 'measured' propagates pixel noise and adds "
    "the excess seen in rendered frames",
    "max_centroids": "GSS: twice the average of 16 stars to V 4.5 in the frame",
    "max_vertex_stars": "GSS: figures use the brightest sixteen stars (Huffman 2006 §5.4.4: brightest first)",
    "matcher": "Huffman 2006 Fig. 8.2: n-vertex with a catalogue; figures of five stars first, then four, then three; "
    "'pivot' is §5.4.1",
    "most_figures": "GSS: maximum figures examined for n = 3, 4, 5 before the search fails (Huffman 2006 §5.5.4 tries all)",
    "most_hypotheses": "GSS: maximum identified figures that are completed and rated before the search fails",
    "sigmas": "GSS, after dossier §3.15: pairs agree within 3.5 of their standard deviations",
    "floor_px": "GSS: aberration across the frame and the numeric resolution of the bank",
    "tracking_radius_rad": "GSS: 1°, the motion at the lowest published rate of 1°/s and 1 Hz (Huffman 2006 Table 1.3)",
    "assisted_radius_rad": "GSS: half diagonal + 5°",
    "attitude_method": "Huffman 2006 §6.1.3 chose QUEST; 'pad' is §6.1.2",
    "acceptance": "'document' accepts a unique figure (Huffman 2006 §5.5.4); 'bound' (GSS): all stars identified, a "
    "bound on an accidental identification, no star displaced from the position predicted by the others, and no other "
    "focal length indicated by the field",
    "max_false_probability": "GSS: largest accepted bound",
    "min_identified": "GSS: four without prior, three with a hint, two in tracking",
    "min_share": "GSS: with a wrong plate scale a small group can match accidentally; a third of the identifiable stars "
    "must be identified",
    "dark_dn": "Huffman 2006 §4.1: per-pixel median over frames of a sequence; without one, the frame's own median",
    "max_small_regions": "GSS: maximum number of regions below min_area_px in the report of a frame, which limits its size",
}
LIMITS: dict[str, tuple[float, float]] = {
    "threshold_dn": (0.5, 20_000),
    "threshold_sigma": (0.5, 50),
    "noise_dn": (0.05, 100),
    "gain_e_per_dn": (0.01, 10_000),
    "saturation_dn": (10, 1e6),
    "psf_sigma_px": (0.2, 5),
    "prefilter_count": (1, 25),
    "min_area_px": (1, 60),
    "max_area_px": (10, 100_000),
    "max_aspect_ratio": (1, 100),
    "max_lit_share": (1e-3, 1),
    "max_centroids": (3, 100),
    "max_vertex_stars": (3, 32),
    "most_figures": (0, 6_000),
    "most_hypotheses": (1, 1_500),
    "sigmas": (0.5, 12),
    "floor_px": (0.01, 1),
    "tracking_radius_rad": (1e-3, 0.2),
    "assisted_radius_rad": (0.01, np.pi),
    "max_false_probability": (1e-12, 1),
    "min_identified": (2, 100),
    "min_share": (0, 1),
    "max_small_regions": (0, 10_000),
}
"""Lowest and highest value of each number that a rerun can change."""


@dataclass(frozen=True)
class FarMstParameters:
    """Constants of the chain; see ``SOURCES`` for their sources. ``threshold_dn`` is above the dark level.
    ``dark_dn``: (rows, columns) dark frame or None. ``noise_dn``: standard deviation of a dark pixel."""

    limits = LIMITS

    threshold_sigma: float
    noise_dn: float
    gain_e_per_dn: float
    saturation_dn: float
    psf_sigma_px: float
    assisted_radius_rad: float
    prefilter_count: int
    threshold_dn: float | None = None
    prefilter: str = "sliding"
    min_area_px: int = 4
    max_area_px: int = 800
    max_aspect_ratio: float = 2.5
    edge_rule: bool = True
    max_lit_share: float = 0.32
    centroider: str = "weighted_sum"
    sigma_model: str = "measured"
    max_centroids: int = 32
    max_vertex_stars: int = 16
    matcher: str = "auto"
    most_figures: tuple[int, int, int] = (560, 120, 20)
    most_hypotheses: int = 150
    sigmas: float = 3.5
    floor_px: float = 0.2
    tracking_radius_rad: float = float(np.radians(1.0))
    attitude_method: str = "quest"
    acceptance: str = "bound"
    max_false_probability: float = 1e-3
    min_identified: tuple[int, int, int] = (4, 3, 2)
    min_share: float = 0.34
    max_small_regions: int = 100
    dark_dn: Array | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        for name, choices in (
            ("prefilter", PREFILTERS),
            ("centroider", CENTROIDERS),
            ("sigma_model", SIGMA_MODELS),
            ("matcher", MATCHERS),
            ("attitude_method", ATTITUDES),
            ("acceptance", ACCEPTANCES),
        ):
            if getattr(self, name) not in choices:
                raise BadInput(f"unknown {name}", expected=" | ".join(choices), got=str(getattr(self, name)))
        threshold = self.threshold_sigma if self.threshold_dn is None else self.threshold_dn
        if not (threshold > 0 and self.noise_dn > 0 and 1 <= self.min_area_px <= self.max_area_px):
            raise BadInput(
                "invalid detection parameters",
                expected="threshold and noise above zero, 1 ≤ smallest ≤ largest area",
                got=f"{threshold}, {self.noise_dn}, {self.min_area_px}, {self.max_area_px}",
            )


THRESHOLD_SIGMA = 2.0
PREFILTER_PX = 5
HINT_ERROR_RAD = float(np.radians(5.0))


def default_parameters(profile: CameraProfile, exposure_s: float | None = None) -> FarMstParameters:
    """Return the parameters for a camera."""
    sensor, camera = profile.sensor, profile.camera
    exposure = sensor.exposure_s if exposure_s is None else exposure_s
    return FarMstParameters(
        threshold_sigma=THRESHOLD_SIGMA,
        noise_dn=sensor.noise_e(exposure) / sensor.gain_e_per_dn,
        gain_e_per_dn=sensor.gain_e_per_dn,
        saturation_dn=float(sensor.saturation_dn),
        psf_sigma_px=sensor.psf_sigma_px,
        assisted_radius_rad=camera.half_diagonal_rad + HINT_ERROR_RAD,
        prefilter_count=min_prefilter_count(THRESHOLD_SIGMA, camera.columns * camera.rows),
    )


def min_prefilter_count(threshold_sigma: float, pixels: int) -> int:
    """Return the smallest count of 25 for which pure noise leaves less than one pixel per frame after the pre-filter."""
    chance = float(ndtr(-threshold_sigma))
    neighbours = PREFILTER_PX**2 - 1
    for count in range(1, neighbours + 1):
        if pixels * chance * float(bdtrc(count - 2, neighbours, chance)) < 1:
            return count
    return neighbours + 1
