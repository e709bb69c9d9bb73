"""Figures of one frame that change as the sensor ages: lens, focus, sensitivity per star colour, and counts of matched stars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import SolveResult
from gss.domain.sensor import Sensor
from gss.domain.stars import StarTable
from gss.pipeline.background import measure_background
from gss.pipeline.calibration.gaussian_fit import fit_spots
from gss.pipeline.calibration.robust import robust_sigma
from gss.pipeline.detect import find_stars
from gss.pipeline.rejected_stars import identified_stars, reach_of, rejected_stars
from gss.pipeline.star_mask import star_mask
from gss.pipeline.streaks import PIXEL_VARIANCE_PX2, trail_per_rad

LENS_STARS = 10
"""Minimum number of stars to determine focal length, centre and distortion in addition to the attitude."""
LENS_UNKNOWNS = 7
COLOUR_STARS = 3
FOCUS_STARS = 3
FOCUS_SNR = 20.0
CLIPPED_SHARE = 0.9
"""Ratio of peak to saturation level above which the light of a star is not used, because a part of it can be lost."""
COLOURS = (("blue", -1.0, 0.3), ("white", 0.3, 0.8), ("red", 0.8, 4.0))
"""Name and range of B−V."""
MIN_ERROR_PX = 0.01
FLUX_ERROR_MAG = 0.05
REJECT_SIGMAS = 4.0
BESIDE_PX = 20.0
APERTURE_SIGMAS = 5.0
MIN_APERTURE_SNR = 12.0
NEIGHBOUR_SHARE = 0.02
PARTICLE_SIGMAS = 8.0
Map = NDArray[np.float32]
COUNTS = ("matched stars", "sources without a star")
"""Figures that depend on the observed part of the sky. Their jumps are therefore not significant."""
FIGURES = {
    "focal length": "px",
    "centre column": "px",
    "centre row": "px",
    "distortion": "px",
    "PSF width": "px",
    **{f"light of {name} stars": "mag" for name, _, _ in COLOURS},
    **dict.fromkeys(COUNTS, ""),
}
"""Unit of each figure. Distortion: displacement at the corner; light: magnitudes lost relative to the sensor's zero point."""


@dataclass(frozen=True)
class HealthFrame:
    """One frame of a mission. ``time_s``: Unix seconds of mid exposure; ``pixels``: function that reads the frame,
    possibly called more than once; ``result``: None if the chain could not run; ``stars``: apparent places at the date
    of the frame, fainter than the frame shows; ``temperature_c``: NaN if unknown; ``place_rad``: latitude and longitude
    below the spacecraft, None if unknown."""

    name: str
    time_s: float
    exposure_s: float
    pixels: Callable[[], NDArray[Any]]
    result: SolveResult | None
    stars: StarTable
    temperature_c: float = float("nan")
    place_rad: tuple[float, float] | None = None

    @property
    def solved(self) -> bool:
        """True if the attitude is known."""
        return self.result is not None and self.result.attitude is not None


@dataclass(frozen=True)
class OverSky:
    """Frame above its local sky: (rows, columns) digital numbers, a mask of the pixels lit by catalogue stars, and the
    medians of sky level and pixel noise."""

    excess_dn: Map
    lit: NDArray[np.bool_]
    level_dn: float
    noise_dn: float

    @property
    def dark_dn(self) -> Map:
        """Return the excess over the sky, NaN under stars."""
        return np.where(self.lit, np.float32(np.nan), self.excess_dn)


def over_sky(frame: HealthFrame, pixels: NDArray[Any], sensor: Sensor) -> OverSky:
    """Subtract the sky of a solved frame and mask its stars."""
    sky = measure_background(pixels)
    columns, rows = np.arange(pixels.shape[1]), np.arange(pixels.shape[0])
    excess = (pixels - sky.on_grid(columns, rows)).astype(np.float32)
    noise = float(np.median(sky.noise))
    assert frame.result is not None  # noqa: S101 - the caller has looked
    return OverSky(excess, _lit(frame, frame.result, sensor, noise, pixels.shape), float(np.median(sky.level)), noise)


def _on_detector(frame: HealthFrame, result: SolveResult, beside_px: float) -> tuple[Array, Array, Array]:
    """Return positions (m, 2), V and B−V of the catalogue stars on the detector or up to ``beside_px`` beside it."""
    assert result.attitude is not None  # noqa: S101 - the caller has looked
    cam = frame.stars.icrs @ result.attitude.cam_from_icrs.T
    ahead = np.flatnonzero(cam[:, 2] > np.cos(min(result.camera.half_diagonal_rad + 0.02, 1.5)))
    positions = result.camera.project(cam[ahead])
    on = result.camera.contains(positions, -beside_px)
    return positions[on], frame.stars.v_mag[ahead][on], frame.stars.b_v[ahead][on]


