"""Elements of Erlank's simulations: camera, bank, star images and acceptance test."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Truth
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.cubestar_parameters import CubestarParameters, default_parameters
from gss.pipeline.chains.modes import AttitudePrior
from gss.pipeline.identify.geometric_voting import agreement, cluster, pairs_of, reduced_table, vote
from gss.pipeline.render import stars_near, truth_of
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable, distance_table

BANK_MAG = 3.8
# With 54° across 1024 pixels, one pixel in the middle is 0.001 rad, which §4.3.5 describes as about a pixel. The 6 mm
# and 5.6 µm in the same sentence would give 51.1° x 26.9°.
FIELD_RAD = float(np.radians(54.0))
TOLERANCE_RAD = 0.001
VOTE_MARGIN = 1
ASSISTED_RAD = float(np.radians(35.0))
HINT_ERROR_RAD = float(np.radians(5.0))


def simulated_camera() -> Camera:
    """Return the camera of the artificial images: 1024 x 512, 54° x 28.6°, no distortion (Erlank 2013 §4.3.5)."""
    return Camera.from_fov(1024, 512, FIELD_RAD)


def simulated_parameters() -> CubestarParameters:
    """Return the chain's constants for :func:`simulated_camera`, with the document's tolerance and radius."""
    profile = replace(shipped_camera("cubestar"), camera=simulated_camera())
    return replace(default_parameters(profile), tolerance_rad=TOLERANCE_RAD, assisted_radius_rad=ASSISTED_RAD)


def bank_of(stars: StarTable, camera: Camera, pairs: int | None = None) -> OnboardCatalogue:
    """Return the bank of stars to V 3.8 with all distances up to the field's diagonal, in the device's number formats.
    ``pairs``: keep only this number of shortest distances; None: all."""
    bright = stars.brighter_than(BANK_MAG)
    distances = distance_table(bright, 0.0, camera.diagonal_rad)
    in_bank = slice(0, pairs)
    distance_rad = distances.distance_rad[in_bank].astype(np.float32)
    largest_rad = camera.diagonal_rad if pairs is None else float(distance_rad[-1])
    table = DistanceTable(distances.first[in_bank], distances.second[in_bank], distance_rad, 0.0, largest_rad)
    return OnboardCatalogue(bright.hip, bright.icrs.astype(np.float32), bright.v_mag.astype(np.float32), table)


def random_attitude(rng: np.random.Generator) -> Array:
    """Return a random (3, 3) cam_from_icrs, uniform over the sphere and the roll."""
    return matrix_from_quaternion(random_quaternion(rng))


def in_view(stars: StarTable, camera: Camera, attitude: Array) -> Truth:
    """Return the stars on the detector, brightest first."""
    return truth_of(stars_near(stars, camera, attitude), camera, attitude)


def rough_hint(attitude: Array, largest_rad: float, rng: np.random.Generator) -> AttitudePrior:
    """Return a boresight hint with an error up to ``largest_rad`` in any direction (Erlank 2013 §4.3.5)."""
    axis = rng.normal(size=3)
    axis -= axis @ attitude[2] * attitude[2]
    angle_rad = largest_rad * rng.random()
    return AttitudePrior(np.cos(angle_rad) * attitude[2] + np.sin(angle_rad) * axis / np.linalg.norm(axis))


@dataclass(frozen=True)
class Drawing:
    """Drawing method of stars. ``floor_col``, ``floor_row``: True if the 5 x 5 grid is centred on the pixel before the
    star's position instead of on the nearest pixel."""

    sigma_px: float = 1.0
    peak_dn: float = 255.0
    floor_col: bool = False
    floor_row: bool = False


def star_image(pixels: Array, camera: Camera, drawing: Drawing | None = None) -> NDArray[np.uint8]:
    """Return a (rows, columns) image of 5 x 5 Gaussians of equal brightness on black (Erlank 2013 eq. 4.1.7)."""
    style = drawing if drawing is not None else Drawing()
    image = np.zeros((camera.rows, camera.columns))
    step = np.arange(-2, 3)
    for col_px, row_px in pixels:
        col = (int(np.floor(col_px)) if style.floor_col else round(float(col_px))) + step
        row = (int(np.floor(row_px)) if style.floor_row else round(float(row_px))) + step
        col, row = col[(col >= 0) & (col < camera.columns)], row[(row >= 0) & (row < camera.rows)]
        square = (col[None] - col_px) ** 2 + (row[:, None] - row_px) ** 2
        image[np.ix_(row, col)] += style.peak_dn * np.exp(-square / (2 * style.sigma_px**2))
    return np.rint(np.minimum(image, 255.0)).astype(np.uint8)


def document_rows(
    unit_cam: Array, bank: OnboardCatalogue, hint: AttitudePrior | None, tolerance_rad: float = TOLERANCE_RAD
) -> NDArray[np.intp]:
    """Return the (n,) catalogue row of each of (n, 3) directions, −1 if unmatched, with the document's acceptance. The
    document accepts every star whose number of verification votes differs by at most one from the highest number
    (§4.3.3), without a test of the whole set."""
    table = bank.distances
    if hint is not None:
        table = reduced_table(table, bank.icrs @ hint.boresight_icrs >= np.cos(ASSISTED_RAD))
    pairs = pairs_of(unit_cam)
    ballot = vote(pairs, len(unit_cam), table, len(bank), tolerance_rad)
    votes = agreement(pairs, ballot.row, bank, tolerance_rad).sum(axis=1)
    named = np.full(len(unit_cam), -1, np.intp)
    chosen = cluster(votes, VOTE_MARGIN)
    named[chosen] = ballot.row[chosen]
    return named
