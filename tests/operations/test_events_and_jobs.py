"""The event stream, and long-running jobs."""

from __future__ import annotations

import sqlite3
import threading
import time
from dataclasses import dataclass, replace
from datetime import timedelta

import pytest
from sqlalchemy.event import listen

from gss.api.present.records import job as job_out
from gss.domain.errors import BadInput, Conflict
from gss.operations.events import MAILBOX, EventBus
from gss.operations.jobs import MAX_DEATHS, JobKind, JobRequest, JobService
from gss.settings import Settings
from gss.store import jobs as store
from gss.store.engine import Database, open_engine
from gss.store.models import Job
from gss.wiring.build import build


def test_recorded_events_reach_every_subscriber_with_their_number(bus):
    """Subscribers get recorded events with their sequence number. Other messages have no number."""
    woken = threading.Event()
    mailbox = bus.subscribe(woken.set)
    first = bus.record("kind", "ok", "one", detail=1)
    bus.publish("telemetry", {"x": 1})
    messages, dropped = mailbox.take()
    assert woken.is_set()
    assert dropped == 0
    assert [(m.topic, m.seq) for m in messages] == [("event", first.seq), ("telemetry", None)]
    assert [e.text for e in bus.after(0, 10)] == ["one"]
    bus.unsubscribe(mailbox)
    bus.publish("telemetry", {})
    assert mailbox.take() == ([], 0)


def test_a_slow_subscriber_loses_the_oldest_and_gets_their_number(bus):
    """Queues are bounded. A slow subscriber loses the oldest messages and gets their number."""
    mailbox = bus.subscribe(lambda: None)
    for k in range(MAILBOX + 3):
        bus.publish("x", k)
    messages, dropped = mailbox.take()
    assert (len(messages), dropped, messages[0].payload) == (MAILBOX, 3, 3)
    assert mailbox.take() == ([], 0)


@pytest.fixture
def jobs(database, bus, clock):
    """A job service that is stopped after the test."""
    service = JobService(database, bus, clock, lambda _: None)
    yield service
    service.stop()


@dataclass(frozen=True)
class Sum(JobRequest):
    """The request of these tests: numbers to add."""

    numbers: tuple[int, ...] = ()


def register(jobs, work, kind="sum"):
    """Run jobs of a kind with ``work(run)``."""
    jobs.register(JobKind(kind, Sum, lambda request, run: work(run)))


def begin(jobs, work, kind="sum"):
    """Queue a job that runs ``work(run)`` and return its id."""
    register(jobs, work, kind)
    return jobs.begin(kind, "t", Sum((1, 2))).id


def wait_for_end(jobs, job_id: int) -> Job:
    """Return the job after its end."""
    for _ in range(2000):
        job = jobs.get(job_id)
        if job.finished is not None:
            return job
        threading.Event().wait(0.005)
    pytest.fail("the job did not end")


def test_a_job_reports_progress_and_stores_its_result(jobs, bus):
    """A job publishes its progress and stores its request and result."""
    texts, published = [], threading.Event()

    def take():
        texts.extend(m.payload.text for m in mailbox.take()[0] if m.topic == "job")
        if "Done" in texts:
            published.set()

    mailbox = bus.subscribe(take)

    def work(request, run):
        run.progress(1, 2, "half")
        return {"answer": sum(request.numbers)}

    jobs.register(JobKind("sum", Sum, work))
    job = wait_for_end(jobs, jobs.begin("sum", "title", Sum((40, 2), user="ann")).id)
    assert (job.state, job.result) == ("done", {"answer": 42})
    assert job.request == {"numbers": [40, 2], "user": "ann"}
    # The message follows the stored row.
    assert published.wait(10), texts


def test_a_cancelled_job_ends_at_its_next_report(jobs):
    """A cancelled job ends at its next progress report and has no result. A second cancellation is rejected."""
    running, go = threading.Event(), threading.Event()

    def work(run):
        running.set()
        go.wait(10)
        run.progress(1, 2, "never seen")
        return {"wrong": True}

    job_id = begin(jobs, work)
    assert running.wait(10)
    jobs.cancel(job_id)
    go.set()
    job = wait_for_end(jobs, job_id)
    assert (job.state, job.result) == ("cancelled", {})
    with pytest.raises(Conflict, match="has ended"):
        jobs.cancel(job_id)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (BadInput("no stars", expected="some"), "No stars. Expected some."),
        (ZeroDivisionError("oops"), "Internal error"),
    ],
)
def test_a_failing_job_states_the_reason_and_the_next_one_runs(jobs, bus, error, words):
    """A job that fails because of invalid input or a defect states the reason, and the next job runs."""

    def work(_run):
        raise error

    job = wait_for_end(jobs, begin(jobs, work))
    assert job.state == "failed"
    assert words in job.text
    assert words in bus.after(0, 10)[-1].text
    assert wait_for_end(jobs, begin(jobs, lambda _run: {})).state == "done"


