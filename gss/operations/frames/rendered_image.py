"""Rendered test images of the sky at a given attitude, with the true positions of their stars (Erlank 2013 app. A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.corrections.instrument_magnitude import as_seen_by
from gss.catalogue_tools.sources.hipparcos import FAINTEST_V_MAG, load_stars, propagate
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.domain.sensor import Defects
from gss.pipeline.render import FalseStar, Rendered, render

MAX_FALSE_STARS = 500
MAX_BLUR_PX, MAX_SKEW_MS = 20.0, 2000.0


@dataclass(frozen=True)
class RenderRequest:
    """Request for a test image.

    ``cam_from_icrs``: (3, 3) attitude at mid-exposure. ``exposure_s``: None for the default exposure of the camera.
    ``rate_rad_s``: (3,) angular velocity in camera axes. ``false_stars``: number of spots that are not catalogue stars, at
    random positions, as bright as the camera's stars. ``epoch_jyear``: Julian year of the star positions.
    ``star_colours``: stars have the magnitude of the camera instead of V. ``corner_blur_px``, ``row_skew_ms``: field
    curvature and rolling shutter, see :class:`gss.domain.sensor.Defects`.
    """

    cam_from_icrs: Array
    exposure_s: float | None = None
    rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    false_stars: int = 0
    noise: bool = True
    seed: int = 1
    epoch_jyear: float = 2026.0
    star_colours: bool = False
    corner_blur_px: float = 0.0
    row_skew_ms: float = 0.0


def draw(profile: CameraProfile, request: RenderRequest) -> Rendered:
    """Render the image and return it with its truth. Equal requests give equal images. Raises BadInput if the request is not
    valid."""
    if not 0 <= request.false_stars <= MAX_FALSE_STARS:
        got = str(request.false_stars)
        raise BadInput("the number of false stars is out of range", expected=f"0 – {MAX_FALSE_STARS}", got=got)
    for name, value, largest in (
        ("blur in the corner", request.corner_blur_px, MAX_BLUR_PX),
        ("time between the first and the last row", request.row_skew_ms, MAX_SKEW_MS),
    ):
        if not 0 <= value <= largest:
            raise BadInput(f"the {name} is out of range", expected=f"0 – {largest:g}", got=f"{value:g}")
    camera, sensor = profile.camera, profile.sensor
    stars = propagate(load_stars(), request.epoch_jyear)
    rng = np.random.default_rng(request.seed)
    faintest = min(sensor.faint_limit_mag, FAINTEST_V_MAG)
    positions = rng.uniform((0, 0), (camera.columns - 1, camera.rows - 1), (request.false_stars, 2))
    v_mag = rng.uniform(min(sensor.bright_limit_mag, faintest - 1), faintest, request.false_stars)
    return render(
        as_seen_by(stars, profile) if request.star_colours else stars,
        camera,
        sensor,
        request.cam_from_icrs,
        sensor.exposure_s if request.exposure_s is None else request.exposure_s,
        rng,
        rate_rad_s=request.rate_rad_s,
        noise=request.noise,
        defects=Defects(
            corner_blur_px=request.corner_blur_px,
            row_skew_ms=request.row_skew_ms,
            coupling_px=profile.defects.coupling_px,
        ),
        false_stars=[FalseStar(float(c), float(r), float(v)) for (c, r), v in zip(positions, v_mag, strict=True)],
    )
