"""Generate ground truth for comparing GSS with other programs, without the renderer and chains of GSS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from scipy.special import erf

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.camera import Camera, Pinhole
from gss.pipeline.identify.verify import SkyCatalogue

Array = NDArray[np.float64]
EPOCH_JYEAR = 2025.0
MERGE_PX = 3.0

# Sensor of the frames. Its noise floor is so high that photon noise and read-out noise limit the accuracy of centroids.
SIGMA_PX, E_PER_DN, BIAS_DN, DARK_E, READ_E = 1.0, 40.0, 8.0, 80.0, 40.0
PEAK_DN, RANGE_MAG, APART_PX, BORDER_PX, HALF_PX = 240.0, 3.0, 16.0, 12.0, 7


@dataclass(frozen=True)
class StarFrame:
    """Frame with its truth: (rows, columns) counts, (n, 2) true col and row, (n,) electrons, and the (n,) Cramér–Rao
    bound per axis in px."""

    pixels: NDArray[np.uint8]
    positions: Array
    flux_e: Array
    bound_px: Array


def star_frames(count: int, stars: int, seed: int, columns: int = 1024, rows: int = 512) -> list[StarFrame]:
    """Return frames of pixel-integrated Gaussian stars with Poisson photon noise, normal read-out noise and eight
    bits."""
    rng = np.random.default_rng(seed)
    return [_star_frame(rng, stars, columns, rows) for _ in range(count)]


def _star_frame(rng: np.random.Generator, stars: int, columns: int, rows: int) -> StarFrame:
    positions = _separated_positions(rng, stars, columns, rows)
    brightest_e = PEAK_DN * E_PER_DN / erf(0.5 / (SIGMA_PX * np.sqrt(2))) ** 2
    flux_e = brightest_e * 10 ** (-0.4 * rng.uniform(0, RANGE_MAG, stars))
    expected_e = np.full((rows, columns), DARK_E)
    bound_px = np.empty(stars)
    for i, ((col, row), light_e) in enumerate(zip(positions, flux_e, strict=True)):
        left, top = round(col) - HALF_PX, round(row) - HALF_PX
        across, slope = _profile(left, col)
        down, _ = _profile(top, row)
        spot_e = light_e * np.outer(down, across)
        variance_e2 = spot_e + DARK_E + READ_E**2 + E_PER_DN**2 / 12
        bound_px[i] = 1 / np.sqrt(np.sum((light_e * np.outer(down, slope)) ** 2 / variance_e2))
        expected_e[top : top + 2 * HALF_PX + 1, left : left + 2 * HALF_PX + 1] += spot_e
    signal_e = rng.poisson(expected_e) + rng.normal(0, READ_E, expected_e.shape)
    pixels = np.clip(np.rint(signal_e / E_PER_DN + BIAS_DN), 0, 255).astype(np.uint8)
    return StarFrame(pixels, positions, flux_e, bound_px)


def _separated_positions(rng: np.random.Generator, stars: int, columns: int, rows: int) -> Array:
    positions = np.empty((0, 2))
    while len(positions) < stars:
        position = rng.uniform([BORDER_PX, BORDER_PX], [columns - 1 - BORDER_PX, rows - 1 - BORDER_PX])
        if np.all(np.hypot(*(positions - position).T) > APART_PX):
            positions = np.vstack([positions, position])
    return positions


def _profile(first_px: int, centre_px: float) -> tuple[Array, Array]:
    """Return the share of the light in each pixel of a row, and its derivative with respect to the centre."""
    edges = np.arange(first_px, first_px + 2 * HALF_PX + 2) - 0.5 - centre_px
    share = 0.5 * np.diff(erf(edges / (SIGMA_PX * np.sqrt(2))))
    density = np.exp(-0.5 * (edges / SIGMA_PX) ** 2) / (SIGMA_PX * np.sqrt(2 * np.pi))
    return share, -np.diff(density)


@dataclass(frozen=True)
class Optics:
    """A camera without distortion, its magnitude limit, and the boresight error up to which a solution is correct."""

    name: str
    columns: int
    rows: int
    pitch_col_mm: float
    pitch_row_mm: float
    focal_mm: float
    faint_mag: float
    tolerance_rad: float

    @cached_property
    def camera(self) -> Camera:
        """Camera model that the chains use."""
        return Camera.from_optics(
            self.columns, self.rows, self.pitch_col_mm, self.pitch_row_mm, self.focal_mm, Pinhole()
        )

    @property
    def fov_rad(self) -> tuple[float, float]:
        """Horizontal and vertical field of view."""
        width_mm, height_mm = self.columns * self.pitch_col_mm, self.rows * self.pitch_row_mm
        return 2 * np.arctan(width_mm / 2 / self.focal_mm), 2 * np.arctan(height_mm / 2 / self.focal_mm)


CAMERAS = (
    Optics("cubestar", 1024, 512, 5.6e-3, 5.6e-3, 6.28, 3.8, float(np.radians(0.25))),
    Optics("sunsat", 752, 582, 6.5e-3, 6.25e-3, 25.0, 6.0, float(np.radians(0.10))),
)


@dataclass(frozen=True)
class CentroidList:
    """List of centroids, brightest first. ``offset_px``: (n, 2) col and row from the detector's centre; ``true_stars``:
    number of real stars in the list."""

    cam_from_icrs: Array
    offset_px: Array
    magnitude: Array
    true_stars: int


def visible_stars(optics: Optics) -> SkyCatalogue:
    """Return the stars up to the magnitude limit at the epoch. In pairs closer than three pixels the fainter star is
    dropped, because the camera does not resolve the pair."""
    table = propagate(load_stars(optics.faint_mag), EPOCH_JYEAR).brighter_than(optics.faint_mag)
    reach_rad = MERGE_PX * max(optics.pitch_col_mm, optics.pitch_row_mm) / optics.focal_mm
    close = cKDTree(table.icrs).query_pairs(2 * np.sin(reach_rad / 2), output_type="ndarray")
    keep = np.ones(len(table), bool)
    keep[close.max(axis=1)] = False
    return SkyCatalogue(table.hip[keep], table.icrs[keep], table.v_mag[keep])


@dataclass(frozen=True)
class Disturbance:
    """What differs between a list and the camera's model. ``false_stars``: number at random positions; ``missing``:
    probability that a star is not in the list; ``noise_px``: position error per axis; ``focal_scale``: true focal
    length as a multiple of the calibrated one; ``mirrored``: columns counted from the other side; ``no_star``: only
    false stars."""

    false_stars: int = 0
    missing: float = 0.0
    noise_px: float = 0.2
    focal_scale: float = 1.0
    mirrored: bool = False
    no_star: bool = False


def star_lists(
    sky: SkyCatalogue, optics: Optics, count: int, disturbance: Disturbance, seed: int
) -> list[CentroidList]:
    """Return scenes at random attitudes: noisy positions, 0.15 mag of photometric noise, false stars across the
    frame."""
    rng = np.random.default_rng(seed)
    return [_star_list(rng, sky, optics, disturbance) for _ in range(count)]


def _star_list(rng: np.random.Generator, sky: SkyCatalogue, optics: Optics, disturbance: Disturbance) -> CentroidList:
    matrix = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    camera_vectors = sky.icrs @ matrix.T
    focal = disturbance.focal_scale * optics.focal_mm / np.array([optics.pitch_col_mm, optics.pitch_row_mm])
    half = np.array([optics.columns, optics.rows]) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        positions = focal * camera_vectors[:, :2] / camera_vectors[:, 2:]
    inside = np.flatnonzero((camera_vectors[:, 2] > 0) & np.all(np.abs(positions) < half, axis=1))
    stars = positions[inside] + rng.normal(0, disturbance.noise_px, (len(inside), 2))
    star_mag = sky.v_mag[inside] + rng.normal(0, 0.15, len(inside))
    others = rng.uniform(-half, half, (disturbance.false_stars, 2))
    other_mag = rng.uniform(optics.faint_mag - 3, optics.faint_mag, disturbance.false_stars)
    seen = rng.uniform(size=len(inside)) >= (1.0 if disturbance.no_star else disturbance.missing)
    magnitude = np.concatenate([star_mag[seen], other_mag])
    order = np.argsort(magnitude)
    offset_px = np.concatenate([stars[seen], others])[order] * [-1 if disturbance.mirrored else 1, 1]
    return CentroidList(matrix, offset_px, magnitude[order], int(seen.sum()))
