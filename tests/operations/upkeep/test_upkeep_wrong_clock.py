"""A wrong clock deletes nothing that is stored: retention and unusually large removals wait for a confirmation."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import func, select

from gss.domain.errors import BadInput, Conflict
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep import removal
from gss.operations.upkeep.clock_trust import ClockTrust
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.removal import confirmation
from gss.operations.upkeep.retention_policy import RetentionPolicy
from gss.operations.upkeep.retention_watch import DailyRetention, RetentionWatch
from gss.store import choices
from gss.store.models import Base, Event

HOUR_S, DAY_S = 3600.0, 86_400.0
YEARS_S = 3652 * DAY_S
POLICY = RetentionPolicy(
    frames_days=30, keep_frames=0, telemetry_thin_days=20, telemetry_days=30, events_days=30, backups_keep=1
)


class RestartedServer:
    """The effects of a server start on the stored mission: clocks, daily removal, alarms."""

    def __init__(self, store: Any, bus: Any) -> None:
        self.store, self.clock, self.mono_s = store, store.clock, 0.0
        store.trust.start()
        dictionary = store.link.dictionary
        telemetry = TelemetryService(dictionary, store.database, bus, self.clock, lambda: None, lambda: True)
        self.alarms = AlarmService(dictionary, telemetry, store.link, store.database, bus, self.clock)
        self.alarms.start()
        self.clocks = ClockWatch(bus, self.clock, lambda: self.mono_s, [])
        self.daily = DailyRetention(store.retention, self.clocks, store.trust, self.clock)
        self.watch = RetentionWatch(store.trust, store.retention, self.alarms)

    def live(self, seconds: float, times: int) -> None:
        """Run the checks of the status thread and the jobs that they start."""
        for _ in range(times):
            self.clock.forward(seconds)
            self.mono_s += seconds
            for look in (self.clocks.tick, self.watch.tick, self.daily.tick):
                look()
            for job in self.store.jobs.newest(50):
                self.store.end(job)
        self.watch.tick()

    def titles(self) -> list[str]:
        """Return the titles of raised alarms."""
        return [view.title for view in self.alarms.opened() if view.row.state == "raised"]

    def runs(self) -> list[Any]:
        """Return the removals, newest first."""
        return [job for job in self.store.jobs.newest(50) if job.kind == "retention"]


def held(store: Any) -> dict[str, Any]:
    """Return the complete mission: rows, bytes, captures, backups."""
    with store.database.unit_of_work() as session:
        tables = [t for t in Base.metadata.sorted_tables if t.name not in ("choices", "events", "alarms", "jobs")]
        rows = {t.name: session.scalar(select(func.count()).select_from(t)) for t in tables}
        rows["first event"] = session.scalar(select(func.min(Event.seq)))
    files = {p.name for p in (store.folder / "captures").iterdir()}
    return {"rows": rows, "keys": set(store.blobs.keys()), "files": files, "backups": store.backups.every()}


@pytest.fixture
def mission(store, bus):
    """A stored mission of ten days with a policy of thirty, a backup, and a server that ran until now."""
    bus.record("server", "ok", "an event of the mission")
    store.fill()
    store.add_packets("housekeeping", 200, 3, 60)
    store.backups.make()
    store.retention.choose(POLICY, user="ann")
    server = RestartedServer(store, bus)
    server.live(HOUR_S, 30)
    assert [job.state for job in server.runs()] == ["done", "done"]
    assert server.titles() == []
    return store


@pytest.mark.parametrize("start_s", [YEARS_S, 31 * DAY_S, -99 * DAY_S], ids=["ten years", "a month", "99 days back"])
@pytest.mark.parametrize("step_s", [HOUR_S, DAY_S], ids=["hours", "days"])
def test_a_start_with_a_wrong_clock_deletes_nothing(mission, bus, clock, start_s, step_s):
    """Hours and days later, and after another start, every row, pixel, capture and backup exists, and an alarm states
    the reason.
    """
    before = held(mission)
    clock.forward(start_s)
    for _ in range(2):
        server = RestartedServer(mission, bus)
        server.live(step_s, 40)
        assert server.titles() == ["Server clock"]
        with pytest.raises(Conflict, match="clock is in doubt"):
            mission.retention.run(user="ann")
        assert mission.backups.prune(1, "none") == []
    assert held(mission) == before
    text = next(e.text for e in bus.after(0, 1000) if e.kind == "alarm")
    assert "retention is paused" in text
    assert "--confirm-clock" in text


def test_a_jump_while_the_server_runs_counts_too(mission, bus, clock):
    """Ten years forward without a restart, steady for days: nothing is deleted; after the correction the daily removal
    continues without confirmation.
    """
    server, before, runs = RestartedServer(mission, bus), held(mission), 2
    clock.forward(YEARS_S)
    server.live(HOUR_S, 60)
    assert (held(mission), server.titles(), len(server.runs())) == (before, ["Server clock"], runs)
    clock.forward(-YEARS_S)
    server.live(HOUR_S, 3)
    assert (server.titles(), len(server.runs())) == ([], runs + 1)


def test_an_operator_confirms_the_clock_and_then_the_removal(mission, bus, clock, monkeypatch):
    """After years without the server the confirmed clock is trusted; the large removal still needs one confirmation and
    deletes what was shown.
    """
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 2))
    clock.forward(YEARS_S)
    server = RestartedServer(mission, bus)
    server.live(HOUR_S, 3)
    with pytest.raises(BadInput, match="differs from the server's clock"):
        mission.trust.confirm(clock() - timedelta(days=1), user="ann")
    assert mission.trust.confirm(clock(), user="ann").doubt == ""
    server.live(HOUR_S, 1)
    assert (server.titles(), server.runs()[0].state) == (["Retention"], "failed")
    assert "needs confirmation" in server.runs()[0].text
    assert "3 of 4 frames" in mission.retention.waiting()
    with pytest.raises(Conflict, match="unusually large"):
        mission.retention.run(user="ann")
    seen = mission.retention.preview(POLICY)
    assert seen.unusual
    less = confirmation(mission.retention.preview(RetentionPolicy(**vars(POLICY) | {"frames_days": 0}), seen.at))
    with pytest.raises(Conflict, match="more data would be removed"):
        mission.retention.run(user="ann", confirmed=less)
    job = mission.end(mission.retention.run(user="ann", confirmed=confirmation(seen)))
    assert (job.state, job.result["removed"]["frames"], job.result["removed"]["packets"]) == ("done", 3, 200)
    server.live(1, 1)
    assert (server.titles(), mission.retention.waiting()) == ([], "")
    assert len(mission.backups.every()) == 1


def test_an_old_confirmation_is_invalid(mission, clock, monkeypatch):
    """A preview of two hours ago, or of another clock, is rejected."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 0))
    clock.forward(25 * DAY_S)
    mission.trust.confirm(clock(), user="ann")
    seen = mission.retention.preview(POLICY)
    for seconds in (2 * HOUR_S, -3 * HOUR_S):
        clock.forward(seconds)
        with pytest.raises(Conflict, match=r"out of date|in doubt"):
            mission.retention.run(user="ann", confirmed=confirmation(seen))


