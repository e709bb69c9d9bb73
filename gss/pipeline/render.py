"""Render a star frame with its ground truth, for the simulator and the statistical tests.

This module computes the light (expected electrons per pixel); ``readout`` models the detector. A star's light is a Gaussian
integrated over each pixel. The caller supplies the random generator, so a frame is reproducible from its seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.results import Truth
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector
from gss.domain.sensor import NO_DEFECTS, Defects, Sensor
from gss.domain.stars import StarTable
from gss.pipeline.chip import Chip
from gss.pipeline.readout import FixedPattern, HotPixel, Image, expose
from gss.pipeline.veil import Veil

STAMP_SIGMAS = 5.0
BLUR_STEP_SIGMAS = 0.5
MAX_BLUR_STEPS = 400
FAINTEST_E = 0.05
ROLLING_STEPS = 3
# A trail is drawn as overlapping spots. If a spot has less light than this value, each pixel receives far less than one
# electron from it.
FAINTEST_STEP_E = 0.05


@dataclass(frozen=True)
class FalseStar:
    """A star-like spot that is not in the catalogue: a planet, debris, a reflection."""

    col_px: float
    row_px: float
    v_mag: float


@dataclass(frozen=True)
class Lights:
    """Point sources that are not catalogue stars but move with the sky: (m, 3) ICRS directions and (m,) V magnitudes.
    Used for planets, and with many points for the Moon. They are blurred like stars, but are not listed in the
    truth."""

    icrs: Array
    v_mag: Array


@dataclass(frozen=True)
class Rendered:
    """A (rows, columns) frame, uint8 for up to eight bits and uint16 above, and its ground truth. ``dark``: (rows, n) pixels
    of the dark columns, None for a detector without them."""

    pixels: Image
    truth: Truth
    dark: Image | None = None


def render(
    stars: StarTable,
    camera: Camera,
    sensor: Sensor,
    cam_from_icrs: Array,
    exposure_s: float,
    rng: np.random.Generator,
    *,
    rate_rad_s: ArrayLike = (0.0, 0.0, 0.0),
    noise: bool = True,
    hot_pixels: Sequence[HotPixel] = (),
    false_stars: Sequence[FalseStar] = (),
    fixed_pattern: FixedPattern | None = None,
    lights: Lights | None = None,
    veil: Veil | None = None,
    chip: Chip | None = None,
    dark_factor: float = 1.0,
    defects: Defects = NO_DEFECTS,
) -> Rendered:
    """Render one exposure of the ``stars`` (their ``icrs`` as given, no propagation) at an attitude.

    ``rate_rad_s``: angular velocity of the camera relative to ICRS in camera axes; ``cam_from_icrs``: attitude at
    mid-exposure. Without ``noise`` the frame is the rounded expectation. The truth lists, brightest first, the stars whose
    mid-exposure position lies on the detector, including faint ones and those hidden by the Earth. ``lights``, ``veil``: other
    light; ``chip``: detector defects; ``dark_factor`` multiplies the dark current (temperature). ``defects``: field curvature,
    coupling of the video amplifier, and rolling shutter, whose attitude is that of the middle row; the other values are in
    ``chip``. Raises :class:`BadInput` if the exposure is not positive or the trails are too long to draw.
    """
    if not exposure_s > 0:
        raise BadInput("invalid exposure", expected="more than 0 s", got=f"{exposure_s} s")
    rate = np.asarray(rate_rad_s, float)
    skew_s = defects.row_skew_ms / 1000
    margin_px = STAMP_SIGMAS * (sensor.psf_sigma_px + defects.corner_blur_px)
    near = stars_near(stars, camera, cam_from_icrs, margin_px, float(np.linalg.norm(rate)) * (exposure_s + skew_s))
    if skew_s > 0:
        near = replace(near, icrs=_rolled(near.icrs, camera, cam_from_icrs, rate, skew_s))
        if lights is not None:
            lights = replace(lights, icrs=_rolled(lights.icrs, camera, cam_from_icrs, rate, skew_s))
    light = _expected_light(
        near, camera, sensor, cam_from_icrs, exposure_s, rate, false_stars, lights, defects.corner_blur_px
    )
    if veil is not None and veil.blocked is not None:
        light[veil.blocked] = 0.0
    picture = expose(
        light,
        sensor,
        exposure_s,
        rng,
        noise=noise,
        hot_pixels=hot_pixels,
        fixed_pattern=fixed_pattern,
        veil_e_s=None if veil is None else veil.e_s,
        chip=chip,
        dark_factor=dark_factor,
        dark_columns=sensor.dark_columns,
        coupling_px=defects.coupling_px,
    )
    pixels, dark = sensor.dark_columns.split(picture, camera.columns)
    return Rendered(pixels, truth_of(near, camera, cam_from_icrs), dark)


def stars_near(
    stars: StarTable, camera: Camera, cam_from_icrs: Array, margin_px: float = 0.0, margin_rad: float = 0.0
) -> StarTable:
    """Return the stars inside the cone around the detector's corners, widened by the margins. This excludes distant
    stars, which a distortion polynomial can map back onto the detector."""
    radius_rad = min(camera.half_diagonal_rad + 2 * margin_px * camera.pixel_rad + margin_rad, np.pi / 2 - 1e-3)
    return stars.take(np.flatnonzero(stars.icrs @ np.asarray(cam_from_icrs)[2] > np.cos(radius_rad)))


def truth_of(stars: StarTable, camera: Camera, cam_from_icrs: Array) -> Truth:
    """Return the ground truth: noise-free positions of the given stars (already near the field), brightest first."""
    pixels = camera.project(stars.icrs @ np.asarray(cam_from_icrs).T)
    index = np.flatnonzero(camera.contains(pixels))
    index = index[np.argsort(stars.v_mag[index], kind="stable")]
    return Truth(quaternion_from_matrix(cam_from_icrs), stars.hip[index], pixels[index], stars.v_mag[index])


def _expected_light(
    stars: StarTable,
    camera: Camera,
    sensor: Sensor,
    cam_from_icrs: Array,
    exposure_s: float,
    rate_rad_s: Array,
    false_stars: Sequence[FalseStar],
    lights: Lights | None,
    corner_blur_px: float,
) -> Array:
    """Return the (rows, columns) expected electrons of starlight."""
    icrs, v_mag = stars.icrs, stars.v_mag
    if lights is not None:
        icrs, v_mag = np.concatenate([icrs, lights.icrs]), np.concatenate([v_mag, lights.v_mag])
    paths = _paths(icrs, camera, cam_from_icrs, exposure_s, rate_rad_s, BLUR_STEP_SIGMAS * sensor.psf_sigma_px)
    steps = paths.shape[1]
    step_e = sensor.star_e(v_mag, exposure_s) / steps
    if steps > 1:
        visible = step_e > FAINTEST_STEP_E
        paths, step_e = paths[visible], step_e[visible]
    positions = [paths.reshape(-1, 2)]
    portions = [np.repeat(step_e, steps)]
    if false_stars:
        positions.append(np.array([[f.col_px, f.row_px] for f in false_stars], float))
        portions.append(sensor.star_e(np.array([f.v_mag for f in false_stars]), exposure_s))
    pixels = np.concatenate(positions)
    sigma_px: Array | float = sensor.psf_sigma_px
    if corner_blur_px > 0:
        sigma_px = np.hypot(sigma_px, corner_blur_px * corner_share(pixels, camera))
    return spots(camera.rows, camera.columns, pixels, np.concatenate(portions), sigma_px)


def corner_share(pixels: Array, camera: Camera) -> Array:
    """Return the squared distance of (n, 2) pixels from the optical centre, 1 in the farthest corner. The sag of a curved
    field, and with it the width of a defocused star image, grows in this way (Huffman 2006 §2.3, Fig. 2.4)."""
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    focal = np.array([camera.focal_col_px, camera.focal_row_px])
    corners = np.array([[c, r] for c in (0, camera.columns - 1) for r in (0, camera.rows - 1)])
    farthest = np.max(np.sum(((corners - centre) / focal) ** 2, axis=1))
    return np.asarray(np.sum(((pixels - centre) / focal) ** 2, axis=1) / farthest)


def _rolled(icrs: Array, camera: Camera, cam_from_icrs: Array, rate_rad_s: Array, skew_s: float) -> Array:
    """Return (n, 3) directions displaced by the rotation of the camera from the middle row's exposure to the exposure of
    the row on which each star is. Stars beyond the first and last rows move with these rows."""
    to_cam = np.asarray(cam_from_icrs)
    still = icrs @ to_cam.T
    speed_rad_s = float(np.linalg.norm(rate_rad_s))
    if speed_rad_s == 0:
        return icrs
    axis, turned = rate_rad_s / speed_rad_s, still
    for _ in range(ROLLING_STEPS):
        row = np.nan_to_num(camera.project(turned)[:, 1], nan=camera.rows / 2)
        late_s = (np.clip(row / (camera.rows - 1), 0.0, 1.0) - 0.5) * skew_s
        angle = -speed_rad_s * late_s[:, None]
        along = (still @ axis)[:, None] * axis
        turned = along + (still - along) * np.cos(angle) + np.cross(axis, still) * np.sin(angle)
    return np.asarray(turned @ to_cam)


def longest_trail_s(camera: Camera, sensor: Sensor, rate_rad_s: ArrayLike) -> float:
    """Return the longest exposure whose trails :func:`render` can draw at this angular velocity; infinite without rotation."""
    step_px = BLUR_STEP_SIGMAS * sensor.psf_sigma_px
    sweep_px_s = float(np.linalg.norm(rate_rad_s)) * max(camera.focal_col_px, camera.focal_row_px)
    drawn_px = (MAX_BLUR_STEPS - 1) * step_px * np.cos(camera.half_diagonal_rad) ** 2
    return float(drawn_px / sweep_px_s) if sweep_px_s > 0 else float("inf")


def _paths(
    icrs: Array, camera: Camera, cam_from_icrs: Array, exposure_s: float, rate_rad_s: Array, step_px: float
) -> Array:
    """Return (stars, steps, 2) pixel positions at the middles of equal parts of the exposure, dense enough for a
    continuous trail."""
    sweep_px = float(np.linalg.norm(rate_rad_s)) * exposure_s * max(camera.focal_col_px, camera.focal_row_px)
    if sweep_px < 1e-6:
        return camera.project(icrs @ np.asarray(cam_from_icrs).T)[:, None]
    # Away from the optical axis, the plate scale grows by up to 1/cos² of the field angle.
    steps = int(np.ceil(sweep_px / np.cos(camera.half_diagonal_rad) ** 2 / step_px)) + 1
    if steps > MAX_BLUR_STEPS:
        raise BadInput(
            "the camera rotates too fast to draw the trails",
            expected=f"at most {MAX_BLUR_STEPS * step_px:.0f} px of smear",
            got=f"{steps * step_px:.0f} px",
            hint="use a shorter exposure",
        )
    times_s = ((np.arange(steps) + 0.5) / steps - 0.5) * exposure_s
    rotations = np.stack([rotation_from_vector(-rate_rad_s * t) for t in times_s])
    at_middle = icrs @ np.asarray(cam_from_icrs).T
    return camera.project(np.einsum("tij,nj->nti", rotations, at_middle))


def spots(rows: int, columns: int, pixels: Array, electrons: Array, sigma_px: Array | float) -> Array:
    """Return the (rows, columns) sum of Gaussian spots integrated over the pixels. ``pixels``: (n, 2) col, row; NaN
    positions are skipped. ``sigma_px``: common or (n,)."""
    widths_px = np.broadcast_to(np.asarray(sigma_px, float), electrons.shape)
    half = int(np.ceil(STAMP_SIGMAS * float(np.max(widths_px[np.isfinite(widths_px)], initial=0.0))))
    drawn = np.isfinite(pixels).all(axis=1) & (electrons > FAINTEST_E / max(1, len(electrons)))
    drawn &= (pixels > -half - 1).all(axis=1) & (pixels < np.array([columns + half, rows + half])).all(axis=1)
    pixels, electrons, widths_px = pixels[drawn], electrons[drawn], widths_px[drawn, None]
    corner = np.rint(pixels).astype(np.intp) - half
    offsets = np.arange(2 * half + 1)
    across = _pixel_shares(corner[:, :1] + offsets - pixels[:, :1], widths_px)
    down = _pixel_shares(corner[:, 1:] + offsets - pixels[:, 1:], widths_px) * electrons[:, None]
    # The image is padded by one stamp on every side to avoid clipping of spots.
    pad = 2 * half + 2
    width = columns + 2 * pad
    first = (corner[:, 1] + pad) * width + corner[:, 0] + pad
    index = first[:, None, None] + (offsets * width)[:, None] + offsets
    stamps = down[:, :, None] * across[:, None, :]
    flat = np.bincount(index.ravel(), stamps.ravel(), (rows + 2 * pad) * width).astype(float, copy=False)
    return np.ascontiguousarray(flat.reshape(-1, width)[pad : pad + rows, pad : pad + columns])


def _pixel_shares(distance_px: Array, sigma_px: Array) -> Array:
    """Return the share of a one-dimensional Gaussian in a pixel whose centre is ``distance_px`` away."""
    scale = 1.0 / (np.sqrt(2.0) * sigma_px)
    return np.asarray(0.5 * (erf((distance_px + 0.5) * scale) - erf((distance_px - 0.5) * scale)))
