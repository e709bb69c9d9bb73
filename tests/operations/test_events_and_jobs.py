"""The stream of what happened, and long work."""

from __future__ import annotations

import threading

import pytest

from gss.domain.errors import BadInput, Conflict
from gss.operations.events import MAILBOX
from gss.operations.jobs import JobService
from gss.store import jobs as store
from gss.store.models import Job


def test_recorded_events_reach_every_mailbox_with_their_number(bus):
    """Order and numbers are those of the record; other messages have no number."""
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


def test_a_slow_listener_loses_the_oldest_and_is_told_how_many(bus):
    """Mailboxes are bounded; drops are counted, never silent."""
    mailbox = bus.subscribe(lambda: None)
    for k in range(MAILBOX + 3):
        bus.publish("x", k)
    messages, dropped = mailbox.take()
    assert (len(messages), dropped, messages[0].payload) == (MAILBOX, 3, 3)
    assert mailbox.take() == ([], 0)


@pytest.fixture
def jobs(database, bus, clock):
    """A job service that ends with the test."""
    service = JobService(database, bus, clock)
    yield service
    service.stop()


def wait_for_end(jobs, job_id: int) -> Job:
    """The job when it has ended."""
    for _ in range(2000):
        job = jobs.get(job_id)
        if job.finished is not None:
            return job
        threading.Event().wait(0.005)
    pytest.fail("the job did not end")


def test_a_job_reports_progress_and_keeps_its_result(jobs, bus):
    """Done, total and text are visible while it runs; the result stays."""
    mailbox = bus.subscribe(lambda: None)

    def work(progress):
        progress(1, 2, "half")
        return {"answer": 42}

    job = wait_for_end(jobs, jobs.submit("k", "title", {"asked": 1}, work).id)
    assert (job.state, job.result, job.request) == ("done", {"answer": 42}, {"asked": 1})
    seen = [m.payload.text for m in mailbox.take()[0] if m.topic == "job"]
    assert "done" in seen


def test_a_cancelled_job_ends_at_its_next_report(jobs):
    """Cancelling leaves no result; cancelling twice says that it has ended."""
    running, go = threading.Event(), threading.Event()

    def work(progress):
        running.set()
        go.wait(10)
        progress(1, 2, "never seen")
        return {"wrong": True}

    job_id = jobs.submit("k", "t", {}, work).id
    assert running.wait(10)
    jobs.cancel(job_id)
    go.set()
    job = wait_for_end(jobs, job_id)
    assert (job.state, job.result) == ("cancelled", {})
    with pytest.raises(Conflict, match="has ended"):
        jobs.cancel(job_id)


@pytest.mark.parametrize(
    ("error", "words"), [(BadInput("no stars", expected="some"), "no stars"), (ZeroDivisionError("oops"), "defect")]
)
def test_a_failing_job_says_why_and_the_next_one_still_runs(jobs, bus, error, words):
    """Bad input and defects are both visible ends; the worker lives on."""

    def work(_progress):
        raise error

    job = wait_for_end(jobs, jobs.submit("k", "t", {}, work).id)
    assert job.state == "failed"
    assert words in job.text
    assert words in bus.after(0, 10)[-1].text
    assert wait_for_end(jobs, jobs.submit("k", "t", {}, lambda _p: {}).id).state == "done"


def test_jobs_of_a_dead_server_are_closed_at_the_next_start(jobs, database, clock):
    """Nothing stays "running" for ever."""
    with database.unit_of_work() as session:
        job_id = store.add(session, Job(kind="k", title="t", state="running", created=clock())).id
    jobs.start()
    job = jobs.get(job_id)
    assert job.state == "failed"
    assert "start it again" in job.text