def _lit(
    frame: HealthFrame, result: SolveResult, sensor: Sensor, noise_dn: float, shape: tuple[int, ...]
) -> NDArray[np.bool_]:
    """Return a (rows, columns) mask, True under catalogue stars."""
    positions, v_mag, _ = _on_detector(frame, result, BESIDE_PX)
    light_dn = sensor.star_e(v_mag, frame.exposure_s) / sensor.gain_e_per_dn
    trails = _trails_px(result, positions, frame.exposure_s)
    return star_mask(shape, positions, light_dn, trails, sensor.psf_sigma_px**2 + PIXEL_VARIANCE_PX2, noise_dn)


def _trails_px(result: SolveResult, positions: Array, exposure_s: float) -> Array:
    """Return the (m, 2) trails of stars at (m, 2) positions; zero if the rotation of the camera was not measured."""
    if result.turning is None or not len(positions):
        return np.zeros_like(positions)
    return np.nan_to_num(trail_per_rad(result.camera, positions) @ (result.turning.vector_rad_s * exposure_s))


def frame_figures(
    frame: HealthFrame, pixels: NDArray[Any], sky: OverSky, camera: Camera, sensor: Sensor
) -> dict[str, tuple[float, float]]:
    """Return value and standard deviation of each figure that can be measured in a solved frame. ``camera``: the
    calibration relative to which changes are measured."""
    result = frame.result
    assert result is not None  # noqa: S101 - the caller has looked
    assert result.matches is not None  # noqa: S101 - the caller has looked
    matched = len(np.unique(result.matches.centroid))
    unexplained = len(result.centroids) - matched
    counts = dict(zip(COUNTS, (matched, unexplained), strict=True))
    return {
        **lens_figures(frame, result, camera),
        **_focus(result, pixels, frame.exposure_s, sensor),
        **_light(result, frame, sky.excess_dn, sky.noise_dn, sensor),
        **{name: (float(n), max(1.0, float(np.sqrt(n)))) for name, n in counts.items()},
    }


def lens_figures(frame: HealthFrame, result: SolveResult, camera: Camera) -> dict[str, tuple[float, float]]:
    """Return focal length, centre and third-order distortion of the frame, fitted together with its attitude, where
    ``camera`` is the calibration. The fit includes the stars that the chain rejected, because a change of the lens
    moves stars out of its limit."""
    assert result.matches is not None  # noqa: S101 - the caller has looked
    seen = identified_stars(result, result.matches)
    seen = seen.with_others(rejected_stars(result, frame.stars, reach_of([result])))
    # The residuals are relative to the camera of the result, whose lens can be fitted to the frame.
    off = seen.pixels - camera.project(result.camera.unproject(seen.pixels - seen.residual_px))
    used = np.isfinite(off).all(axis=1)
    positions, off = seen.pixels[used], off[used]
    sigma = np.maximum(seen.sigma_px[used], MIN_ERROR_PX)
    if len(positions) < LENS_STARS:
        return {}
    half_px = np.hypot(camera.columns, camera.rows) / 2
    from_centre = positions - np.array([camera.centre_col_px, camera.centre_row_px])
    radius2 = np.sum(from_centre**2, axis=1, keepdims=True) / half_px**2
    # A shift of the centre moves all stars equally. A rotation of the camera has nearly the same effect; only the
    # projection distinguishes the two.
    columns = [
        trail_per_rad(camera, positions) / 1e3,
        from_centre[:, :, None] / half_px,
        np.broadcast_to(np.eye(2), (len(positions), 2, 2)),
        (from_centre * radius2)[:, :, None] / half_px,
    ]
    design = np.concatenate(columns, axis=2)
    keep = np.ones(len(positions), bool)
    for _ in range(3):
        if np.count_nonzero(keep) < LENS_STARS:
            return {}
        root = np.repeat(1 / sigma[keep], 2)
        rows = design[keep].reshape(-1, LENS_UNKNOWNS) * root[:, None]
        values, _, rank, _ = np.linalg.lstsq(rows, off[keep].ravel() * root, rcond=1e-9)
        if rank < LENS_UNKNOWNS:
            return {}
        scaled = np.linalg.norm(off - design @ values, axis=1) / sigma
        scale = max(float(np.median(scaled[keep])) / 1.1774, 1e-6)
        keep = scaled < REJECT_SIGMAS * scale
    errors = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows))) * max(scale, 0.3)
    # The column of the focal length is scaled: one unit moves a star at the corner by one pixel.
    to_focal = camera.focal_col_px / half_px
    return {
        "focal length": (camera.focal_col_px + to_focal * float(values[3]), to_focal * float(errors[3])),
        "centre column": (camera.centre_col_px + float(values[4]), float(errors[4])),
        "centre row": (camera.centre_row_px + float(values[5]), float(errors[5])),
        "distortion": (float(values[6]), float(errors[6])),
    }


