"""Huffman's simulated frames: Gaussian spots with the document's radiometry and the noise of its presets (Huffman 2006
§3.1–3.2, ch. 7).

Pixels are electrons above the dark level, as in the document. Quantisation and saturation are neglected, as in the
document.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Truth
from gss.domain.rotation import rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.far_mst_parameters import FarMstParameters, default_parameters
from gss.pipeline.render import spots, stars_near, truth_of

ZERO_POINT_MAG = 28.0
FRAMES = 14


@dataclass(frozen=True)
class Preset:
    """One of the document's parameter tables. ``gain``: the factor g of eq. 3.4, with which electrons are counted twice
    (dossier E1). ``dark_sigma_e``, ``read_sigma_e``: standard deviation of the dark current and of the read-out."""

    lens_m2: float
    ffsr_a_w: float
    exposure_s: float
    gain: float
    dark_sigma_e: float
    read_sigma_e: float
    psf_width_px: float

    @property
    def psf_sigma_px(self) -> float:
        """Standard deviation of the PSF: a quarter of the width (eqs. 4.13–4.22)."""
        return self.psf_width_px / 4

    @property
    def noise_e(self) -> float:
        """Dark and read noise combined, without the star's shot noise."""
        return float(np.hypot(self.dark_sigma_e, self.read_sigma_e))

    def star_e(self, v_mag: Array | float) -> Array:
        """Electrons of a star (eq. 3.4)."""
        light = self.lens_m2 * self.ffsr_a_w * self.exposure_s * self.gain
        return np.asarray(light * 10 ** ((ZERO_POINT_MAG - np.asarray(v_mag, float)) / 2.5))

    def magnitude(self, star_e: Array) -> Array:
        """Magnitude of a star, the inverse of eq. 3.4 (§5.3)."""
        return np.asarray(ZERO_POINT_MAG - 2.5 * np.log10(star_e / self.star_e(ZERO_POINT_MAG)))


TABLE_4_1 = Preset(3.14e-4, 0.12, 0.1, 10.0, 41.0**0.5, 40.0, 10.0)
TABLE_5_2 = Preset(np.pi * 1e-4, 0.12, 0.1, 10.0, 41.0, 40.0, 10.0)
# Table 7.1 prints 410 e for 0.1 s at 410 e/s, and g = 10. The intended values g = 1 and 41 e show the same stars.
TABLE_7_1 = Preset(1.77e-4, 0.12, 0.1, 1.0, 41.0**0.5, 39.0, 10.0)


def parameters(preset: Preset, threshold_sigma: float, prefilter: str, count: int = 13) -> FarMstParameters:
    """Return the chain's parameters for frames of a preset: electrons as digital numbers, and no limit on the number of
    stars."""
    return replace(
        default_parameters(shipped_camera("far_mst")),
        threshold_sigma=threshold_sigma,
        noise_dn=preset.noise_e,
        gain_e_per_dn=1.0,
        saturation_dn=float("inf"),
        psf_sigma_px=preset.psf_sigma_px,
        prefilter=prefilter,
        prefilter_count=count,
        max_area_px=5000,
        max_centroids=100,
        sigma_model="document",
        dark_dn=np.zeros((1024, 1280)),
    )


def frame(pixels: Array, v_mag: Array, preset: Preset, rng: np.random.Generator) -> Array:
    """Return a (1024, 1280) frame in electrons of stars at (n, 2) pixels, with shot noise of the light and normal noise
    of dark current and read-out."""
    light = spots(1024, 1280, pixels, preset.star_e(v_mag), preset.psf_sigma_px)
    signal = preset.noise_e * rng.standard_normal(light.shape, dtype=np.float32).astype(float)
    lit = light > 1e-3
    signal[lit] += rng.poisson(light[lit])
    return signal


def scattered(count: int, rng: np.random.Generator, apart_px: float, margin_px: float = 30.0) -> Array:
    """Return (count, 2) random positions on the detector, at least ``apart_px`` from each other and ``margin_px`` from
    the edge."""
    placed: list[Array] = []
    while len(placed) < count:
        at = rng.uniform(margin_px, (1279 - margin_px, 1023 - margin_px), 2)
        if all(np.hypot(*(at - other)) >= apart_px for other in placed):
            placed.append(at)
    return np.array(placed)


@dataclass(frozen=True)
class Snapshot:
    """One frame of a sequence: pixels in electrons, truth, attitude."""

    pixels: Array
    truth: Truth
    cam_from_icrs: Array


def sequence(
    stars: StarTable, camera: Camera, preset: Preset, rng: np.random.Generator, track: int, step_rad: float
) -> list[Snapshot]:
    """Render fourteen frames at a slow constant rate. Track 0 moves through the star-poor region between Procyon and
    Sirius (dossier §4.10: the document does not state its region). The other tracks have random starts and random axes
    across the boresight."""
    if track == 0:
        start, axis = cam_from_icrs(np.radians(118.0), np.radians(-5.0), 0.0), np.array([0.0, 1.0, 0.0])
    else:
        start = cam_from_icrs(2 * np.pi * rng.random(), float(np.arcsin(rng.uniform(-1, 1))), 2 * np.pi * rng.random())
        turn = 2 * np.pi * rng.random()
        axis = np.array([np.cos(turn), np.sin(turn), 0.0])
    snapshots = []
    for k in range(FRAMES):
        rotation = rotation_from_vector(-step_rad * k * axis) @ start
        truth = truth_of(stars_near(stars, camera, rotation, 20.0), camera, rotation)
        snapshots.append(Snapshot(frame(truth.pixels, truth.v_mag, preset, rng), truth, rotation))
    return snapshots
