"""Worker processes that are kept between jobs, and stored solutions."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from copy import deepcopy
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames import overlay
from gss.operations.frames.solution_rows import solution_values, with_overlays
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.studies.reprocess_worker import BatchSettings, Task, run_batch
from gss.operations.studies.warm_pool import WarmPool
from gss.pipeline.render import render
from gss.store import frames
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.models import Base, Frame, Solution
from gss.store.packed_detail import packed, with_rows


def _runs(process_id: int) -> bool:
    """True if a process with this id exists."""
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return False
    return True


def test_processes_are_kept_and_end_when_idle() -> None:
    """Two jobs use the same process. It ends when it is idle, and a later job gets another one."""
    pool = WarmPool(1, idle_s=0.2)
    with pool.borrowed() as first:
        one = first.submit(os.getpid).result(60)
    with pool.borrowed() as second:
        assert second.submit(os.getpid).result(60) == one
    deadline = time.monotonic() + 30
    while _runs(one) and time.monotonic() < deadline:
        threading.Event().wait(0.02)
    assert not _runs(one)
    with pool.borrowed() as third:
        later = third.submit(os.getpid).result(60)
    assert later != one
    pool.stop()
    assert not _runs(later)


KILLED = """
import os, signal
from gss.operations.studies.warm_pool import WarmPool
if __name__ == "__main__":
    with WarmPool(1).borrowed() as processes:
        print(processes.submit(os.getpid).result(60), processes.submit(os.getppid).result(60), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_processes_end_if_their_parent_is_killed(tmp_path: Path) -> None:
    """A process that is killed leaves neither its worker nor the fork server."""
    program = tmp_path / "killed.py"
    program.write_text(KILLED, "utf-8")
    killed = subprocess.run([sys.executable, str(program)], stdout=subprocess.PIPE, text=True, timeout=120, check=False)
    assert killed.returncode == -signal.SIGKILL
    worker, fork_server = map(int, killed.stdout.split())
    deadline = time.monotonic() + 30
    while (_runs(worker) or _runs(fork_server)) and time.monotonic() < deadline:
        threading.Event().wait(0.02)
    assert not _runs(worker)
    assert not _runs(fork_server)


def test_a_killed_process_fails_only_its_job() -> None:
    """The job of a killed process gets an error, and the next job runs in a new process."""
    pool = WarmPool(1)
    with pytest.raises(BrokenProcessPool), pool.borrowed() as first:
        first.submit(os._exit, 3).result(60)
    with pool.borrowed() as second:
        assert second.submit(pow, 2, 5).result(60) == 32
    pool.stop()


def test_a_stored_solution_is_small_and_shows_the_same_sky(tmp_path: Path) -> None:
    """A stored solution has less than 6 kB. Its stars and overlays are those of the result within 1e-5 px."""
    stars, known = load_stars(6.5), shipped_camera("cubestar")
    attitude = cam_from_icrs(1.4, 0.05, 0.3)
    frame = render(stars, known.camera, known.sensor, attitude, 0.25, np.random.default_rng(2))
    result = Solver(shipped_camera, SolverCache(stars)).solve(
        frame.pixels, SolveRequest(chain="cubestar", profile="cubestar")
    )
    assert result.attitude is not None
    values = solution_values(result, stars, known, None)
    assert set(values["detail"]) == {"regions", "stars", "versions"}
    columns = values["detail"]
    values["detail"] = with_rows(columns)
    assert packed(columns) == packed(values["detail"])
    database = Database(open_engine(f"sqlite:///{tmp_path / 'one.db'}"))
    Base.metadata.create_all(database.engine)
    at = datetime.now(UTC)
    taken = Frame(
        source="import", name="f", taken=at, received=at, columns=1024, rows=512, bits=8, dtype="|u1", sha256="0"
    )
    with database.unit_of_work() as session:
        frame_id = frames.add(session, taken).id
        added = Solution(**deepcopy(values), frame_id=frame_id, origin="ground", created=at)
        solution_id = frames.add_solution(session, added).id
    with database.engine.connect() as connection:
        (raw,) = connection.exec_driver_sql("SELECT * FROM solutions").all()
        assert sum(len(str(value)) for value in raw) < 6000
    with database.unit_of_work() as session:
        row = frames.get_solution(session, solution_id)
    shown = with_overlays(row, stars, known, None)
    assert shown["regions"] == values["detail"]["regions"]
    assert len(shown["stars"]) == len(values["detail"]["stars"])
    for now, then in zip(shown["stars"], values["detail"]["stars"], strict=True):
        assert now.pop("name", None) == then.pop("name", None)
        assert now == pytest.approx(then, rel=1e-6, abs=1e-5)
    direct = overlay.describe(
        result.camera, stars, known.sensor.faint_limit_mag, result.centroids, result.attitude.cam_from_icrs
    )
    for name in ("predicted", "grid", "field"):
        assert shown[name] == direct[name], name
    assert shown["north"] == pytest.approx(direct["north"])
    database.close()


def test_a_worker_uses_the_camera_of_its_job(tmp_path: Path) -> None:
    """Jobs in one process with different cameras of the same name give results of these cameras."""
    profile = shipped_camera("cubestar")
    longer = replace(profile, camera=profile.camera.with_focal_scaled(1.002))
    blobs = BlobStore(str(tmp_path))
    frame = render(
        load_stars(6.5), profile.camera, profile.sensor, cam_from_icrs(1.4, 0.05, 0.3), 0.25, np.random.default_rng(2)
    )
    task = Task(1, blobs.put(frame.pixels.tobytes()), frame.pixels.dtype.str, 512, 1024, "cubestar", None)
    for camera in (profile, longer, profile):
        (row,) = run_batch(
            BatchSettings(str(tmp_path), 2026.5, "cubestar", {"cubestar": camera}, {"cubestar": camera}), [task]
        )
        assert row["camera"]["focal_col_px"] == camera.camera.focal_col_px
