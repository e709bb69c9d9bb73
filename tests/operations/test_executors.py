"""Jobs in this thread, in processes, and on a Dask cluster with scheduler and workers in separate processes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput, GssError, StoreDown
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.events import EventBus
from gss.operations.jobs import Cancelled, JobService
from gss.operations.studies import executor as executor_module
from gss.operations.studies import experiments, reprocess
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.dask_executor import make_executor
from gss.operations.studies.executor import Executor, HereExecutor, LocalExecutor
from gss.operations.studies.reprocess import ReprocessRequest, ReprocessService
from gss.pipeline.render import render
from gss.store import frames as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Frame, Job

T0 = datetime(2026, 12, 1, tzinfo=UTC)
FRAMES = 8


class Cluster:
    """A scheduler and its workers, each a process. :meth:`stop` ends all."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file, self.processes = folder, folder / "scheduler.json", []
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        deadline = time.monotonic() + 60
        while not (self.file.is_file() and self.file.read_text()) and time.monotonic() < deadline:
            time.sleep(0.05)
        self.url: str = json.loads(self.file.read_text())["address"]

    def add_worker(self) -> subprocess.Popen[bytes]:
        """Start one more worker with one thread; it is not restarted when it ends."""
        return self._start("dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")

    def _start(self, program: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--scheduler-file", str(self.file), *options]
        log = (self.folder / f"{program}.log").open("ab")
        self.processes.append(subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder))
        log.close()
        return self.processes[-1]

    def stop(self) -> None:
        """Stop the workers, then the scheduler."""
        for process in reversed(self.processes):
            if process.poll() is None:
                process.kill()
            process.wait(20)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler with two workers."""
    pytest.importorskip("distributed")
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    for _ in range(2):
        cluster.add_worker()
    yield cluster
    cluster.stop()


class ReprocessingServer:
    """A store with rendered frames and a reprocessing service on an executor."""

    def __init__(self, folder: Path, executor: Executor) -> None:
        url = f"sqlite:///{folder / 'gss.db'}"
        migrate(url)
        self.database = Database(open_engine(url))
        self.bus = EventBus(self.database, lambda: datetime.now(UTC))
        self.jobs = JobService(self.database, self.bus, lambda: datetime.now(UTC), lambda _: None)
        blobs = BlobStore(str(folder / "blobs"))
        shipped = shipped_registry()
        book = CameraBook(self.database, shipped, self.bus, lambda: T0)
        self.service = ReprocessService(
            self.database, str(folder / "blobs"), self.jobs, lambda: T0, 2026.5, executor, "reference", book, shipped
        )
        known, stars, rng = shipped_camera("cubestar"), propagate(load_stars(6.0), 2026.5), np.random.default_rng(11)
        with self.database.unit_of_work() as session:
            for k in range(FRAMES):
                pose = cam_from_icrs(rng.uniform(0, 6.28), np.arcsin(rng.uniform(-1, 1)), rng.uniform(0, 6.28))
                drawn = render(stars, known.camera, known.sensor, pose, 0.25, rng)
                row = Frame(
                    source="import", name=f"rendered {k}", taken=T0, received=T0, columns=1024, rows=512, bits=8
                )
                row.dtype, row.sha256 = drawn.pixels.dtype.str, blobs.put(drawn.pixels.tobytes())
                row.exposure_s, row.profile, row.truth = 0.25, "cubestar", [float(v) for v in drawn.truth.quaternion]
                store.add(session, row)

    def results(self) -> list[dict[str, Any]]:
        """Return stored solutions in order of storing, without measured times."""
        with self.database.unit_of_work() as session:
            rows = store.results(session)
            return [
                {c.name: getattr(s, c.name) for c in type(s).__table__.columns if c.name != "timing_s"} for _, s in rows
            ]


def test_a_cluster_that_loses_a_worker_gives_the_local_results(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If one of two workers is killed during a run, the stored rows equal those of a local run, in order."""
    monkeypatch.setattr(reprocess, "BATCH", 1)
    request, outcomes = ReprocessRequest(chain="cubestar"), []
    for name, executor in (("here", HereExecutor()), ("dask", make_executor(cluster.url, 2))):
        (tmp_path / name).mkdir()
        server, reported = ReprocessingServer(tmp_path / name, executor), []

        def progress(done: int, total: int, _text: str, reported: list[int] = reported, name: str = name) -> None:
            reported.append(done)
            if name == "dask" and len(set(reported)) == 2:
                cluster.processes[-1].send_signal(signal.SIGKILL)

        answer = server.service.work(request, server.service.tasks(request), progress)
        assert (answer["frames"], reported[-1]) == (FRAMES, FRAMES)
        assert sum(n for key, n in answer["counts"].items() if key in ("solved", "none")) == FRAMES
        outcomes.append((server.results(), answer["counts"]))
        executor.stop()
        server.database.close()
    assert cluster.processes[-1].wait(20) == -signal.SIGKILL
    cluster.add_worker()
    assert outcomes[0] == outcomes[1]
    assert [row["frame_id"] for row in outcomes[0][0]] == list(range(1, FRAMES + 1))


