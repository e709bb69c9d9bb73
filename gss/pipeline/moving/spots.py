"""Light sources of one solved frame that are not catalogue stars, as directions on the sky with covariance.

The frame is filtered with the width measured on its stars, catalogue stars are masked along their trails, and each
connected group of pixels above threshold is fitted as a point and as a line (``line_fit``). A line is accepted if it
improves χ² significantly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.aberration import aberrate
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.rotation import rotation_from_vector
from gss.domain.sensor import Sensor
from gss.domain.stars import StarTable
from gss.pipeline.detect import Detections, find_stars
from gss.pipeline.moving.groups import PEAK_SIGMA, pixel_groups
from gss.pipeline.moving.line_fit import POINT, WIDTH, cut_out, fit_line
from gss.pipeline.moving.sources import Source, fitted_source, without_pieces
from gss.pipeline.psf import brightest_dn
from gss.pipeline.star_mask import star_mask
from gss.pipeline.streaks import PIXEL_VARIANCE_PX2, trail_per_rad

WIDTH_STARS = 5
STAR_GATE_PX = 2.0
FLOOR_PX = 0.01
STEP_PX = 0.01


@dataclass(frozen=True)
class SolvedView:
    """Solved frame: time of mid exposure (Unix seconds), attitude with its covariance (rad², camera axes), camera,
    ``rate_rad_s`` (3,) of the camera in its axes (None: unknown), ``velocity_c`` (3,): velocity whose aberration is
    included in the attitude, or None."""

    time_s: float
    exposure_s: float
    camera: Camera
    cam_from_icrs: Array
    covariance_rad2: Array
    rate_rad_s: Array | None = None
    velocity_c: Array | None = None


@dataclass(frozen=True)
class FrameSpots:
    """Light sources of one frame; n is their number.

    ``pixels``, ``trail_px`` (n, 2), trail zero for points; ``longest_px`` (n,): longest trail that agrees with a point.
    ``icrs`` (n, 3) in the system of the catalogue (without aberration), ``covariance_rad2`` (n, 2, 2) towards east and
    north. ``ends_icrs`` (n, 2, 2, 3): direction of each end of the trail, if the object was there at the start or at
    the end of the exposure; ``ends_sigma_rad`` (n, 2). ``v_mag``, ``v_sigma``, ``snr`` (n,); ``sharp`` (n,) True for
    sources narrower than stars. ``limit_mag``: faintest detectable point; ``star_sigma_px``: width of stars.
    """

    view: SolvedView
    pixels: Array
    trail_px: Array
    longest_px: Array
    icrs: Array
    covariance_rad2: Array
    ends_icrs: Array
    ends_sigma_rad: Array
    v_mag: Array
    v_sigma: Array
    snr: Array
    sharp: NDArray[np.bool_]
    limit_mag: float
    star_sigma_px: float

    def __len__(self) -> int:
        return len(self.pixels)


@dataclass(frozen=True)
class _Photometry:
    """Magnitude of one digital number, and excess scatter of stars about their predicted positions."""

    zero_mag: float
    floor_px2: float
    variance_px2: float


def find_spots(pixels: NDArray[Any], view: SolvedView, stars: StarTable, sensor: Sensor) -> FrameSpots | None:
    """Find the sources of a (rows, columns) frame that are not in ``stars`` (apparent places at its date). None if too
    few stars are detected to measure brightness and width."""
    detections = find_stars(
        pixels,
        psf_sigma_px=sensor.psf_sigma_px,
        saturation_dn=float(sensor.saturation_dn),
        e_per_dn=sensor.gain_e_per_dn,
    )
    star_px, v_mag = _stars_on(view, stars)
    columns, rows = np.arange(pixels.shape[1]), np.arange(pixels.shape[0])
    level = detections.background.on_grid(columns, rows)
    image = (pixels - level).astype(np.float32)
    noise = float(np.median(detections.background.noise))
    ceiling = float(sensor.saturation_dn) - float(np.median(level))
    photometry = _photometry(image, noise, ceiling, detections, view, star_px, v_mag, sensor)
    if photometry is None:
        return None
    light_dn = 10 ** (-0.4 * (v_mag - photometry.zero_mag))
    mask = star_mask(image.shape, star_px, light_dn, star_trail_px(view, star_px), photometry.variance_px2, noise)
    spots = []
    free_image = np.where(mask, np.float32(np.nan), image)
    for group in pixel_groups(image, mask, noise, photometry.variance_px2):
        fit = fitted_source((image, free_image), noise, group, ceiling, sensor, photometry.variance_px2)
        if fit is not None:
            spots.append(fit)
    floor_dn = PEAK_SIGMA * noise * np.sqrt(4 * np.pi * photometry.variance_px2)
    spots = without_pieces(spots, photometry.variance_px2)
    return _spots(view, spots, photometry, photometry.zero_mag - 2.5 * float(np.log10(floor_dn)))


def star_trail_px(view: SolvedView, pixels: Array) -> Array:
    """Return the (n, 2) trails of stars in one exposure, from the camera's rotation; zero if it is unknown."""
    if view.rate_rad_s is None or not len(pixels):
        return np.zeros((len(pixels), 2))
    trail = trail_per_rad(view.camera, pixels) @ (view.rate_rad_s * view.exposure_s)
    return np.nan_to_num(trail)


