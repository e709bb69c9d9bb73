"""Worker processes kept between jobs, and overlays that are made when they are asked for."""

from __future__ import annotations

import os
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import profile
from gss.operations.frames.solution_rows import solution_values, with_overlays
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.studies.reprocess_worker import Order, Task, run_batch
from gss.operations.studies.warm_pool import WarmPool
from gss.pipeline.render import render
from gss.store.blobs import BlobStore
from gss.store.models import Solution


def test_processes_are_kept_and_end_when_idle() -> None:
    """Two jobs meet the same process; some time after the last it is gone, and a later job gets another."""
    pool = WarmPool(1, idle_s=0.2)
    with pool.borrowed() as first:
        one = first.submit(os.getpid).result(60)
    with pool.borrowed() as second:
        assert second.submit(os.getpid).result(60) == one
    deadline = time.monotonic() + 30
    while pool.is_warm and time.monotonic() < deadline:
        threading.Event().wait(0.02)
    assert not pool.is_warm
    with pool.borrowed() as third:
        assert third.submit(os.getpid).result(60) != one
    pool.stop()
    assert not pool.is_warm


def test_a_killed_process_breaks_its_job_only() -> None:
    """The job is told; the next one runs on new processes."""
    pool = WarmPool(1)
    with pytest.raises(BrokenProcessPool), pool.borrowed() as first:
        first.submit(os._exit, 3).result(60)
    with pool.borrowed() as second:
        assert second.submit(pow, 2, 5).result(60) == 32
    pool.stop()


def test_overlays_made_later_are_those_made_at_once() -> None:
    """A row without drawings gets the same grid, outline and predicted stars as one that was stored with them."""
    stars = load_stars(6.5)
    known = profile("cubestar")
    attitude = cam_from_icrs(1.4, 0.05, 0.3)
    frame = render(stars, known.camera, known.sensor, attitude, 0.25, np.random.default_rng(2))
    result = Solver(SolverCache(stars)).solve(frame.pixels, SolveRequest(chain="cubestar", profile="cubestar"))
    assert result.attitude is not None
    whole = solution_values(result, stars, "cubestar", None)
    short = solution_values(result, stars, "cubestar", None, drawn=False)
    assert not {"predicted", "grid", "north", "field"} & set(short["detail"])
    made = with_overlays(Solution(**short, frame_id=1, origin="ground"), stars, "cubestar")
    assert made["stars"] == whole["detail"]["stars"]
    for name in ("predicted", "grid", "field", "regions"):
        assert made[name] == whole["detail"][name], name
    assert made["north"] == pytest.approx(whole["detail"]["north"])


def test_a_worker_takes_the_camera_of_the_order(tmp_path: Path) -> None:
    """Two orders of one process with different cameras under one name give results of these cameras."""
    known = profile("cubestar")
    longer = replace(known, camera=known.camera.with_focal_scaled(1.002))
    blobs = BlobStore(str(tmp_path))
    frame = render(
        load_stars(6.5), known.camera, known.sensor, cam_from_icrs(1.4, 0.05, 0.3), 0.25, np.random.default_rng(2)
    )
    task = Task(1, blobs.put(frame.pixels.tobytes()), frame.pixels.dtype.str, 512, 1024, "cubestar", None)
    for camera in (known, longer, known):
        (row,) = run_batch(Order(str(tmp_path), 2026.5, "cubestar", {"cubestar": camera}), [task])
        assert row["camera"]["focal_col_px"] == camera.camera.focal_col_px
