"""A wrong clock causes no deletion: retention and unusually large removals wait for a confirmation."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import func, select

from gss.domain.errors import BadInput, Conflict
from gss.instruments.roles import default_roles
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
    """Clocks, daily removal and alarms of a server that was started with the stored mission."""

    def __init__(self, store: Any, bus: Any) -> None:
        self.store, self.clock, self.mono_s = store, store.clock, 0.0
        store.trust.start()
        dictionary = store.link.dictionary
        telemetry = TelemetryService(
            dictionary,
            store.database,
            bus,
            self.clock,
            lambda: None,
            lambda: True,
            default_roles(dictionary).quantities.status,
        )
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


def stored_content(store: Any) -> dict[str, Any]:
    """Return the complete stored content: numbers of rows, blob keys, captures and backups."""
    with store.database.unit_of_work() as session:
        tables = [t for t in Base.metadata.sorted_tables if t.name not in ("choices", "events", "alarms", "jobs")]
        rows = {t.name: session.scalar(select(func.count()).select_from(t)) for t in tables}
        rows["first event"] = session.scalar(select(func.min(Event.seq)))
    files = {p.name for p in (store.folder / "captures").iterdir()}
    return {"rows": rows, "keys": set(store.blobs.keys()), "files": files, "backups": store.backups.list_all()}


@pytest.fixture
def mission(store, bus):
    """Store with a mission of ten days, a policy of thirty days and a backup, whose server ran until now."""
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
    """After a start with a wrong clock, retention is paused with an alarm, and all content exists, also after days and
    another start."""
    before = stored_content(mission)
    clock.forward(start_s)
    for _ in range(2):
        server = RestartedServer(mission, bus)
        server.live(step_s, 40)
        assert server.titles() == ["Server clock"]
        with pytest.raises(Conflict, match="clock is in doubt"):
            mission.retention.run(user="ann")
        assert mission.backups.prune(1, "none") == []
    assert stored_content(mission) == before
    text = next(e.text for e in bus.after(0, 1000) if e.kind == "alarm")
    assert "retention is paused" in text
    assert "--confirm-clock" in text


def test_a_jump_while_the_server_runs_counts_too(mission, bus, clock):
    """After a jump of ten years while the server runs, nothing is deleted. When the clock is corrected, the daily removal
    continues without a confirmation."""
    server, before, runs = RestartedServer(mission, bus), stored_content(mission), 2
    clock.forward(YEARS_S)
    server.live(HOUR_S, 60)
    assert (stored_content(mission), server.titles(), len(server.runs())) == (before, ["Server clock"], runs)
    clock.forward(-YEARS_S)
    server.live(HOUR_S, 3)
    assert (server.titles(), len(server.runs())) == ([], runs + 1)


def test_an_operator_confirms_the_clock_and_then_the_removal(mission, bus, clock, monkeypatch):
    """An operator can confirm a clock that is years ahead. The large removal needs another confirmation and deletes the
    previewed content."""
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
    preview = mission.retention.preview(POLICY)
    assert preview.unusual
    less = confirmation(mission.retention.preview(RetentionPolicy(**vars(POLICY) | {"frames_days": 0}), preview.at))
    with pytest.raises(Conflict, match="more data would be removed"):
        mission.retention.run(user="ann", confirmed=less)
    job = mission.end(mission.retention.run(user="ann", confirmed=confirmation(preview)))
    assert (job.state, job.result["removed"]["frames"], job.result["removed"]["packets"]) == ("done", 3, 200)
    server.live(1, 1)
    assert (server.titles(), mission.retention.waiting()) == ([], "")
    assert len(mission.backups.list_all()) == 1


def test_an_old_confirmation_is_invalid(mission, clock, monkeypatch):
    """The confirmation of a preview that is two hours old, or of another clock, is rejected."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 0))
    clock.forward(25 * DAY_S)
    mission.trust.confirm(clock(), user="ann")
    preview = mission.retention.preview(POLICY)
    for seconds in (2 * HOUR_S, -3 * HOUR_S):
        clock.forward(seconds)
        with pytest.raises(Conflict, match=r"out of date|in doubt"):
            mission.retention.run(user="ann", confirmed=confirmation(preview))


def test_a_jump_of_a_plausible_pause_still_needs_confirmation_of_a_large_removal(mission, bus, clock, monkeypatch):
    """A jump of 29 days ahead is plausible, but the large removal that it would cause needs a confirmation."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 2))
    before = stored_content(mission)
    clock.forward(29 * DAY_S)
    server = RestartedServer(mission, bus)
    server.live(HOUR_S, 30)
    assert (server.titles(), stored_content(mission)) == (["Retention"], before)
    mission.retention.choose(RetentionPolicy(frames_days=3000), user="ann")
    server.live(DAY_S, 2)
    assert (server.titles(), server.runs()[0].state) == ([], "done")


@pytest.mark.parametrize(
    "policy",
    [RetentionPolicy(telemetry_days=3), RetentionPolicy(telemetry_days=0.5), RetentionPolicy(telemetry_thin_days=2)],
)
def test_daily_retention_continues_when_a_day_is_a_large_share(store, bus, clock, policy, monkeypatch):
    """A store that keeps only a few days deletes a day's packets daily without a confirmation, although their share is
    large."""
    monkeypatch.setattr(removal, "FEW", dict.fromkeys(removal.FEW, 5))
    server = RestartedServer(store, bus)
    store.retention.choose(policy, user="ann")
    for _ in range(12):
        store.add_packets("housekeeping", 48, 0, 1800)
        server.live(HOUR_S, 24)
    assert {job.state for job in server.runs()} == {"done"}
    assert server.titles() == []
    with store.database.unit_of_work() as session:
        packets_left = session.scalar(select(func.count()).select_from(Base.metadata.tables["telemetry_packets"]))
    assert packets_left <= (12 if policy.telemetry_thin_days else 5) * 48


def test_a_removal_after_weeks_without_retention_needs_confirmation(store, bus, monkeypatch):
    """A large removal needs a confirmation, also if all content was stored since the last removal weeks earlier."""
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
    """Without a trusted time nothing is deleted. The next start derives it from the newest stored row, not from the clock."""
    with mission.database.unit_of_work() as session:
        choices.forget(session, choices.TRUSTED_TIME)
    assert mission.trust.state().doubt == "no trusted time is stored"
    with pytest.raises(Conflict):
        mission.retention.run(user="ann")
    clock.forward(YEARS_S)
    restarted = ClockTrust(mission.database, None, clock, timedelta(days=30))
    restarted.start()
    assert "days ahead" in restarted.state().doubt


def test_backups_with_a_wrong_date_replace_no_others(store, clock):
    """Backups dated in the future are neither deleted nor counted. The newest created backup is always kept."""
    old = store.backups.make()
    clock.forward(YEARS_S)
    future = store.backups.make()
    clock.forward(DAY_S - YEARS_S)
    made = store.backups.make()
    assert store.backups.prune(1, made.name) == [old.name]
    clock.forward(-HOUR_S / 2)
    earlier = store.backups.make()
    assert store.backups.prune(1, earlier.name) == [made.name]
    assert {m.name for m in store.backups.list_all()} == {future.name, earlier.name}