def test_jobs_of_a_killed_server_are_closed_at_the_next_start(jobs, database, clock):
    """A job that was running in a killed server has failed after the next start."""
    with database.unit_of_work() as session:
        job_id = store.add(session, Job(kind="k", title="t", state="running", created=clock())).id
    jobs.start()
    job = jobs.get(job_id)
    assert job.state == "failed"
    assert "Start it again" in job.text


def copy_crashed_database(source, folder):
    """Copy the database as after kill -9 at this time. Return it opened as by the next server."""
    with sqlite3.connect(source.engine.url.database) as live, sqlite3.connect(folder / "after.db") as after:
        live.backup(after)
    live.close()
    after.close()
    return Database(open_engine(f"sqlite:///{folder / 'after.db'}"))


def sum_in_chunks(run, upto=6):
    """Sum squares in chunks, and store a checkpoint after each."""
    checkpoint = dict(run.checkpoint or {"next": 0, "sum": 0, "steps": []})
    for k in range(checkpoint["next"], upto):
        run.progress(k, upto, f"chunk {k}")
        checkpoint = {"next": k + 1, "sum": checkpoint["sum"] + k * k, "steps": [*checkpoint["steps"], k]}
        run.keep(checkpoint)
    return {"sum": checkpoint["sum"], "chunks": len(checkpoint["steps"])}


@pytest.mark.parametrize("killed_after", range(6))
def test_a_job_continues_at_its_last_chunk_after_a_crash(jobs, database, clock, tmp_path, killed_after):
    """After a crash between any two chunks, the next server runs only the remaining ones, and the result equals that of an
    uninterrupted run."""
    crashed_databases: list[Database] = []

    def dying(run):
        def keep(checkpoint, session=None):
            run.keep(checkpoint, session)
            if checkpoint["next"] == killed_after:
                crashed_databases.append(copy_crashed_database(database, tmp_path))

        if killed_after == 0:
            crashed_databases.append(copy_crashed_database(database, tmp_path))
        return sum_in_chunks(replace(run, keep=keep))

    uninterrupted = wait_for_end(jobs, begin(jobs, dying))
    (after,) = crashed_databases
    done: list[int] = []

    def remaining_work(run):
        done.append((run.checkpoint or {"next": 0})["next"])
        return sum_in_chunks(run)

    second = JobService(after, EventBus(after, clock), clock, lambda _: None)
    register(second, remaining_work)
    second.start()
    job = wait_for_end(second, uninterrupted.id)
    second.stop()
    assert (job.state, job.result, done) == ("done", uninterrupted.result, [killed_after])
    after.close()


def test_a_job_that_kills_the_server_is_not_restarted_without_limit(jobs, database, clock):
    """After the third crash without progress the job fails with the reason. A user can start it again."""
    with database.unit_of_work() as session:
        row = store.add(
            session, Job(kind="design", title="t", state="running", created=clock(), request={"numbers": [3]})
        )
        row.attempts = MAX_DEATHS - 1
    jobs.register(JobKind("design", Sum, lambda request, run: {"sum": sum(request.numbers)}))
    jobs.start()
    job = jobs.get(row.id)
    assert (job.state, "stopped 3 times" in job.text) == ("failed", True)
    restarted = wait_for_end(jobs, jobs.again(job.id, user="ann").id)
    assert (restarted.id > job.id, restarted.state, restarted.result) == (True, "done", {"sum": 3})


def test_a_regular_stop_leaves_resumable_jobs_to_the_next_server(database, bus, clock):
    """A regular stop does not cancel a job. The next server continues it at its last chunk."""
    running, first, second = (
        threading.Event(),
        JobService(database, bus, clock, lambda _: None),
        JobService(database, bus, clock, lambda _: None),
    )

    def until_stopped(run):
        run.keep({"next": 3, "sum": 5, "steps": [0, 0, 0]})
        running.set()
        while True:
            run.progress(3, 6, "busy")
            threading.Event().wait(0.002)

    job_id = begin(first, until_stopped)
    assert running.wait(10)
    first.stop()
    assert second.get(job_id).state == "queued"
    register(second, sum_in_chunks)
    second.start()
    assert wait_for_end(second, job_id).result == {"sum": 55, "chunks": 6}
    second.stop()


