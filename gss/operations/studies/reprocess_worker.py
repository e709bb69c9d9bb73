"""Worker side of reprocessing: solves pixels and returns the columns of a solution. It does not use the database, so it
starts quickly."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NotRequired

import numpy as np

from gss import __version__
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, CorruptData, NotFound
from gss.domain.stars import StarTable
from gss.operations.clock import stopwatch_s
from gss.operations.frames.dark_frames import DarkFrames
from gss.operations.frames.observer import Observer
from gss.operations.frames.solution_rows import SolutionValues, solution_values
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.store.blobs import BlobStore
from gss.store.packed_detail import packed


@dataclass(frozen=True)
class Task:
    """Data that a worker needs about one frame. ``columns``: number of stored columns, with the dark columns."""

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
    """Epoch of the star positions; None for the epoch of the batch."""


@dataclass(frozen=True)
class BatchSettings:
    """Settings of a batch. ``documented``: documented cameras by name; ``profiles``: active cameras by name;
    ``options``: changed constants of the chain."""

    blobs_url: str
    epoch_jyear: float
    chain: str
    profiles: Mapping[str, CameraProfile]
    documented: Mapping[str, CameraProfile]
    options: tuple[tuple[str, str], ...] = ()


@dataclass
class _WorkerState:
    """State that a process keeps between batches and jobs."""

    blobs: BlobStore
    solver: Solver
    stars: StarTable
    profiles: dict[str, CameraProfile]

    def profile(self, name: str) -> CameraProfile:
        """Return the active camera of a name, from the settings of the batch. Raises NotFound."""
        if name not in self.profiles:
            raise NotFound("unknown instrument", expected=" | ".join(sorted(self.profiles)), got=name)
        return self.profiles[name]


class TaskResult(SolutionValues):
    """Columns of a solution, with the id of its frame."""

    frame_id: int
    camera_name: NotRequired[str]


NOT_PROCESSED = "not processed"
"""Outcome of a frame whose data or instrument is missing or damaged. It is counted, but not stored as a solution, so
that a later run processes the frame when its data can be read again."""
_states: dict[tuple[str, float], _WorkerState] = {}


def run_item(item: tuple[BatchSettings, Sequence[Task]], _report_share: Callable[[float], None]) -> list[TaskResult]:
    """Run a batch for an executor."""
    return run_batch(*item)


def run_batch(settings: BatchSettings, tasks: Sequence[Task]) -> list[TaskResult]:
    """Return one row of values per task. A frame that the chain cannot process has the outcome "none" with the reason,
    and a frame that cannot be read has the outcome ``NOT_PROCESSED``. Raises StoreDown if the blob store fails."""
    state = _state_for(settings)
    return [_run(state, settings, task) for task in tasks]


def _state_for(settings: BatchSettings) -> _WorkerState:
    key = (settings.blobs_url, settings.epoch_jyear)
    if key not in _states:
        cache, profiles, blobs = SolverCache(), dict(settings.profiles), BlobStore(settings.blobs_url)
        dark = DarkFrames(blobs).pattern
        solver = Solver(lambda name: _states[key].profile(name), cache, stopwatch_s, settings.epoch_jyear, dark)
        _states[key] = _WorkerState(blobs, solver, cache.stars(settings.epoch_jyear), profiles)
    _states[key].profiles = dict(settings.profiles)
    return _states[key]


def _run(state: _WorkerState, settings: BatchSettings, task: Task) -> TaskResult:
    try:
        data = np.frombuffer(state.blobs.get(task.sha256), np.dtype(task.dtype))
        pixels = data.reshape(task.rows, task.columns)
        request = SolveRequest(
            chain=settings.chain,
            profile=task.profile,
            blind=task.profile is None,
            epoch_jyear=task.epoch_jyear,
            observer=task.observer,
            exposure_s=task.exposure_s,
            options=settings.options,
        )
        result = state.solver.solve(pixels, request)
        result = replace(result, timing_s={k: v for k, v in result.timing_s.items() if math.isfinite(v)})
    except (BadInput, NotFound, CorruptData) as error:
        return {
            "frame_id": task.frame_id,
            "chain": settings.chain,
            "version": __version__,
            "outcome": "none" if isinstance(error, BadInput) else NOT_PROCESSED,
            "reason": str(error),
        }
    stars = state.stars if task.epoch_jyear is None else state.solver.cache.stars(task.epoch_jyear)
    values = solution_values(result, stars, settings.documented.get(task.profile or ""), task.truth)
    # Packed here, because this work can use many workers, and the server then receives a tenth of the data.
    values["detail"] = packed(values["detail"])
    return {"frame_id": task.frame_id, "camera_name": request.camera_name, **values}