def test_frames_that_could_not_be_read_are_processed_by_a_later_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failing blob store ends the job and keeps the results before it. Missing and damaged pixels are counted
    separately. None of these frames has a result, so that the next job processes them."""
    monkeypatch.setattr(reprocess, "BATCH", 1)
    server, request = ReprocessingServer(tmp_path, HereExecutor()), ReprocessRequest(chain="cubestar")
    with server.database.unit_of_work() as session:
        hashes = [store.get(session, k).sha256 for k in range(1, FRAMES + 1)]
    files = [next((tmp_path / "blobs").rglob(f"*{sha256[2:]}")) for sha256 in hashes]
    kept = [file.read_bytes() for file in files]
    files[2].unlink()
    files[2].mkdir()  # reading it fails as on a broken disk
    failed = ended(server.jobs, server.service.start(request, user="ann").id)
    assert (failed.state, "blob store" in failed.text) == ("failed", True)
    assert [row["frame_id"] for row in server.results()] == [1, 2]
    files[2].rmdir()
    files[5].write_bytes(b"damaged")
    second = ended(server.jobs, server.service.start(request, user="ann").id)
    assert (second.state, second.result["frames"], second.result["counts"]["not processed"]) == ("done", 6, 2)
    assert [row["frame_id"] for row in server.results()] == [1, 2, 4, 5, 7, 8]
    for k in (2, 5):
        files[k].write_bytes(kept[k])
    third = ended(server.jobs, server.service.start(request, user="ann").id)
    assert (third.result["frames"], "not processed" in third.result["counts"]) == (2, False)
    server.jobs.stop()
    server.database.close()


def ended(jobs: JobService, job_id: int) -> Job:
    """Return the job after its end."""
    for _ in range(2000):
        if (job := jobs.get(job_id)).finished is not None:
            return job
        time.sleep(0.005)
    raise AssertionError(f"the job did not end: {job.text}")


def test_experiments_on_a_cluster_report_progress_and_equal_local_ones(cluster: Cluster) -> None:
    """The same experiments and seeds give the same records in the same order on a cluster. Running items report progress."""
    requested = [("liebe-18", 300, 3), ("moniteq-noise", 6000, 1), ("erlank-3-6", 500, 4)]
    shares: list[float] = []
    executor = make_executor(cluster.url, 1)
    with closing(executor.in_order(experiments.run_item, requested, shares.append)) as records:
        cluster_records = list(records)
    assert cluster_records == list(HereExecutor().in_order(experiments.run_item, requested, shares.append))
    executor.stop()
    assert any(0 < share < 1 for share in shares)


def test_a_cancelled_run_frees_the_cluster(cluster: Cluster) -> None:
    """When a run is cancelled, queued items are dropped at the next check, and the next run is executed."""
    executor, checks = make_executor(cluster.url, 1), []

    def cancel(_share: float) -> None:
        checks.append(1)
        raise Cancelled

    requested = [("liebe-18", 300, 3)] * 30
    with pytest.raises(Cancelled), closing(executor.in_order(experiments.run_item, requested, cancel)) as records:
        list(records)
    assert checks == [1]
    with closing(executor.in_order(experiments.run_item, [("moniteq-noise", 600, 1)])) as records:
        assert len(list(records)) == 1
    executor.stop()


def test_an_error_of_an_item_is_raised_by_every_executor(cluster: Cluster) -> None:
    """An error of the work is the same error on any executor and does not count as a lost worker."""
    for executor in (HereExecutor(), LocalExecutor(1), make_executor(cluster.url, 1)):
        with (
            pytest.raises(GssError, match="no-such-experiment"),
            closing(executor.in_order(experiments.run_item, [("no-such-experiment", 1, 1)])) as records,
        ):
            list(records)
        executor.stop()


class EndingFuture(Future[str]):
    """Future whose work ends directly after a wait for its result timed out."""

    def result(self, timeout: float | None = None) -> str:
        try:
            return super().result(timeout)
        except TimeoutError:
            self.set_result("rows")
            raise


def test_work_that_ends_during_a_check_does_not_time_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the work ends between the timeout of a check and the next question, its result is returned. A TimeoutError of
    the work itself is raised."""
    monkeypatch.setattr(executor_module, "LOOK_S", 0.0)
    shares: list[float] = []
    assert executor_module._result(EndingFuture(), shares.append) == "rows"
    failed: Future[str] = Future()
    failed.set_exception(TimeoutError("of the work"))
    with pytest.raises(TimeoutError, match="of the work"):
        executor_module._result(failed, shares.append)
    assert shares == []


def test_an_unavailable_cluster_is_reported(tmp_path: Path) -> None:
    """A missing scheduler, a wrong URL and a scheduler without workers are reported as errors."""
    pytest.importorskip("distributed")
    from gss.operations.studies import dask_executor

    for url in ("tcp://127.0.0.1:1", "nonsense://x"):
        executor = dask_executor.DaskExecutor(url, connect_s=0.5)
        with pytest.raises((StoreDown, BadInput)), closing(executor.in_order(experiments.run_item, [1])) as records:
            list(records)
    without_workers = Cluster(tmp_path)
    executor = dask_executor.DaskExecutor(without_workers.url, no_worker_s=0.5)
    requested = [("moniteq-noise", 600, 1)]
    with (
        pytest.raises(StoreDown, match="no worker"),
        closing(executor.in_order(experiments.run_item, requested)) as records,
    ):
        list(records)
    executor.stop()
    without_workers.stop()
