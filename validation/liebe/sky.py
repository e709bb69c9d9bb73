"""Elements of Liebe's simulations: field of view, star list, and images with the document's kinds of error (Liebe
1992)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.oersted_match import OerstedCatalogue, prepare
from gss.pipeline.chains.oersted_parameters import BRIGHTNESS_ERROR
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable
from gss.skytables.triplets import faintest_mag

USED_STARS = 1107
OPENING_RAD = float(np.radians(30.0))
# A mean accuracy of 14.6″ with 18.9 stars implies a star error of 62″, well below the maximum of 3′.
STAR_SIGMA_RAD = 62.0 * ARCSEC_RAD
MAX_RAD = float(np.radians(0.05))
OUTSIDE_RAD = (2 * MAX_RAD, 10 * MAX_RAD)
BRIGHTNESS_SIGMA_MAG = 0.1


@dataclass(frozen=True)
class Situation:
    """Errors of an image. ``false``: number of false stars. ``outside``: number of stars with an error above the
    tolerance. ``missing``: number of missing stars."""

    title: str
    false: int = 0
    outside: int = 0
    missing: int = 0


SITUATIONS = (
    Situation("all stars inside tolerance"),
    Situation("1 false star", false=1),
    Situation("1 star outside tolerance", outside=1),
    Situation("2 stars outside tolerance", outside=2),
    Situation("1 outside, 1 false star", false=1, outside=1),
    Situation("1 star missing", missing=1),
)


def instrument() -> CameraProfile:
    """Return a camera with a square field of 707 square degrees, the area of a 30° circle. With 1107 stars it contains
    18.9 stars on average, as in the document."""
    area_sr = 2 * np.pi * (1 - np.cos(OPENING_RAD / 2))
    side_rad = 2 * float(np.arcsin(np.sqrt(np.sin(area_sr / 4))))
    return replace(shipped_camera("oersted"), camera=Camera.from_fov(600, 600, side_rad))


def catalogue(stars: StarTable) -> OerstedCatalogue:
    """Return the bank with the stars that can be among the 1107 brightest. Magnitudes are V; the document uses CCD
    magnitudes."""
    limit_mag = float(np.sort(stars.v_mag)[USED_STARS - 1])
    deep = stars.brighter_than(faintest_mag(limit_mag, BRIGHTNESS_ERROR))
    none = np.empty(0, np.int32)
    table = DistanceTable(none, none, np.empty(0), 0.0, 0.0)
    return prepare(OnboardCatalogue(deep.hip, deep.icrs, deep.v_mag, table), instrument())


@dataclass(frozen=True)
class Image:
    """Centroids, brightest first. ``row``: catalogue row of each centroid, −1 for a false star."""

    centroids: Centroids
    row: NDArray[np.intp]


def image(
    bank: OerstedCatalogue, camera: Camera, attitude: Array, situation: Situation, rng: np.random.Generator
) -> Image:
    """Simulate the image of the stars that are measured brighter than the limit, with position errors up to 3′ and the
    errors of the situation."""
    ahead = np.flatnonzero(bank.icrs @ attitude[2] > np.cos(camera.half_diagonal_rad))
    inside = camera.contains(camera.project(bank.icrs[ahead] @ attitude.T))
    mag = bank.stars.v_mag[ahead] + np.clip(BRIGHTNESS_SIGMA_MAG * rng.normal(size=len(ahead)), -0.24, 0.24)
    keep = np.flatnonzero(inside & (mag <= bank.triplets.limit_mag))
    row, mag = ahead[keep], mag[keep]
    if situation.missing and len(row):
        stay = np.sort(rng.permutation(len(row))[situation.missing :])
        row, mag = row[stay], mag[stay]
    off_rad = np.minimum(STAR_SIGMA_RAD * np.sqrt(rng.exponential(size=len(row))), MAX_RAD)
    outside = rng.permutation(len(row))[: situation.outside]
    off_rad[outside] = rng.uniform(*OUTSIDE_RAD, len(outside))
    bearing = rng.uniform(0, 2 * np.pi, len(row))
    offset_px = (off_rad / camera.pixel_rad)[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    pixels = camera.project(bank.icrs[row] @ attitude.T) + offset_px
    false = rng.uniform((0, 0), (camera.columns - 1, camera.rows - 1), (situation.false, 2))
    mag = np.concatenate([mag, rng.uniform(2, bank.triplets.limit_mag, situation.false)])
    order = np.argsort(mag, kind="stable")
    centroids = Centroids.from_pixels(
        np.vstack([pixels, false])[order],
        np.power(10.0, -0.4 * mag[order], dtype=float),
        STAR_SIGMA_RAD / camera.pixel_rad / np.sqrt(2),
    )
    return Image(centroids, np.concatenate([row, np.full(situation.false, -1)])[order])