def _stars_on(view: SolvedView, stars: StarTable) -> tuple[Array, Array]:
    """Return pixels and magnitudes of the catalogue stars on the detector or slightly beside it."""
    cam = stars.icrs @ view.cam_from_icrs.T
    ahead = np.flatnonzero(cam[:, 2] > np.cos(min(view.camera.half_diagonal_rad + 0.02, 1.5)))
    star_px = view.camera.project(cam[ahead])
    on = view.camera.contains(star_px, -20.0)
    return star_px[on], stars.v_mag[ahead][on]


def _photometry(
    image: NDArray[np.float32],
    noise: float,
    ceiling: float,
    detections: Detections,
    view: SolvedView,
    star_px: Array,
    v_mag: Array,
    sensor: Sensor,
) -> _Photometry | None:
    spots = detections.centroids.pixels
    if len(spots) < 3 or not len(star_px):
        return None
    gap = np.linalg.norm(spots[:, None] - star_px[None], axis=2)
    star = np.array([np.argmin(v_mag + np.where(g < STAR_GATE_PX, 0.0, 100.0)) for g in gap])
    good = (gap[np.arange(len(spots)), star] < STAR_GATE_PX) & (brightest_dn(image, spots) < 0.8 * ceiling)
    if np.count_nonzero(good) < 3:
        return None
    rows = np.flatnonzero(good)
    zero = float(np.median(v_mag[star[rows]] + 2.5 * np.log10(detections.centroids.flux_dn[rows])))
    off2 = float(np.median((spots[rows] - star_px[star[rows]]) ** 2)) / 0.455  # median of a squared normal deviate
    floor_px2 = max(off2 - float(np.median(detections.centroids.sigma_px[rows] ** 2)), FLOOR_PX**2)
    start = sensor.psf_sigma_px**2 + PIXEL_VARIANCE_PX2
    widths = []
    for k in rows[:WIDTH_STARS]:
        trail = star_trail_px(view, spots[k][None])[0]
        half = int(np.ceil(4 * np.sqrt(start) + np.abs(trail).max() / 2))
        col, row = (int(v) for v in np.rint(spots[k]))
        cut = cut_out(image, noise, col, row, half, ceiling, sensor.gain_e_per_dn)
        guess = np.array([detections.centroids.flux_dn[k], *(spots[k] - (col, row)), *trail, start])
        fit = fit_line(cut, guess, (*POINT, WIDTH))
        if fit is not None:
            widths.append(fit.variance_px2)
    return _Photometry(zero, floor_px2, float(np.median(widths)) if widths else start)


