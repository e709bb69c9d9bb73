"""Worker side of reprocessing: takes pixels and returns a solution's columns. It does not use the database, so it starts
quickly."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NotRequired

import numpy as np

from gss import __version__
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import GssError, NotFound
from gss.domain.stars import StarTable
from gss.operations.clock import stopwatch_s
from gss.operations.frames.dark_frames import DarkFrames
from gss.operations.frames.observer import Observer
from gss.operations.frames.solution_rows import SolutionValues, solution_values
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.store.blobs import BlobStore


@dataclass(frozen=True)
class Task:
    """Data that a worker needs about one frame."""

    frame_id: int
    sha256: str
    dtype: str
    rows: int
    columns: int
    profile: str | None
    truth: list[Any] | None
    observer: Observer | None = None
    exposure_s: float | None = None
    epoch_jyear: float | None = None
    """Of the star positions; None: that of the batch."""


@dataclass(frozen=True)
class BatchSettings:
    """Settings of a batch. ``documented``: all cameras by name; ``profiles``: the same, calibrated
    where a calibration is in use; ``options``: changed constants of the chain."""

    blobs_url: str
    epoch_jyear: float
    chain: str
    profiles: Mapping[str, CameraProfile]
    documented: Mapping[str, CameraProfile]
    options: tuple[tuple[str, str], ...] = ()


@dataclass
class _Kept:
    """State that a process keeps between batches and jobs."""

    blobs: BlobStore
    solver: Solver
    stars: StarTable
    profiles: dict[str, CameraProfile]

    def profile(self, name: str) -> CameraProfile:
        """Return the camera of that name, as given by the order. Raises NotFound."""
        if name not in self.profiles:
            raise NotFound("unknown instrument", expected=" | ".join(sorted(self.profiles)), got=name)
        return self.profiles[name]


class TaskResult(SolutionValues):
    """Columns of a solution with its frame."""

    frame_id: int
    camera_name: NotRequired[str]


_kept: dict[tuple[str, float], _Kept] = {}


def run_item(item: tuple[BatchSettings, Sequence[Task]], _report_share: Callable[[float], None]) -> list[TaskResult]:
    """Run a batch for an executor."""
    return run_batch(*item)


def run_batch(order: BatchSettings, tasks: Sequence[Task]) -> list[TaskResult]:
    """Return one row of values per task; a frame that cannot be run has outcome "none" with the reason."""
    state = _ready(order)
    return [_run(state, order, task) for task in tasks]


def _ready(order: BatchSettings) -> _Kept:
    key = (order.blobs_url, order.epoch_jyear)
    if key not in _kept:
        cache, profiles, blobs = SolverCache(), dict(order.profiles), BlobStore(order.blobs_url)
        dark = DarkFrames(blobs).pattern
        solver = Solver(lambda name: _kept[key].profile(name), cache, stopwatch_s, order.epoch_jyear, dark)
        _kept[key] = _Kept(blobs, solver, cache.stars(order.epoch_jyear), profiles)
    _kept[key].profiles = dict(order.profiles)
    return _kept[key]


def _run(state: _Kept, order: BatchSettings, task: Task) -> TaskResult:
    try:
        data = np.frombuffer(state.blobs.get(task.sha256), np.dtype(task.dtype))
        pixels = data.reshape(task.rows, task.columns)
        request = SolveRequest(
            chain=order.chain,
            profile=task.profile,
            blind=task.profile is None,
            epoch_jyear=task.epoch_jyear,
            observer=task.observer,
            exposure_s=task.exposure_s,
            options=order.options,
        )
        result = state.solver.solve(pixels, request)
        result = replace(result, timing_s={k: v for k, v in result.timing_s.items() if math.isfinite(v)})
    except GssError as error:
        return {
            "frame_id": task.frame_id,
            "chain": order.chain,
            "version": __version__,
            "outcome": "none",
            "reason": str(error),
        }
    stars = state.stars if task.epoch_jyear is None else state.solver.cache.stars(task.epoch_jyear)
    values = solution_values(result, stars, order.documented.get(task.profile or ""), task.truth)
    return {"frame_id": task.frame_id, "camera_name": request.camera_name, **values}
