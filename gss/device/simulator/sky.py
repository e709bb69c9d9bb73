"""What the camera sees: real stars at the simulated date, drawn through the profile's camera and sensor.

Proper motion to the epoch is in; annual and orbital aberration, planets, stray light and fixed-pattern noise are not yet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.hipparcos import load_stars, propagate
from gss.device.simulator.orbit import Motion
from gss.domain.profiles import CameraProfile
from gss.domain.results import Truth
from gss.pipeline.render import render

FAINTER_MAG = 2.5
DEEPEST_MAG = 8.0


@dataclass(frozen=True)
class Exposure:
    """One image and the truth of mid-exposure."""

    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    truth: Truth


class Sky:
    """Draws exposures. The seed and the frame number decide the noise; time decides the pointing."""

    def __init__(self, profile: CameraProfile, motion: Motion, epoch_jyear: float, seed: int) -> None:
        self._profile, self._motion, self._seed = profile, motion, seed
        faintest = min(profile.sensor.faint_limit_mag + FAINTER_MAG, DEEPEST_MAG)
        self._stars = propagate(load_stars(faintest), epoch_jyear)

    def expose(self, mid_time_s: float, exposure_s: float, frame_number: int) -> Exposure:
        """The image whose middle is at that device time."""
        pose = self._motion.at(mid_time_s)
        rng = np.random.default_rng(np.random.SeedSequence([self._seed, frame_number]))
        drawn = render(
            self._stars,
            self._profile.camera,
            self._profile.sensor,
            pose.cam_from_icrs,
            exposure_s,
            rng,
            rate_rad_s=pose.rate_rad_s,
        )
        return Exposure(drawn.pixels, drawn.truth)

    def rate_rad_s(self, time_s: float) -> float:
        """How fast the camera turns."""
        return float(np.linalg.norm(self._motion.at(time_s).rate_rad_s))