def _spots(view: SolvedView, sources: list[Source], photometry: _Photometry, limit_mag: float) -> FrameSpots:
    n = len(sources)
    fits = [f.fit for f in sources]
    pixels = np.array([np.array(f.pixel) + f.fit.centre_px for f in sources], float).reshape(n, 2)
    trail = np.array([f.trail_px for f in fits]).reshape(n, 2)
    floor = photometry.floor_px2 * np.eye(2)
    spread = np.array([f.covariance[:2, :2] * f.excess + floor for f in fits]).reshape(n, 2, 2)
    end_spread = np.array([f.end_covariance() * f.excess + floor for f in fits]).reshape(n, 2, 2, 2)
    icrs, covariance = _on_sky(view, pixels, spread)
    end_views = [replace(view, cam_from_icrs=attitude_at(view, sign * view.exposure_s / 2)) for sign in (-1, 1)]
    ends = [
        [_on_sky(at, pixels + sign * trail / 2, end_spread[:, k]) for at in end_views] for k, sign in enumerate((-1, 1))
    ]
    flux, snr = np.array([f.flux_dn for f in fits]), np.array([f.snr for f in fits])
    return FrameSpots(
        view,
        pixels,
        trail,
        np.array([f.longest_px for f in sources]),
        icrs,
        covariance,
        np.stack([np.stack([at[0] for at in end], axis=1) for end in ends], axis=1),
        np.stack([np.sqrt(np.trace(end[0][1], axis1=1, axis2=2) / 2) for end in ends], axis=1),
        photometry.zero_mag - 2.5 * np.log10(flux) if n else np.zeros(0),
        1.0857 / snr if n else np.zeros(0),
        snr,
        np.array([f.sharp for f in sources], bool),
        limit_mag,
        float(np.sqrt(photometry.variance_px2)),
    )


def _on_sky(view: SolvedView, pixels: Array, spread_px2: Array) -> tuple[Array, Array]:
    """Return (n, 3) directions and their (n, 2, 2) covariances, east and north, from (n, 2) pixels and covariances."""
    if not len(pixels):
        return np.zeros((0, 3)), np.zeros((0, 2, 2))
    camera, icrs_from_cam = view.camera, view.cam_from_icrs.T
    unit = camera.unproject(pixels)
    slopes = np.stack(
        [(camera.unproject(pixels + d) - camera.unproject(pixels - d)) / (2 * STEP_PX) for d in STEP_PX * np.eye(2)],
        axis=-1,
    )
    icrs = unit @ view.cam_from_icrs
    plane = tangent(icrs) @ icrs_from_cam
    by_pixel = plane @ slopes
    by_attitude = plane @ np.cross(np.eye(3)[None], unit[:, None]).transpose(0, 2, 1)
    covariance = by_pixel @ spread_px2 @ by_pixel.transpose(0, 2, 1)
    if np.isfinite(view.covariance_rad2).all():
        covariance = covariance + by_attitude @ view.covariance_rad2 @ by_attitude.transpose(0, 2, 1)
    if view.velocity_c is not None:
        icrs = aberrate(icrs, -np.asarray(view.velocity_c))
        icrs = icrs / np.linalg.norm(icrs, axis=1, keepdims=True)
    return icrs, covariance


def tangent(icrs: Array) -> Array:
    """Return the (n, 2, 3) unit vectors towards east and north at (n, 3) directions."""
    east = np.stack([-icrs[:, 1], icrs[:, 0], np.zeros(len(icrs))], axis=1)
    flat = np.hypot(icrs[:, 0], icrs[:, 1]) < 1e-12
    east[flat] = (0.0, 1.0, 0.0)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    return np.stack([east, np.cross(icrs, east)], axis=1)


def attitude_at(view: SolvedView, after_s: float) -> Array:
    """Return the (3, 3) attitude ``after_s`` seconds after mid exposure, at the camera's rate."""
    if view.rate_rad_s is None:
        return view.cam_from_icrs
    return np.asarray(rotation_from_vector(-view.rate_rad_s * after_s) @ view.cam_from_icrs)
