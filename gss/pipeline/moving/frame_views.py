"""Views of the solved frames of a sequence: attitude, covariance, and rate of the camera from neighbouring frames."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from gss.domain.angles import Array
from gss.domain.results import SolveResult
from gss.domain.rotation import vector_from_rotation
from gss.pipeline.moving.spots import SolvedView

MAX_STEP_S = 20.0
"""Maximum time between two attitudes from which the camera's rate is computed."""
UNSTEADY = 0.2
"""Maximum relative difference between the rates before and after a frame. If it is exceeded, the rate at the frame is
unknown."""
STEADY_PX = 1.0


def views_of(
    times_s: Sequence[float], exposures_s: Sequence[float], results: Sequence[SolveResult]
) -> list[SolvedView]:
    """Return the views of frames with an attitude, in order of time (Unix seconds)."""
    solved = [k for k, r in enumerate(results) if r.attitude is not None]
    attitudes = [a.cam_from_icrs for a in (results[k].attitude for k in solved) if a is not None]
    views = []
    for number, k in enumerate(solved):
        result = results[k]
        if result.attitude is None:
            continue
        near = [n for n in (number - 1, number, number + 1) if 0 <= n < len(solved)]
        rates = [
            rate_between(attitudes[a], attitudes[b], times_s[solved[b]] - times_s[solved[a]])
            for a, b in itertools.pairwise(near)
            if 0 < times_s[solved[b]] - times_s[solved[a]] <= MAX_STEP_S
        ]
        views.append(
            SolvedView(
                times_s[k],
                exposures_s[k],
                result.camera,
                attitudes[number],
                result.attitude.covariance_rad2,
                _common(rates, exposures_s[k], result.camera.pixel_rad),
                None if result.velocity_c is None else np.array(result.velocity_c),
            )
        )
    return views


def rate_between(first: Array, second: Array, step_s: float) -> Array:
    """Return the (3,) angular velocity, in camera axes, that rotates the camera from one (3, 3) attitude to another."""
    return np.asarray(-vector_from_rotation(second @ first.T) / step_s)


def _common(rates: list[Array], exposure_s: float, pixel_rad: float) -> Array | None:
    if not rates:
        return None
    mean = np.mean(rates, axis=0)
    spread = max(float(np.linalg.norm(r - mean)) for r in rates)
    allowed = max(UNSTEADY * float(np.linalg.norm(mean)), STEADY_PX * pixel_rad / exposure_s)
    return None if spread > allowed else np.asarray(mean)
