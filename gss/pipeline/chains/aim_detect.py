"""Stars in a frame of the AIM smart camera: predicted windows, coarse mask, mean locator (Moniteq 1983 §4, §6.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Centroids
from gss.pipeline.centroid import brightest_first
from gss.pipeline.chains.aim_match import AimCatalogue, expected_stars
from gss.pipeline.chains.aim_parameters import AimParameters
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.onboard import Detection
from gss.pipeline.coarse_mask import coarse_mask, dark_mean_dn, windows_mask
from gss.pipeline.hyperaccuracy import brightest_pixels, inside_frame
from gss.pipeline.mean_locator import mean_locations_px
from gss.pipeline.regions import Blobs, Pixels, SearchLimits, region_records, search
from gss.pipeline.track.search_and_track import VERIFIED_ENOUGH

# Position error of a saturated (flat-topped) star, measured on rendered frames.
SATURATED_PX = 0.15
OUTSIDE = "outside the predicted windows"
WHOLE_IMAGE = "guidance error: fewer than two predicted windows contain a star; the whole image was searched"


def find_centroids(
    pixels: Pixels,
    camera: Camera,
    catalogue: AimCatalogue,
    parameters: AimParameters,
    mode: Mode,
    hint: AttitudePrior | None,
) -> Detection:
    """Find the spots of the coarse image and compute the centroid of each in its window.

    In tracking, only spots in the windows around predicted stars are used. With fewer than two such spots, guidance has
    failed, and the whole image is used as in the blind search (Fig. 6.1 step 3).
    """
    p = parameters
    dark_dn = dark_mean_dn(pixels, p.noise_dn)
    mask = coarse_mask(pixels, dark_dn, p.noise_dn, p.coarse_block_px, p.coarse_sigmas)
    limits = SearchLimits(p.min_area_px, p.max_area_px, p.max_invalid, 1000, True)
    regions = search(np.where(mask, pixels, 0), dark_dn + p.threshold_dn, limits, 1)
    stars = regions.blobs.take(regions.accepted)
    col, row = brightest_pixels(pixels, stars)
    complete = inside_frame(col, row, pixels.shape, 2)
    measured = locate(pixels, stars.take(np.flatnonzero(complete)), dark_dn, p)
    rejected = list(regions.rejected)
    for k in regions.accepted[~complete].tolist():
        rejected[k] = "window leaves the frame"
    faint = measured.flux_dn < faintest_dn(catalogue, p)
    for k in regions.accepted[complete][faint].tolist():
        rejected[k] = f"fainter than V {catalogue.limit_mag:.1f}"
    keep, notes = ~faint, [regions.stopped] if regions.stopped else []
    if mode is Mode.TRACKING and hint is not None:
        half_px = p.capture_rad / camera.pixel_rad
        predicted_px = camera.project(expected_stars(catalogue, camera, hint, p).predicted_cam)
        inside = windows_mask(pixels.shape, predicted_px, half_px)[row[complete], col[complete]]
        if np.count_nonzero(inside & keep) >= VERIFIED_ENOUGH:
            for k in regions.accepted[complete][keep & ~inside].tolist():
                rejected[k] = OUTSIDE
            keep &= inside
        else:
            notes.append(WHOLE_IMAGE)
    centroids = measured.take(keep)
    return Detection(
        region_records(pixels, replace(regions, rejected=tuple(rejected)), dark_dn, p.max_small_regions),
        centroids.take(brightest_first(centroids)[: p.max_centroids]),
        regions.invalid,
        dark_dn,
        tuple(notes),
    )


def faintest_dn(catalogue: AimCatalogue, parameters: AimParameters) -> float:
    """Return the flux below which a star is too faint for the star list. This is the flux of a star that is fainter
    than the limit of the list by half the magnitude error."""
    limit_mag = catalogue.limit_mag + parameters.magnitude_error / 2
    return float(parameters.dn_at_mag_0 * parameters.light_share * 10 ** (-0.4 * limit_mag))


def locate(pixels: Pixels, blobs: Blobs, dark_dn: float, parameters: AimParameters) -> Centroids:
    """Apply the mean locator with dark mean and linear bias correction in a window at each blob's brightest pixel. A 4
    x 4 window is shifted towards the brighter side. ``sigma_px`` includes the noise model's third term and the star's
    shot noise."""
    p, n = parameters, len(blobs)
    if not n:
        return Centroids.from_pixels(np.empty((0, 2)))
    col, row = brightest_pixels(pixels, blobs)
    middle_col, middle_row = col.astype(float), row.astype(float)
    first_col, first_row = col - 1, row - 1
    if p.window_px == 4:
        value = pixels.astype(float)
        left, up = value[row, col - 1] > value[row, col + 1], value[row - 1, col] > value[row + 1, col]
        first_col, first_row = first_col - left, first_row - up
        middle_col, middle_row = first_col + 1.5, first_row + 1.5
    step = np.arange(p.window_px)
    stamp = pixels[first_row[:, None, None] + step[:, None], first_col[:, None, None] + step].astype(float)
    off_col, off_row, flux = mean_locations_px(stamp, dark_dn)
    peak = stamp.max(axis=(1, 2))
    sigma = _sigma_px(stamp - dark_dn, off_col, off_row, flux, p)
    sigma = np.where(peak >= p.saturation_dn, np.hypot(sigma, SATURATED_PX), sigma)
    return Centroids(
        middle_col + p.gain * off_col,
        middle_row + p.gain * off_row,
        flux,
        peak - dark_dn,
        blobs.area_px.astype(np.int32),
        sigma,
    )


def _sigma_px(light: Array, off_col: Array, off_row: Array, flux: Array, p: AimParameters) -> Array:
    position = np.arange(p.window_px) - (p.window_px - 1) / 2
    arm2 = (position[:, None] - off_row[:, None, None]) ** 2 + (position - off_col[:, None, None]) ** 2
    variance = p.noise_dn**2 + np.maximum(light, 0.0) / p.gain_e_per_dn
    return np.asarray(np.sqrt(p.gain**2 * (arm2 * variance).sum(axis=(1, 2)) / (2 * flux**2) + p.floor_px**2))
