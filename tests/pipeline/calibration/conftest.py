"""Star frames of every camera, with identified stars: true positions with noise, or rendered images measured with the
star fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.calibration.sightings import FrameStars, of_centroids
from gss.pipeline.psf import cut_stamps, fit_stars
from gss.pipeline.render import Rendered, render, stars_near, truth_of


@lru_cache
def sky() -> StarTable:
    """Return the catalogue to V 8."""
    return load_stars(8.0)


def attitudes(camera: Camera, count: int, min_stars: int, limit_mag: float, seed: int) -> list[Array]:
    """Return random attitudes with at least ``min_stars`` visible stars each."""
    rng, stars, accepted = np.random.default_rng(seed), sky().brighter_than(limit_mag), []
    while len(accepted) < count:
        attitude = matrix_from_quaternion(random_quaternion(rng))
        if len(truth_of(stars_near(stars, camera, attitude), camera, attitude).hip) >= min_stars:
            accepted.append(attitude)
    return accepted


def seen_frames(
    camera: Camera,
    *,
    frames: int = 30,
    sigma_px: float = 0.1,
    limit_mag: float = 5.0,
    min_stars: int = 5,
    max_stars: int = 60,
    seed: int = 1,
) -> list[FrameStars]:
    """Return frames with stars at their true positions plus normally distributed errors. No image is rendered, so the
    noise is exact.
    """
    rng, stars = np.random.default_rng([seed, 9]), sky().brighter_than(limit_mag)
    star_lists = []
    for k, attitude in enumerate(attitudes(camera, frames, min_stars, limit_mag, seed)):
        truth = truth_of(stars_near(stars, camera, attitude), camera, attitude)
        n = min(len(truth.hip), max_stars)
        rows = np.array([stars.row_of_hip[int(h)] for h in truth.hip[:n]])
        nan = np.full(n, np.nan)
        star_lists.append(
            FrameStars(
                f"frame {k}",
                camera.columns,
                camera.rows,
                truth.pixels[:n] + sigma_px * rng.normal(size=(n, 2)),
                np.full(n, sigma_px),
                stars.icrs[rows],
                stars.hip[rows],
                stars.v_mag[rows],
                stars.b_v[rows],
                nan,
                nan,
                np.zeros(n, np.int32),
                time_s=float(k),
            )
        )
    return star_lists


@lru_cache
def rendered_frames(
    name: str, count: int = 30, exposure: float = 2.0, seed: int = 1
) -> tuple[tuple[FrameStars, ...], tuple[Array, ...]]:
    """Return rendered frames of a profile with noise, measured with the star fit, and the true error of each star, (n,
    2) px.
    """
    profile = shipped_camera(name)
    rng, exposure_s = (
        np.random.default_rng([seed, 5]),
        min(exposure * profile.sensor.exposure_s, profile.sensor.exposure_max_s),
    )
    frames, errors = [], []
    for k, attitude in enumerate(attitudes(profile.camera, count, 4, 5.0 if name != "aim" else 7.0, seed)):
        picture = render(sky().brighter_than(7.5), profile.camera, profile.sensor, attitude, exposure_s, rng)
        centroids, hip, truth = measure(picture, profile)
        rows = np.array([sky().row_of_hip[int(h)] for h in hip], np.intp)
        size = (profile.camera.columns, profile.camera.rows)
        frames.append(of_centroids(f"frame {k}", size, centroids, sky(), rows, exposure_s, float(k)))
        errors.append(centroids.pixels - truth)
    return tuple(frames), tuple(errors)


def measure(picture: Rendered, profile: CameraProfile) -> tuple[Centroids, Array, Array]:
    """Fit the bright, complete and isolated stars. Returns centroids, Hipparcos numbers and true positions."""
    sensor, truth = profile.sensor, picture.truth
    half = int(np.ceil(3 * sensor.psf_sigma_px)) + 1
    gap = np.hypot(*(truth.pixels[:, None] - truth.pixels[None]).transpose(2, 0, 1))
    np.fill_diagonal(gap, np.inf)
    light = sensor.star_e(truth.v_mag, 1.0)
    isolated = ~((gap < 3 * half) & (light[None] > 0.03 * light[:, None])).any(axis=1)
    inside = profile.camera.contains(truth.pixels, half + 1.0)
    selected = np.flatnonzero(isolated & inside & (truth.v_mag < sensor.faint_limit_mag + 1.0))[:60]
    nearest_px = np.rint(truth.pixels[selected]).astype(np.intp)
    level = float(np.median(picture.pixels))
    spread = max(1.4826 * float(np.median(np.abs(picture.pixels - level))), 0.5)
    stamps = cut_stamps(
        picture.pixels, nearest_px[:, 0], nearest_px[:, 1], np.full(len(selected), level), half, sensor.saturation_dn
    )
    shape = (sensor.psf_sigma_px**2 + 1 / 12) * np.eye(2)
    fit = fit_stars(
        stamps, nearest_px[:, 0], nearest_px[:, 1], shape, np.full(len(selected), spread), sensor.gain_e_per_dn
    )
    accepted = (
        fit.good
        & stamps.use.all(axis=1)
        & (fit.sigma_px < 0.3)
        & (np.hypot(fit.col - nearest_px[:, 0], fit.row - nearest_px[:, 1]) < 1.2)
    )
    peak = stamps.value.max(axis=1)
    centroids = Centroids(fit.col, fit.row, fit.flux, peak + level, np.full(len(selected), 9, np.int32), fit.sigma_px)
    return centroids.take(accepted), truth.hip[selected][accepted], truth.pixels[selected][accepted]


def rough(camera: Camera) -> Camera:
    """Return an inaccurate initial camera: focal length 0.5 % too long, no distortion, optical centre in the middle of
    the detector.
    """
    middle = {"centre_col_px": (camera.columns - 1) / 2, "centre_row_px": (camera.rows - 1) / 2}
    ideal = Camera.from_fov(camera.columns, camera.rows, 1.0)
    undistorted = replace(camera, distortion=ideal.distortion, **middle)
    return undistorted.with_focal_scaled(1.005)


@pytest.fixture(scope="session")
def star_frames() -> Callable[..., list[FrameStars]]:
    """Function that returns frames of stars at known positions (``seen_frames``)."""
    return seen_frames


@pytest.fixture(scope="session")
def rendered() -> Callable[..., tuple[tuple[FrameStars, ...], tuple[Array, ...]]]:
    """Function that returns rendered and measured frames of a profile (``rendered_frames``)."""
    return rendered_frames


@pytest.fixture(scope="session")
def rough_camera() -> Callable[[Camera], Camera]:
    """Function that returns an inaccurate initial camera (``rough``)."""
    return rough


@pytest.fixture(scope="session")
def profile_of() -> Callable[[str], CameraProfile]:
    """Function that returns a shipped profile by name."""
    return shipped_camera
