"""Solution of image sequences. Each solution is the hint for the next image. The rate is computed from two successive
solutions."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput
from gss.domain.frames import pointing_difference_rad
from gss.domain.results import Attitude, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.domain.stars import StarTable
from gss.operations.frames.scoring import truth_on
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.system_sequence import SystemSequencer
from gss.pipeline.chains.systems import SYSTEMS
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.rates import Rate, rate_between
from gss.pipeline.score import score
from gss.pipeline.streaks import with_sign_of

FOLLOW_RAD = math.radians(5.0)
"""Maximum rotation of the camera between two tracked images."""


class RateRecord(TypedDict):
    """Rate between two images in the camera frame. ``deg_s``: vector. ``sigma_deg_s``: standard deviation per axis, None if
    unknown. ``speed_deg_s``: length of the vector."""

    interval_s: float
    deg_s: list[float]
    sigma_deg_s: list[float | None]
    speed_deg_s: float


class TruthRecord(TypedDict):
    """Verdict and errors of a solution relative to the true attitude."""

    verdict: str
    error_arcsec: float
    error_roll_arcsec: float


class ImageIntervals:
    """Times between successive images. ``stated_s``: time between images without time stamps. It is also used from the first
    two images with equal time stamps on, because the stamps are then too coarse."""

    def __init__(self, stated_s: float | None) -> None:
        if stated_s is not None and not stated_s > 0:
            raise BadInput("interval is out of range", expected="above 0 s", got=f"{stated_s:g} s")
        self._stated_s, self._is_coarse = stated_s, False

    def between(self, earlier: datetime | None, later: datetime | None) -> float | None:
        """Return the seconds between two images, None if unknown."""
        if earlier is None or later is None:
            return self._stated_s
        if self._stated_s is not None and earlier == later:
            self._is_coarse = True
        return self._stated_s if self._is_coarse else (later - earlier).total_seconds()


class Sequencer:
    """Solves images one after another. ``follow``: True to use each solution as the hint for the next image, False to use
    ``hint`` for all images.

    ``interval_s``: see :class:`ImageIntervals`. If a tracked image is not solved, it is tried again without a hint.
    """

    def __init__(self, follow: bool, interval_s: float | None, hint: BoundedPrior | None) -> None:
        self._follow, self._intervals, self._hint = follow, ImageIntervals(interval_s), hint
        self._before: tuple[Attitude, datetime | None] | None = None
        self._system: SystemSequencer | None = None

    def solve(
        self, solver: Solver, pixels: NDArray[Any], request: SolveRequest, taken_at: datetime | None
    ) -> tuple[SolveResult, RateRecord | None]:
        """Return the result, and the rate since the previous image if both were solved, the interval is known and the rotation
        is below 172°."""
        if self._follow and request.chain in SYSTEMS:
            return self._as_on_board(solver, pixels, request, taken_at)
        hint = self._hint
        if self._follow and self._before is not None:
            hint = BoundedPrior(self._before[0].cam_from_icrs, FOLLOW_RAD)
        result = solver.solve(pixels, replace(request, hint=hint))
        if self._follow and result.outcome is Outcome.NONE and hint is not None:
            result = solver.solve(pixels, replace(request, hint=None))
            if result.outcome is Outcome.SOLVED:
                result = replace(result, notes=(*result.notes, "lost in earlier images, recovered without them"))
        rate = self._rate(result.attitude, taken_at)
        if rate is not None and result.turning is not None:
            result = replace(result, turning=with_sign_of(result.turning, np.radians(rate["deg_s"])))
        if self._follow:
            self._before = None if result.attitude is None else (result.attitude, taken_at)
        return result, rate

    def skip(self) -> None:
        """Continue after an image that could not be read or solved because of an error, as after an image without a solution."""
        self._before = None
        if self._system is not None:
            self._system.skip()

    def _as_on_board(
        self, solver: Solver, pixels: NDArray[Any], request: SolveRequest, taken_at: datetime | None
    ) -> tuple[SolveResult, RateRecord | None]:
        """Solve an image of a sequence with a sensor's chain and its modes."""
        if self._system is None:
            self._system = SystemSequencer(request.chain, self._hint)
        result = self._system.solve(solver, pixels, request)
        rate = self._rate(result.attitude, taken_at)
        self._before = None if result.attitude is None else (result.attitude, taken_at)
        return result, rate

    def _rate(self, attitude: Attitude | None, taken_at: datetime | None) -> RateRecord | None:
        if attitude is None or self._before is None:
            return None
        before, taken_before = self._before
        interval_s = self._intervals.between(taken_before, taken_at)
        if interval_s is None or interval_s <= 0:
            return None
        try:
            return rate_record(rate_between(before, attitude, interval_s))
        except BadInput:  # the rotation is too large to determine its direction
            return None


def rate_record(rate: Rate) -> RateRecord:
    """Return a rate in degrees per second."""
    return {
        "interval_s": rate.interval_s,
        "deg_s": [float(v) for v in np.degrees(rate.vector_rad_s)],
        "sigma_deg_s": [math.degrees(s) if math.isfinite(s) else None for s in rate.sigma_rad_s],
        "speed_deg_s": math.degrees(rate.speed_rad_s),
    }


def truth_record(result: SolveResult, cam_from_icrs: Array, stars: StarTable) -> TruthRecord | None:
    """Return the verdict and the errors of a result relative to the true attitude, None without a solution."""
    if result.attitude is None:
        return None
    cross_rad, about_rad = pointing_difference_rad(result.attitude.cam_from_icrs, cam_from_icrs)
    truth = truth_on(result.camera, quaternion_from_matrix(cam_from_icrs), stars)
    return {
        "verdict": str(score(result, truth, result.camera)),
        "error_arcsec": cross_rad / ARCSEC_RAD,
        "error_roll_arcsec": about_rad / ARCSEC_RAD,
    }
