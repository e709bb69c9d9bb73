"""Retention deletes only permitted content, reports it, and continues after a crash at any point."""

from __future__ import annotations

import random
import sqlite3
from dataclasses import replace
from datetime import timedelta

import pytest
from pydantic import ValidationError
from sqlalchemy import func, select

from gss.domain.errors import BadInput
from gss.operations.events import EventBus
from gss.operations.jobs import JobKind, JobService
from gss.operations.upkeep import removal
from gss.operations.upkeep import retention as room
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.forecast import ForecastService
from gss.operations.upkeep.removal import confirmation
from gss.operations.upkeep.retention import RetentionService
from gss.operations.upkeep.retention_policy import RemovalJob, RetentionPolicy
from gss.operations.upkeep.retention_watch import DailyRetention
from gss.store import upkeep
from gss.store.engine import Database, open_engine
from gss.store.models import Calibration, Frame, Job, Solution, TelemetryPacket


def pixels_left(database) -> list[int]:
    with database.unit_of_work() as session:
        return list(session.scalars(select(Frame.id).where(Frame.pixels_removed.is_(None)).order_by(Frame.id)))


def count(database, model) -> int:
    with database.unit_of_work() as session:
        return session.scalar(select(func.count()).select_from(model))


def test_nothing_is_deleted_by_default(store):
    """By default all ages and sizes are unlimited, and nothing is deleted."""
    store.fill()
    store.add_packets("housekeeping", 50, 400, 1)
    result = store.end(store.retention.run(user="ann")).result["removed"]
    assert result == {"frames": 0, "bytes": 0, "packets": 0, "thinned": 0, "events": 0}


def test_old_pixels_are_deleted_and_rows_solutions_and_favourites_stay(store):
    """Old pixels are deleted, except those of favourites, of a calibration, of the newest frames, and shared blobs. Rows
    and solutions are kept."""
    old = [store.add_frame(bytes([k]) * 100, age_days=40) for k in range(6)]
    with store.database.unit_of_work() as session:
        upkeep.set_favourite(session, old[1], True)
        made = {"created": store.clock(), "author": "a", "tool": "t", "values": {}, "result": {}}
        session.add(Calibration(profile="p", kind="flat", name="n", request={"flat_pairs": [[old[2], 9]]}, **made))
    young = [store.add_frame(bytes([3]) * 100, age_days=1), store.add_frame(b"y" * 100, age_days=1)]
    store.retention.choose(RetentionPolicy(frames_days=30, keep_frames=2), user="ann")
    removed = store.end(store.retention.run(user="ann")).result["removed"]
    assert pixels_left(store.database) == [old[1], old[2], *young]
    assert (removed["frames"], removed["bytes"]) == (4, 300)
    assert store.blobs.exists(store.blobs.put(bytes([3]) * 100))
    assert not store.blob_path(bytes([0]) * 100).exists()
    assert (count(store.database, Frame), count(store.database, Solution)) == (8, 8)


def test_the_oldest_pixels_are_deleted_while_the_total_is_too_large(store):
    """While the total size is too large, the oldest pixels are deleted, and no more than necessary."""
    ids = [store.add_frame(bytes([k]) * 1000, age_days=k + 1) for k in range(5)]
    store.retention.choose(RetentionPolicy(frames_gb=3.2e-6, keep_frames=1), user="ann")
    store.end(store.retention.run(user="ann"))
    assert pixels_left(store.database) == ids[2:]


@pytest.mark.parametrize("batch", [7, 2000])
def test_packets_are_thinned_to_one_a_minute_and_then_deleted(store, batch, monkeypatch):
    """Thinning keeps the first packet of each minute and all responses to requests. Packets above the maximum age are
    deleted."""
    monkeypatch.setattr(upkeep.thin_packets, "__defaults__", (batch,))
    monkeypatch.setattr(upkeep.remove_packets, "__defaults__", (batch,))
    store.clock.at = store.clock.at.replace(second=0)
    store.add_packets("housekeeping", 180, 10, 1)
    store.add_packets("attitude", 30, 10, 1, request_id=5)
    store.add_packets("housekeeping", 40, 100, 1)
    store.add_packets("housekeeping", 25, 1, 1)
    store.retention.choose(RetentionPolicy(telemetry_thin_days=5, telemetry_days=50), user="ann")
    removed = store.end(store.retention.run(user="ann")).result["removed"]
    assert (removed["packets"], removed["thinned"]) == (40, 177)
    with store.database.unit_of_work() as session:
        rows = session.scalars(select(TelemetryPacket).order_by(TelemetryPacket.received)).all()
    assert [r.values["n"] for r in rows if r.packet == "housekeeping"] == [0, 60, 120, *range(25)]
    assert len([r for r in rows if r.packet == "attitude"]) == 30
    assert store.retention.removed_before() == store.clock() - timedelta(days=5)


