"""Solution of lists of measured stars with the reference chain, without pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from gss.domain.callbacks import never
from gss.domain.camera import Camera, Pinhole
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.results import Outcome, SolveResult
from gss.domain.rotation import matrix_from_quaternion
from gss.operations.clock import Monotonic
from gss.operations.frames.measured_list_files import StarLists
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.chains.reference import solve_centroids

SIGMA_PX = 0.2
"""Default standard deviation of a star's position per axis."""


class ListRecord(TypedDict):
    """Result of one list as a JSON object. ``ms``: processor time."""

    outcome: str
    reason: str
    quaternion: list[float] | None
    matched: int
    false_match_probability: float | None
    ms: float
    notes: list[str]


@dataclass(frozen=True)
class ListResult:
    """Result of one list. ``quaternion``: cam_from_icrs, scalar last, None without a solution. ``processor_ms``: processor time
    for this list."""

    outcome: Outcome
    reason: str
    quaternion: tuple[float, float, float, float] | None
    matched: int
    false_match_probability: float | None
    processor_ms: float
    notes: tuple[str, ...]

    @property
    def ra_dec_roll_rad(self) -> tuple[float, float, float]:
        """Boresight right ascension, declination and roll of a solved list."""
        return ra_dec_roll_rad(matrix_from_quaternion(np.array(self.quaternion)))

    def as_json(self) -> ListRecord:
        """Return the result as a JSON object."""
        return {
            "outcome": str(self.outcome),
            "reason": self.reason,
            "quaternion": None if self.quaternion is None else list(self.quaternion),
            "matched": self.matched,
            "false_match_probability": self.false_match_probability,
            "ms": round(self.processor_ms, 4),
            "notes": list(self.notes),
        }


def list_result(result: SolveResult, processor_s: float) -> ListResult:
    """Return the reported result of one list."""
    probability = result.false_match_probability
    quaternion = None
    if result.attitude is not None:
        x, y, z, w = (float(q) for q in result.attitude.quaternion)
        quaternion = (x, y, z, w)
    return ListResult(
        result.outcome,
        result.reason,
        quaternion,
        0 if result.matches is None else len(result.matches),
        float(probability) if np.isfinite(probability) else None,
        1e3 * processor_s,
        result.notes,
    )


def without_distortion(camera: Camera) -> Camera:
    """Return the camera without lens distortion."""
    return replace(camera, distortion=Pinhole())


class StarListSolver:
    """Solves lists of one camera, one after another. ``processor_s``: clock that measures processor time; it does not affect
    results."""

    def __init__(
        self, camera: Camera, faint_limit_mag: float, epoch_jyear: float, cache: SolverCache, processor_s: Monotonic
    ) -> None:
        self._camera, self._stars = camera, cache.known(camera, faint_limit_mag, epoch_jyear)
        self._processor_s = processor_s

    def solve(
        self, lists: StarLists, sigma_px: float = SIGMA_PX, stop: Callable[[], bool] = never
    ) -> Iterator[tuple[SolveResult, float]]:
        """Yield the result of each list and its processor time in seconds, until ``stop`` returns True."""
        for index in range(len(lists)):
            if stop():
                return
            started_s = self._processor_s()
            result = solve_centroids(lists.centroids(index, sigma_px), self._camera, self._stars)
            yield result, self._processor_s() - started_s
