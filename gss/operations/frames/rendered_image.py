"""Test images: the sky at a given pointing as a camera would see it, with the positions of its stars (Erlank 2013 app. A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.sources.hipparcos import FAINTEST_V_MAG, load_stars, propagate
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.pipeline.render import FalseStar, Rendered, render

MAX_FALSE_STARS = 500


@dataclass(frozen=True)
class RenderRequest:
    """``cam_from_icrs``: (3, 3) attitude at mid-exposure; ``rate_rad_s``: (3,) angular velocity in camera axes;
    ``false_stars``: spots that no catalogue contains, at random places, as bright as the camera's stars; ``epoch_jyear``:
    Julian year of the star positions. ``exposure_s`` None: the camera's own."""

    cam_from_icrs: Array
    exposure_s: float | None = None
    rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    false_stars: int = 0
    noise: bool = True
    seed: int = 1
    epoch_jyear: float = 2026.0


def draw(profile: CameraProfile, request: RenderRequest) -> Rendered:
    """Return the image and its truth; the same request gives the same image. Raises BadInput if the request is impossible."""
    if not 0 <= request.false_stars <= MAX_FALSE_STARS:
        got = str(request.false_stars)
        raise BadInput("impossible number of false stars", expected=f"0 – {MAX_FALSE_STARS}", got=got)
    camera, sensor = profile.camera, profile.sensor
    rng = np.random.default_rng(request.seed)
    faintest = min(sensor.faint_limit_mag, FAINTEST_V_MAG)
    places = rng.uniform((0, 0), (camera.columns - 1, camera.rows - 1), (request.false_stars, 2))
    v_mag = rng.uniform(min(sensor.bright_limit_mag, faintest - 1), faintest, request.false_stars)
    return render(
        propagate(load_stars(), request.epoch_jyear),
        camera,
        sensor,
        request.cam_from_icrs,
        sensor.exposure_s if request.exposure_s is None else request.exposure_s,
        rng,
        rate_rad_s=request.rate_rad_s,
        noise=request.noise,
        false_stars=[FalseStar(float(c), float(r), float(v)) for (c, r), v in zip(places, v_mag, strict=True)],
    )