def _focus(
    result: SolveResult, pixels: NDArray[Any], exposure_s: float, sensor: Sensor
) -> dict[str, tuple[float, float]]:
    """Return the median width of the stars across their trails. If the rotation was not measured, the trails are short, and
    their direction is the long axis of the typical star."""
    detections = find_stars(
        pixels,
        psf_sigma_px=sensor.psf_sigma_px,
        saturation_dn=float(sensor.saturation_dn),
        e_per_dn=sensor.gain_e_per_dn,
    )
    spots = fit_spots(pixels, detections, float(sensor.saturation_dn), FOCUS_SNR)
    if len(spots) < FOCUS_STARS:
        return {}
    shapes = np.array([s.covariance_px2 for s in spots])
    across = np.broadcast_to(np.linalg.eigh(np.median(shapes, axis=0))[1][:, 0], (len(spots), 2))
    if result.turning is not None:
        trails = _trails_px(result, np.array([(s.col_px, s.row_px) for s in spots]), exposure_s)
        length = np.maximum(np.linalg.norm(trails, axis=1, keepdims=True), 1e-9)
        across = trails[:, ::-1] * np.array([-1.0, 1.0]) / length
    return {"PSF width": _middle(np.sqrt(np.einsum("ni,nij,nj->n", across, shapes, across)), 0.05)}


def count_hits(excess_dn: Map, usual_dn: Map, noise_dn: float, e_per_dn: float) -> int:
    """Count connected groups of pixels above their usual value. NaN pixels are ignored."""
    limit = usual_dn + PARTICLE_SIGMAS * np.sqrt(noise_dn**2 + np.maximum(usual_dn, 0) / e_per_dn)
    return int(ndimage.label(excess_dn > limit, structure=np.ones((3, 3)))[1])


def _light(
    result: SolveResult, frame: HealthFrame, excess_dn: Map, noise_dn: float, sensor: Sensor
) -> dict[str, tuple[float, float]]:
    """Return the light lost by colour."""
    off, b_v = lost_light_mag(result, frame, excess_dn, noise_dn, sensor)
    figures = {}
    for name, low, high in COLOURS:
        in_range = off[(b_v >= low) & (b_v < high)]
        if len(in_range) >= COLOUR_STARS:
            figures[f"light of {name} stars"] = _middle(in_range, FLUX_ERROR_MAG)
    return figures


def lost_light_mag(
    result: SolveResult, frame: HealthFrame, excess_dn: Map, noise_dn: float, sensor: Sensor
) -> tuple[Array, Array]:
    """Return measured minus catalogue magnitude of the (m,) bright stars of a frame, positive if light is lost, and their
    B−V. A wide aperture around the whole trail is used, so a change of focus or a rotation does not appear as a change of
    sensitivity."""
    positions, v_mag, b_v = _on_detector(frame, result, 0.0)
    half_trail = np.abs(_trails_px(result, positions, frame.exposure_s)) / 2
    reach = np.ceil(APERTURE_SIGMAS * sensor.psf_sigma_px + half_trail).astype(int)
    flux = np.full(len(positions), np.nan)
    noise = noise_dn * np.sqrt(np.prod(2 * reach + 1, axis=1))
    bright = sensor.star_e(v_mag, frame.exposure_s) / sensor.gain_e_per_dn > MIN_APERTURE_SNR * noise
    gap = np.linalg.norm(positions[:, None] - positions[None, bright], axis=2).T
    # Stars with much light from neighbours in the aperture are excluded.
    fainter = 10 ** (-0.4 * (v_mag[None, :] - v_mag[bright][:, None]))
    alone = (
        np.where((gap < 2 * reach[bright].max(axis=1)[:, None]) & (gap > 0), fainter, 0.0).sum(axis=1)
    ) < NEIGHBOUR_SHARE
    for k in np.flatnonzero(bright)[alone]:
        (col, row), (across, down) = np.rint(positions[k]).astype(int), reach[k]
        if not (across <= col < excess_dn.shape[1] - across and down <= row < excess_dn.shape[0] - down):
            continue
        cut = excess_dn[row - down : row + down + 1, col - across : col + across + 1]
        if cut.max() < CLIPPED_SHARE * sensor.saturation_dn - sensor.bias_dn:
            flux[k] = cut.sum()
    good = flux > 0
    return sensor.magnitude(flux[good] * sensor.gain_e_per_dn, frame.exposure_s) - v_mag[good], b_v[good]


def _middle(values: Array, min_sigma: float) -> tuple[float, float]:
    """Return the median and its standard deviation."""
    spread = max(robust_sigma(values), min_sigma)
    return float(np.median(values)), 1.2533 * spread / float(np.sqrt(len(values)))
