"""Simulate a unit whose lens deviates from its document, like the lens of every real unit. Calibration can then measure
the deviation."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from gss.domain.camera import Brown, BrownUndistort, Camera, Distortion, RadialTilt
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput

MAX_PERCENT = 10.0
CENTRE_PX = 4.0
"""Shift of the optical centre in pixels per percent of lens error; the seed determines its direction."""
DISTORTION_SHARE = 0.03
"""Relative change of each distortion coefficient per percent of lens error; the seed determines its sign."""


def own_lens(profile: CameraProfile, percent: float, seed: int) -> CameraProfile:
    """Return the profile with a lens that deviates from its document; with 0 percent, return the profile unchanged.

    The focal length changes by ``percent``. For each percent, the optical centre moves by 4 px and the distortion
    changes by 3 %. The lens depends only on the profile, the percentage and the seed. Raises BadInput beyond ±10
    percent.
    """
    if not abs(percent) <= MAX_PERCENT:
        expected = f"at most {MAX_PERCENT:g} %"
        raise BadInput("the lens error is out of range", expected=expected, got=f"{percent:g} %")
    if percent == 0:
        return profile
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x1E45]))
    factor, angle = 1 + percent / 100, float(rng.uniform(0, 2 * np.pi))
    shift_px = CENTRE_PX * abs(percent)
    camera = profile.camera
    moved = Camera(
        camera.columns,
        camera.rows,
        camera.focal_col_px * factor,
        camera.focal_row_px * factor,
        camera.centre_col_px + shift_px * float(np.cos(angle)),
        camera.centre_row_px + shift_px * float(np.sin(angle)),
        _changed_distortion(camera.distortion, percent, factor, rng),
    )
    return replace(profile, camera=moved, focal_mm=profile.focal_mm * factor)


def _changed_distortion(lens: Distortion, percent: float, factor: float, rng: np.random.Generator) -> Distortion:
    def change() -> float:
        return 1 + DISTORTION_SHARE * abs(percent) * float(rng.choice([-1.0, 1.0]))

    if isinstance(lens, RadialTilt):
        radial = tuple(k * change() for k in lens.radial)
        return RadialTilt(lens.focal_mm * factor, lens.tilt_max_rad * change(), lens.tilt_direction_rad, radial)
    if isinstance(lens, Brown | BrownUndistort):
        return replace(lens, **{f.name: getattr(lens, f.name) * change() for f in fields(lens)})
    return lens