@pytest.mark.parametrize("kept_times", [1, 2, 3, 4])
def test_after_a_kill_between_any_two_steps_the_next_server_completes_them(
    store, clock, tmp_path, monkeypatch, kept_times
):
    """After a kill between any two steps, the next server completes the removal, and exactly the same content is deleted."""
    monkeypatch.setattr(room, "FRAMES_AT_ONCE", 2)
    ids = [store.add_frame(bytes([k]) * 100, age_days=40) for k in range(6)]
    store.add_packets("housekeeping", 10, 40, 1)
    store.retention.choose(RetentionPolicy(frames_days=30, telemetry_days=30, keep_frames=0), user="ann")
    work, times, after = store.retention.work, [], []

    class Killed(BaseException):
        pass

    def dying(request, run):
        def keep(checkpoint, session=None):
            run.keep(checkpoint, session)
            times.append(1)
            if session is not None:
                session.commit()
            if len(times) == kept_times:
                with sqlite3.connect(tmp_path / "gss.db") as live, sqlite3.connect(tmp_path / "after.db") as copy:
                    live.backup(copy)
                live.close()
                copy.close()
                after.append(Database(open_engine(f"sqlite:///{tmp_path / 'after.db'}")))
                raise Killed

        try:
            return work(request, replace(run, keep=keep))
        except Killed:
            return {}

    store.jobs.register(JobKind("retention", RemovalJob, dying))
    store.end(store.retention.run(user="ann"))
    (database,) = after
    second = JobService(database, EventBus(database, clock), clock, lambda _: None)
    retention = RetentionService(
        database,
        store.blobs,
        second,
        EventBus(database, clock),
        store.link,
        tmp_path / "upkeep.lock",
        clock,
        store.trust,
        0.2,
    )
    second.start()
    second.finish()
    assert retention.last_run() is not None
    assert pixels_left(database) == []
    assert list(store.blobs.keys()) == []
    assert (count(database, Frame), count(database, TelemetryPacket)) == (len(ids), 0)
    removed = second.newest(1)[0].result["removed"]
    assert (removed["frames"], removed["packets"]) == (6, 10)
    database.close()


def test_the_forecast_states_when_the_disk_is_full_and_what_is_deleted_next(store):
    """The forecast extrapolates a week's growth into the free space. With a policy that limits the store it is never
    full."""
    for k in range(7):
        store.add_frame(bytes([k]) * 1_000_000, age_days=k + 0.5)
    store.room[0] = store.disk.stop_bytes + 10_000_000
    first = ForecastService(store.database, store.retention, store.disk, store.backups.folder).now()
    assert first.bytes_per_day == pytest.approx(1e6, rel=0.2)
    assert first.full_in_days == pytest.approx(10, rel=0.25)
    assert (first.next_removal, first.removable_bytes) == (None, 0)
    store.retention.choose(RetentionPolicy(frames_days=20, telemetry_days=9, keep_frames=0), user="ann")
    second = ForecastService(store.database, store.retention, store.disk, store.backups.folder).now()
    assert second.full_in_days is None
    assert second.next_removal == store.clock() + timedelta(days=13.5)


def test_a_young_store_is_forecast_from_its_age_and_a_new_one_not_at_all(store, bus, clock):
    """The forecast of a young store uses its age. In the first hour there is no forecast. Backups are included."""
    bus.record("server", "ok", "started")
    store.add_frame(random.Random(5).randbytes(1_000_000), age_days=0)
    clock.forward(840)
    new = ForecastService(store.database, store.retention, store.disk, store.backups.folder).now()
    assert (new.bytes_per_day, new.full_in_days) == (None, None)
    clock.forward(43200 - 840)
    young = ForecastService(store.database, store.retention, store.disk, store.backups.folder).now()
    assert young.bytes_per_day == pytest.approx(2e6, rel=0.01)
    assert young.backups_bytes == 0
    store.backups.make()
    later = ForecastService(store.database, store.retention, store.disk, store.backups.folder).now()
    assert later.backups_bytes > 1_000_000
    assert later.bytes_now == later.database_bytes + later.frames_bytes + later.captures_bytes + later.backups_bytes


