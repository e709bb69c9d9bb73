"""Elements of Jacobs's simulations: attitudes within limits, the bank of a sub-catalogue, observed stars with errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Centroids
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.sunsat_detect import brightness_dn
from gss.pipeline.chains.sunsat_frames import OrbitElements, cam_from_icrs_of
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import distance_table

LIMITING_MAG = 6.0
PAIR_MIN_RAD = float(np.radians(0.25))


@dataclass(frozen=True)
class AngleRanges:
    """Extreme values of roll, pitch, yaw, ω′, i and Ω (Jacobs 1995 Tables 3-5 and 5-2)."""

    roll_rad: tuple[float, float]
    pitch_rad: tuple[float, float]
    yaw_rad: tuple[float, float]
    latitude_rad: tuple[float, float]
    inclination_rad: tuple[float, float]
    raan_rad: tuple[float, float]


def _deg(low: float, high: float) -> tuple[float, float]:
    return float(np.radians(low)), float(np.radians(high))


TABLE_3_5 = AngleRanges(_deg(-10, 10), _deg(-5, 5), _deg(130, 140), _deg(0, 360), _deg(97, 97), _deg(0, 120))


def random_attitude(limits: AngleRanges, rng: np.random.Generator) -> Array:
    """Return a random (3, 3) cam_from_icrs with each angle uniformly distributed within its limits."""
    roll, pitch, yaw, latitude, inclination, raan = (
        float(rng.uniform(*pair))
        for pair in (
            limits.roll_rad,
            limits.pitch_rad,
            limits.yaw_rad,
            limits.latitude_rad,
            limits.inclination_rad,
            limits.raan_rad,
        )
    )
    return cam_from_icrs_of(OrbitElements(raan, inclination, latitude), roll, pitch, yaw)


def bank_of(stars: StarTable, camera: Camera) -> OnboardCatalogue:
    """Return the catalogue with its distance table, in the device's number formats."""
    table = distance_table(stars, PAIR_MIN_RAD, camera.diagonal_rad).single_precision()
    return OnboardCatalogue(stars.hip, stars.icrs, stars.v_mag.astype(np.float32), table)


@dataclass(frozen=True)
class Observed:
    """Centroids with errors, brightest first. ``row``: catalogue row of each centroid."""

    centroids: Centroids
    row: NDArray[np.intp]


def observe(
    stars: StarTable,
    camera: Camera,
    attitude: Array,
    sigma_rad: float,
    sigma_mag: float,
    parameters: SunsatParameters,
    rng: np.random.Generator,
) -> Observed:
    """Simulate the catalogue stars in view with normal errors of position per axis and of magnitude (§3.5)."""
    ahead = np.flatnonzero(stars.icrs @ attitude[2] > np.cos(camera.half_diagonal_rad + 1e-3))
    pixels = camera.project(stars.icrs[ahead] @ attitude.T)
    on = camera.contains(pixels)
    row, pixels = ahead[on], pixels[on]
    pixels = pixels + sigma_rad * np.array([camera.focal_col_px, camera.focal_row_px]) * rng.normal(size=pixels.shape)
    v_mag = stars.v_mag[row] + sigma_mag * rng.normal(size=len(row))
    order = np.argsort(v_mag, kind="stable")
    flux = brightness_dn(v_mag[order], parameters)
    sigma_px = max(sigma_rad / camera.pixel_rad, 1e-3)
    return Observed(Centroids.from_pixels(pixels[order], flux, sigma_px), row[order])


def sunsat_camera() -> Camera:
    """Return the camera without distortion, as in the document's simulations, with a field of 11.17° x 8.32°."""
    shipped = shipped_camera("sunsat").camera
    return Camera(shipped.columns, shipped.rows, shipped.focal_col_px, shipped.focal_row_px, 375.5, 290.5)