def test_a_jump_of_a_plausible_pause_still_needs_confirmation_of_a_large_removal(mission, bus, clock, monkeypatch):
    """29 days ahead is a plausible pause; the rest of the store would be deleted, so a confirmation is needed."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 2))
    before = held(mission)
    clock.forward(29 * DAY_S)
    server = RestartedServer(mission, bus)
    server.live(HOUR_S, 30)
    assert (server.titles(), held(mission)) == (["Retention"], before)
    mission.retention.choose(RetentionPolicy(frames_days=3000), user="ann")
    server.live(DAY_S, 2)
    assert (server.titles(), server.runs()[0].state) == ([], "done")


@pytest.mark.parametrize(
    "policy",
    [RetentionPolicy(telemetry_days=3), RetentionPolicy(telemetry_days=0.5), RetentionPolicy(telemetry_thin_days=2)],
)
def test_daily_retention_continues_when_a_day_is_a_large_share(store, bus, clock, policy, monkeypatch):
    """A store that keeps only a few days deletes a day's packets each day without confirmation, however large their
    share.
    """
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 5))
    server = RestartedServer(store, bus)
    store.retention.choose(policy, user="ann")
    for _ in range(12):
        store.add_packets("housekeeping", 48, 0, 1800)
        server.live(HOUR_S, 24)
    assert {job.state for job in server.runs()} == {"done"}
    assert server.titles() == []
    with store.database.unit_of_work() as session:
        left = session.scalar(select(func.count()).select_from(Base.metadata.tables["telemetry_packets"]))
    assert left <= (12 if policy.telemetry_thin_days else 5) * 48


def test_a_removal_after_weeks_without_retention_needs_confirmation(store, bus, monkeypatch):
    """Everything stored has arrived since the last removal weeks ago; this does not make a large removal usual."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 5))
    server = RestartedServer(store, bus)
    store.retention.choose(RetentionPolicy(telemetry_days=300), user="ann")
    server.live(HOUR_S, 3)
    assert [job.state for job in server.runs()] == ["done"]
    store.retention.choose(RetentionPolicy(), user="ann")
    for _ in range(25):
        store.add_packets("housekeeping", 48, 0, 1800)
        server.live(HOUR_S, 24)
    store.retention.choose(RetentionPolicy(telemetry_days=1), user="ann")
    server.live(HOUR_S, 30)
    assert (server.titles(), server.runs()[0].state) == (["Retention"], "failed")
    with store.database.unit_of_work() as session:
        assert session.scalar(select(func.count()).select_from(Base.metadata.tables["telemetry_packets"])) == 25 * 48


def test_without_a_trusted_time_nothing_is_deleted(mission, clock):
    """An unknown time permits no deletion; a start uses the newest stored row, not the clock."""
    with mission.database.unit_of_work() as session:
        choices.forget(session, choices.TRUSTED_TIME)
    assert mission.trust.state().doubt == "no trusted time is stored"
    with pytest.raises(Conflict):
        mission.retention.run(user="ann")
    clock.forward(YEARS_S)
    again = ClockTrust(mission.database, None, clock, timedelta(days=30))
    again.start()
    assert "days ahead" in again.state().doubt


def test_backups_with_a_wrong_date_displace_no_others(store, clock):
    """Backups dated in the future are neither deleted nor counted, and the one just made always stays."""
    old = store.backups.make()
    clock.forward(YEARS_S)
    future = store.backups.make()
    clock.forward(DAY_S - YEARS_S)
    made = store.backups.make()
    assert store.backups.prune(1, made.name) == [old.name]
    clock.forward(-HOUR_S / 2)
    earlier = store.backups.make()
    assert store.backups.prune(1, earlier.name) == [made.name]
    assert {m.name for m in store.backups.every()} == {future.name, earlier.name}