def test_cancelled_jobs_do_not_run_after_a_restart(database, bus, clock):
    """A cancelled job ends at once if it is queued, and otherwise at its next report, also if the server stops or is killed
    before. The next server does not run it."""
    running, release, ran = threading.Event(), threading.Event(), []
    first, second = (JobService(database, bus, clock, lambda _: None) for _ in range(2))

    def compute(run):
        running.set()
        release.wait(10)
        run.progress(1, 2, "one")
        return {}

    started_id = begin(first, compute)
    assert running.wait(10)
    queued_id = first.begin("sum", "queued", Sum()).id
    killed_id = store_row(database, clock, "cancelling")
    assert (first.cancel(started_id).text, first.cancel(queued_id).state) == ("Cancelling", "cancelled")
    assert job_out(first.get(started_id)).state == "running"
    first.interrupt()
    first.cancel(started_id)
    release.set()
    first.stop()
    register(second, lambda _run: ran.append(1) or {})
    second.start()
    second.finish()
    states = [second.get(job_id).state for job_id in (started_id, queued_id, killed_id)]
    assert (states, ran) == (["cancelled"] * 3, [])


@pytest.fixture
def read_only(database):
    """Event that makes the database accept no write while it is set, as on a full disk."""
    flag = threading.Event()

    def set_mode(connection, _record, _proxy):
        connection.execute(f"PRAGMA query_only={'ON' if flag.is_set() else 'OFF'}")

    listen(database.engine, "checkout", set_mode)
    return flag


def test_the_end_of_a_job_is_stored_when_the_store_accepts_it_again(jobs, database, bus, monkeypatch, read_only):
    """A result and a failure that the store rejected at first are stored later, with one event. A result that cannot be
    stored is a failure."""
    monkeypatch.setattr("gss.operations.jobs.RETRY_S", 0.02, raising=False)

    def work(request, _run):
        read_only.set()
        if not request.numbers:
            raise BadInput("no numbers")
        return {"sum": sum(request.numbers) if request.numbers[0] else {1, 2}}

    jobs.register(JobKind("sum", Sum, work))
    for request, state in ((Sum((1, 2)), "done"), (Sum(), "failed"), (Sum((0,)), "failed")):
        job_id = jobs.begin("sum", "t", request).id
        assert read_only.wait(10)
        threading.Event().wait(0.1)
        assert (jobs.get(job_id).state, jobs.waiting()) == ("running", 1)
        read_only.clear()
        assert wait_for_end(jobs, job_id).state == state
    assert [event.text.split(":")[1] for event in bus.after(0, 10)] == [" No numbers.", " Internal error"]


def test_a_stop_does_not_wait_for_a_failing_store(jobs, database, read_only):
    """A job whose end cannot be stored does not delay the stop, and the next server continues it."""
    job_id = begin(jobs, lambda _run: read_only.set() or {})
    assert read_only.wait(10)
    started_s = time.monotonic()
    jobs.stop()
    assert (time.monotonic() - started_s < 2, jobs.get(job_id).state, jobs.waiting()) == (True, "running", 0)
    read_only.clear()


def test_a_job_that_no_thread_runs_is_cancelled_at_once(jobs, database, clock):
    """An unfinished row without a job, for example after a defect, can be cancelled."""
    assert jobs.cancel(store_row(database, clock, "running")).state == "cancelled"


def store_row(database, clock, state: str) -> int:
    """Store a job of kind "sum" in a state, and return its id."""
    with database.unit_of_work() as session:
        row = Job(kind="sum", title="t", state=state, created=clock(), request={"numbers": [3]}, result={})
        return store.add(session, row).id


def test_an_announced_stop_marks_jobs_before_the_threads_end(tmp_path):
    """After a stop was announced, a running job is queued, so that it does not count as crashed if the process is killed."""
    services, running, release = build(Settings(data=tmp_path)), threading.Event(), threading.Event()

    def compute(run):
        running.set()
        release.wait(30)
        run.progress(1, 2, "one")
        return {}

    job_id = begin(services.base.jobs, compute, "experiments")
    try:
        assert running.wait(10)
        services.announce_stop()
        for _ in range(2000):
            if services.base.jobs.get(job_id).state == "queued":
                break
            threading.Event().wait(0.005)
        assert services.base.jobs.get(job_id).state == "queued"
        services.announce_stop()
    finally:
        release.set()
        services.stop()
    assert services.base.jobs.get(job_id).state == "queued"


def test_an_interrupted_service_starts_no_job_and_stores_one_that_finished(jobs, database):
    """After an interruption a new job remains queued for the next server, and a completed one stays done."""
    done = wait_for_end(jobs, begin(jobs, sum_in_chunks))
    jobs.interrupt()
    late = jobs.begin("sum", "late", Sum())
    jobs.interrupt()
    jobs.finish()
    assert (jobs.get(done.id).state, jobs.get(late.id).state, jobs.get(late.id).result) == ("done", "queued", {})


def test_events_of_a_span_are_the_newest_in_order(database, clock):
    """With more events in a span than requested, the newest are returned, oldest first."""
    bus = EventBus(database, clock)
    start = clock()
    for n in range(5):
        bus.record("device", "ok", f"event {n}")
    assert [e.text for e in bus.between(start, clock(), 3)] == ["event 2", "event 3", "event 4"]
    assert bus.between(start - timedelta(days=2), start - timedelta(days=1), 3) == []
