"""Worker side of reprocessing: takes pixels and returns a solution's columns. It does not use the database, so it starts
quickly."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gss import __version__
from gss.domain.errors import GssError
from gss.domain.profiles import CameraProfile, profile
from gss.domain.stars import StarTable
from gss.operations.clock import stopwatch_s
from gss.operations.frames.observer import Observer
from gss.operations.frames.solution_rows import solution_values
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.studies.dark_frames import DarkFrames
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


@dataclass(frozen=True)
class Order:
    """Settings of a batch. ``profiles``: cameras with a calibration in use, by name; all others are the documented ones."""

    blobs_url: str
    epoch_jyear: float
    chain: str
    profiles: Mapping[str, CameraProfile] = field(default_factory=dict)


@dataclass
class _Kept:
    """State that a process keeps between batches and jobs."""

    blobs: BlobStore
    solver: Solver
    stars: StarTable
    profiles: dict[str, CameraProfile]

    def profile(self, name: str) -> CameraProfile:
        """Return the camera of that name, as given by the order."""
        return self.profiles.get(name) or profile(name)


_kept: dict[tuple[str, float], _Kept] = {}


def run_item(item: tuple[Order, Sequence[Task]], _told: Callable[[float], None]) -> list[dict[str, Any]]:
    """Run a batch for an executor."""
    return run_batch(*item)


def run_batch(order: Order, tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """Return one row of values per task; a frame that cannot be run has outcome "none" with the reason."""
    kept = _ready(order)
    return [_run(kept, order, task) for task in tasks]


def _ready(order: Order) -> _Kept:
    key = (order.blobs_url, order.epoch_jyear)
    if key not in _kept:
        cache, profiles, blobs = SolverCache(), dict(order.profiles), BlobStore(order.blobs_url)
        dark = DarkFrames(blobs).pattern
        solver = Solver(cache, stopwatch_s, order.epoch_jyear, lambda name: _kept[key].profile(name), dark)
        _kept[key] = _Kept(blobs, solver, cache.stars(order.epoch_jyear), profiles)
    _kept[key].profiles = dict(order.profiles)
    return _kept[key]


def _run(kept: _Kept, order: Order, task: Task) -> dict[str, Any]:
    try:
        data = np.frombuffer(kept.blobs.get(task.sha256), np.dtype(task.dtype))
        pixels = data.reshape(task.rows, task.columns)
        request = SolveRequest(
            chain=order.chain,
            profile=task.profile,
            blind=task.profile is None,
            observer=task.observer,
            exposure_s=task.exposure_s,
        )
        result = kept.solver.solve(pixels, request)
        result = replace(result, timing_s={k: v for k, v in result.timing_s.items() if math.isfinite(v)})
    except GssError as error:
        return {"frame_id": task.frame_id, "chain": order.chain, "version": __version__, "outcome": "none"} | {
            "reason": str(error)
        }
    values = solution_values(result, kept.stars, task.profile, task.truth, drawn=False)
    return {"frame_id": task.frame_id, "camera_name": request.camera_name} | values
