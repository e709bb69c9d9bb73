"""Attitudes of one frame over time, with the content of CCSDS attitude messages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import turn_between, turned

MAX_GAP_S = 600.0
"""Maximum time between two attitudes for interpolation."""


@dataclass(frozen=True)
class AttitudeHistory:
    """Attitudes of a frame of a spacecraft. ``frame``: name of the frame in CCSDS messages, for example STARTRACKER_1. ``times_s``
    (n,): Unix seconds, increasing. ``quaternions`` (n, 4): frame_from_icrs, scalar-last. ``sigma_rad`` (n, 3): standard deviations
    about the axes of the frame, NaN if unknown."""

    object_name: str
    frame: str
    times_s: Array
    quaternions: Array
    sigma_rad: Array

    def __post_init__(self) -> None:
        if not len(self.times_s):
            raise BadInput("There is no attitude in this time", expected="a time with attitudes")
        if not (np.diff(self.times_s) > 0).all():
            raise BadInput("The attitudes are not in order of time", expected="times that increase from line to line")

    def at(self, times_s: Array) -> Array:
        """Return (n, 4) quaternions at (n,) Unix seconds, interpolated with a constant rate. NaN outside the time span and between
        attitudes that are more than ``MAX_GAP_S`` apart, but not at the times of the attitudes themselves."""
        if len(self.times_s) == 1:
            same = np.abs(times_s - self.times_s[0]) < 1e-3
            return np.where(same[:, None], self.quaternions[0], np.nan)
        k = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, len(self.times_s) - 2)
        before, after = self.times_s[k], self.times_s[k + 1]
        fraction = (times_s - before) / (after - before)
        rotation = turn_between(self.quaternions[k], self.quaternions[k + 1])
        interpolated = turned(self.quaternions[k], rotation * fraction[:, None])
        near = (after - before <= MAX_GAP_S) | (times_s == before) | (times_s == after)
        valid = (times_s >= before) & (times_s <= after) & near
        return np.where(valid[:, None], interpolated, np.nan)