def test_retention_runs_daily_and_not_while_the_clock_is_untrusted(store, bus, clock):
    """Retention runs once a day. After a clock jump it waits until the clock was steady for an hour, so that a jump ahead
    deletes nothing."""
    ids = [store.add_frame(bytes([k]) * 100, age_days=1) for k in range(3)]
    store.retention.choose(RetentionPolicy(frames_days=30, keep_frames=0), user="ann")
    mono = [0.0]
    clocks = ClockWatch(bus, clock, lambda: mono[0], [])
    daily = DailyRetention(store.retention, clocks, store.trust, clock)

    def live(seconds, times=1):
        for _ in range(times):
            clock.forward(seconds)
            mono[0] += seconds
            clocks.tick()
            daily.tick()

    def runs():
        return len([job for job in store.jobs.newest(50) if job.kind == "retention"])

    live(600, 5)
    assert runs() == 0
    clock.forward(366 * 86400)  # the jump
    live(1, 60)
    assert (runs(), clocks.last_jump_s, clocks.steady()) == (0, pytest.approx(366 * 86400), False)
    assert any("jumped forward" in event.text for event in bus.after(0, 100))
    clock.forward(-366 * 86400)  # an operator corrects it
    live(1, 2)
    live(1800, 2)
    store.end(store.jobs.newest(1)[0])
    assert runs() == 1
    assert pixels_left(store.database) == ids
    live(3600, 23)
    assert runs() == 1
    live(3600, 2)
    assert runs() == 2


def test_an_impossible_policy_is_rejected():
    """A policy with negative ages, or that deletes packets before they are thinned, is rejected."""
    for wrong in ({"frames_days": -1}, {"telemetry_days": 5, "telemetry_thin_days": 5}, {"frames_gb": float("nan")}):
        with pytest.raises((BadInput, ValidationError)):
            RetentionPolicy(**wrong)


def test_a_restarted_removal_or_backup_follows_the_current_policy(store):
    """A job started again uses the current policy instead of that of the old job, and belongs to the requesting user."""
    for _ in range(3):
        store.add_frame(b"x" * 10, age_days=9)
    store.retention.choose(RetentionPolicy(backups_keep=1), user="ann")
    strict = store.jobs.begin(
        "retention", "t", RemovalJob(RetentionPolicy(frames_days=1, keep_frames=0), user="ann"), lambda run: {}
    )
    once = store.end(store.backups.start(keep=1, user="ann"))
    store.end(strict)
    store.retention.choose(RetentionPolicy(), user="ann")
    removal = store.end(store.jobs.again(strict.id, user="bob"))
    assert (removal.request, removal.result["removed"]["frames"]) == (
        {"policy": RetentionPolicy().model_dump(), "user": "bob", "confirmed": None},
        0,
    )
    assert store.end(store.jobs.again(once.id, user="bob")).request == {"keep": 0, "user": "bob"}


def test_a_restarted_removal_needs_a_new_confirmation(store, clock, monkeypatch):
    """A removal that is started again needs a new confirmation. One that continues after a crash does not."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 0))
    store.retention.choose(RetentionPolicy(frames_days=1, keep_frames=0), user="ann")
    for k in range(3):
        store.add_frame(bytes([k]) * 10, age_days=9)
    shown = confirmation(store.retention.preview(store.retention.policy()))
    first = store.end(store.retention.run(user="ann", confirmed=shown))
    assert (first.state, first.result["removed"]["frames"]) == ("done", 3)
    for k in range(3):
        store.add_frame(bytes([9 + k]) * 10, age_days=9)
    restarted = store.end(store.jobs.again(first.id, user="bob"))
    assert (restarted.state, len(pixels_left(store.database))) == ("failed", 3)
    assert "needs confirmation" in restarted.text
    row = Job(kind="retention", title="t", state="running", text="", created=clock(), result={}, done=0, total=0)
    row.attempts, row.request = 0, first.request
    with store.database.unit_of_work() as session:
        session.add(row)
    store.jobs.start()
    assert (store.end(row).state, len(pixels_left(store.database))) == ("done", 0)


def test_a_removal_resumed_after_a_crash_follows_the_current_policy(store, clock, tmp_path):
    """A removal that is resumed after a crash uses the current policy, also if the old one was withdrawn meanwhile."""
    for _ in range(3):
        store.add_frame(b"x" * 10, age_days=9)
    begun = RetentionPolicy(frames_days=1, keep_frames=0)
    row = Job(
        kind="retention", title="t", state="running", text="", created=clock(), result={}, done=0, total=0, attempts=0
    )
    row.request = {"policy": begun.model_dump(), "user": "ann"}
    row.checkpoint = {"at": clock().isoformat(), "pending": [], "removed": dict.fromkeys(room.FIGURES, 0)}
    with store.database.unit_of_work() as session:
        session.add(row)
    store.retention.choose(RetentionPolicy(), user="ann")
    store.jobs.start()
    resumed = store.end(row)
    assert (resumed.state, resumed.result["removed"]["frames"]) == ("done", 0)
    assert len(pixels_left(store.database)) == 3
