"""Bank history: device reports become spans that survive a restart, with plans, coverage and an expiry alarm."""

from __future__ import annotations

from datetime import timedelta

import pytest

from gss.device.session_events import (
    CommandUpdate,
    DeviceEvent,
    Direction,
    HelloReceived,
    Stage,
    Telemetry,
    TransferDone,
)
from gss.domain.errors import BadInput, Conflict, NotFound, StoreDown
from gss.domain.limits import State
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers import bank_history
from gss.operations.transfers.bank_history import BankHistoryService, Planned
from gss.operations.transfers.bank_plans import cover
from gss.operations.transfers.expiry import ExpiryWatch
from gss.store import catalogues, commands, devices
from gss.store.models import Catalogue

DICTIONARY = load_dictionary()
OLD, NEW = "a1" * 32, "b2" * 32


class BankHistoryHarness:
    """Bank history, alarms and a recorded device, without a link."""

    def __init__(self, database, bus, clock, folder) -> None:
        self.database, self.clock = database, clock
        self.link = LinkService(
            DICTIONARY,
            default_roles(DICTIONARY),
            database,
            bus,
            folder,
            clock,
            lambda: 0.0,
            LineEventQueue(clock, lambda: 0.0),
        )
        telemetry = TelemetryService(
            DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
        )
        self.alarms = AlarmService(DICTIONARY, telemetry, self.link, database, bus, clock)
        self.alarms.start()
        self.history = BankHistoryService(self.link, database, clock, [])
        self.expiry = ExpiryWatch(self.history, self.alarms, clock, watch_days=5.0)

    def identify(self, serial="FM2") -> None:
        """Process the identification of a device on a new contact."""
        with self.database.unit_of_work() as session:
            contact = devices.open_contact(session, "x", self.clock(), "")
            facts = {"profile": "cubestar", "firmware": "1", "simulated": True, "dictionary_hash": "0"}
            device = devices.remember(session, self.clock(), name=serial, **facts)
            devices.update_contact(session, contact.id, device_id=device.id)
        self.link.contact.contact_id = contact.id
        numbers = (3_000_000, 1024, 512, 8, 4, 262144, 1, 0, 0.0)
        self.history.handle(
            LineBatch(
                (HelloReceived("CubeStar", "cubestar", "1", serial, True, "0", True, *numbers),), self.clock(), 0.0
            )
        )

    def report(self, bank, state, sha256="", active=False) -> None:
        """Process a bank report."""
        values = {"bank": bank, "state": state, "active": active, "sha256": bytes.fromhex(sha256 or "00" * 32)}
        self.history.handle(LineBatch((Telemetry("bank_info", 1.0, 0, values, values),), self.clock(), 0.0))

    def keep(self, name, sha256, *, days=None, read_back=False) -> Catalogue:
        """Store a catalogue that is valid from now for ``days``. One that was read back has no request."""
        start = self.clock()
        row = Catalogue(
            name=name,
            profile="cubestar",
            format="cubestar",
            created=start,
            author="cm",
            stars=3,
            pairs=3,
            size=100,
            sha256=sha256,
            valid_from=start,
            valid_to=None if days is None else start + timedelta(days=days),
            request={} if read_back else {"orbit": "none"},
            manifest={},
            report={},
        )
        with self.database.unit_of_work() as session:
            return catalogues.add(session, row)

    def command(self, name, bank) -> None:
        """Process a completed command of the user ann on a bank."""
        facts = {"contact_id": None, "request_id": 77, "name": name, "arguments": {"bank": bank}, "user": "ann"}
        with self.database.unit_of_work() as session:
            commands.add(session, self.clock(), source="form", **facts)
        self.history.handle(LineBatch((CommandUpdate(77, name, Stage.COMPLETED),), self.clock(), 0.0))

    def rows(self, history=None):
        """Return (bank, state, prefix of the hash, how, user, ended) of the last year."""
        span = self.clock() - timedelta(days=365), self.clock() + timedelta(days=1)
        stays = (history or self.history).timeline(*span).stays
        return [
            (s.row.bank, s.row.state, s.row.sha256[:2], s.row.how, s.row.user, s.row.ended is not None) for s in stays
        ]


@pytest.fixture
def harness(database, bus, clock, tmp_path):
    return BankHistoryHarness(database, bus, clock, tmp_path)


def test_a_repeated_report_extends_the_period(harness):
    """A repeated report extends the current period. Only a change adds a row."""
    harness.identify()
    harness.report("A", "committed", OLD, active=True)
    harness.clock.forward(60)
    harness.report("A", "committed", OLD, active=True)
    assert harness.rows() == [("A", "active", "a1", "reported", "", False)]
    (stay,) = harness.history.timeline(harness.clock() - timedelta(days=1), harness.clock()).stays
    assert stay.row.reported - stay.row.began == timedelta(seconds=60)


def test_upload_activation_and_confirmation_are_recorded_with_user_and_cause(harness):
    """The history records the upload, the user's activation as a trial, the confirmation, and that the previous bank is
    kept."""
    harness.identify()
    harness.report("A", "empty")
    harness.report("B", "committed", OLD, active=True)
    harness.history.handle(
        LineBatch((TransferDone(1, Direction.UP, "catalogue", 0, 0, b"", NEW),), harness.clock(), 0.0)
    )
    harness.report("A", "committed", NEW)
    harness.command("ACTIVATE_BANK", "A")
    harness.report("A", "committed", NEW, active=True)
    harness.report("B", "committed", OLD)
    harness.history.handle(LineBatch((DeviceEvent("BANK_CONFIRMED", "ok", "", 2.0),), harness.clock(), 0.0))
    assert harness.rows() == [
        ("A", "empty", "", "reported", "", True),
        ("A", "held", "b2", "upload", "", True),
        ("A", "trial", "b2", "ACTIVATE_BANK", "ann", True),
        ("A", "active", "b2", "CONFIRM_BANK", "ann", False),
        ("B", "active", "a1", "reported", "", True),
        ("B", "held", "a1", "ACTIVATE_BANK", "ann", False),
    ]


def test_a_trial_that_falls_back_was_never_active(harness):
    """After a fallback the previous bank is active again, the other one is held, and both rows state the fallback."""
    harness.identify()
    harness.report("A", "committed", OLD, active=True)
    harness.command("ACTIVATE_BANK", "B")
    harness.report("A", "committed", OLD)
    harness.report("B", "committed", NEW, active=True)
    harness.history.handle(LineBatch((DeviceEvent("BANK_FELL_BACK", "warning", "", 3.0),), harness.clock(), 0.0))
    harness.report("A", "committed", OLD, active=True)
    harness.report("B", "committed", NEW)
    assert [(b, s, how) for b, s, _, how, _, ended in harness.rows() if not ended] == [
        ("A", "active", "fell back"),
        ("B", "held", "fell back"),
    ]
    assert [s for b, s, *_ in harness.rows() if b == "B"] == ["trial", "held"]


def test_the_record_survives_a_restart_and_is_separate_per_device(harness):
    """A restarted service reads the same periods, separately for each device."""
    harness.identify("FM1")
    harness.report("A", "committed", OLD, active=True)
    harness.clock.forward(3600)
    harness.identify("FM2")
    harness.report("A", "corrupt")
    restarted = BankHistoryService(harness.link, harness.database, harness.clock, [])
    span = harness.clock() - timedelta(days=1), harness.clock()
    newest = restarted.timeline(*span)
    assert (newest.device.name, [d.name for d in newest.devices]) == ("FM2", ["FM2", "FM1"])
    assert [s.row.state for s in newest.stays] == ["damaged"]
    first = restarted.timeline(*span, device_id=newest.devices[1].id)
    assert [(s.row.state, s.row.sha256) for s in first.stays] == [("active", OLD)]


def test_a_bank_that_is_read_back_later_gets_its_name(harness):
    """The record stores the hash of a bank. Its catalogue is found when a catalogue with this hash becomes available."""
    harness.identify()
    harness.report("A", "committed", OLD, active=True)
    assert harness.history.active().catalogue is None
    harness.keep("read-back", OLD)
    assert harness.history.active().catalogue.name == "read-back"


def test_missing_records_and_impossible_spans_are_rejected(harness):
    """A request without a recorded device, for an unknown device, or with an inverted span is rejected."""
    span = harness.clock() - timedelta(days=1), harness.clock()
    with pytest.raises(NotFound, match="no banks recorded"):
        harness.history.timeline(*span)
    harness.identify()
    harness.report("A", "empty")
    with pytest.raises(NotFound, match="device 99"):
        harness.history.timeline(*span, device_id=99)
    with pytest.raises(BadInput, match="invalid time span"):
        harness.history.timeline(*reversed(span))


def test_an_expiring_catalogue_raises_an_alarm_that_escalates(harness):
    """An expiring catalogue raises a watch at five days, a warning at one, and is critical when it has expired. Another
    active catalogue clears the alarm."""
    harness.identify()
    harness.keep("zen-1", OLD, days=14)
    harness.keep("zen-2", NEW, days=40)
    harness.report("B", "committed", OLD, active=True)
    levels = []
    for _ in range(15):
        harness.expiry.tick()
        levels += [view.row.worst for view in harness.alarms.opened()]
        harness.clock.forward(86400)
    assert levels == ["watch"] * 4 + ["warning", "critical"]
    (view,) = harness.alarms.opened()
    assert view.text == "Catalogue zen-1 expired 2026-12-15 18:00 UTC (critical)"
    with pytest.raises(Conflict, match="persists"):
        harness.alarms.clear(view.row.id, user="ann")
    harness.alarms.acknowledge(view.row.id, user="ann", note="new one follows")
    harness.alarms.shelve(view.row.id, harness.clock() + timedelta(hours=1), user="ann", note="pass at 20")
    harness.report("B", "committed", OLD)
    harness.report("A", "committed", NEW, active=True)
    harness.expiry.tick()
    assert harness.alarms.opened() == []


def test_the_expiry_alarm_needs_no_link_and_survives_a_restart(harness):
    """A restarted service keeps the open alarm of the recorded active bank and does not raise another."""
    harness.identify()
    harness.keep("zen-1", OLD, days=3)
    harness.report("B", "committed", OLD, active=True)
    harness.link.contact.contact_id = None
    harness.expiry.tick()
    harness.alarms.start()
    ExpiryWatch(
        BankHistoryService(harness.link, harness.database, harness.clock, []), harness.alarms, harness.clock, 5.0
    ).tick()
    (view,) = harness.alarms.opened()
    assert view.level is State.WATCH
    assert len(harness.alarms.newest(10)) == 1


def test_coverage_is_described_in_text(harness):
    """The text states a gap in coverage and the bank that would close it. A planned activation in time closes it."""
    harness.identify()
    now = harness.clock()
    harness.keep("zen-1", OLD, days=3)
    harness.keep("zen-2", NEW, days=20)
    harness.report("B", "committed", OLD, active=True)
    span = now - timedelta(days=1), now

    def coverage(planned=()):
        return cover(harness.history.timeline(*span).stays, planned, now, watch_days=5.0)

    assert (coverage().state, coverage().text) == (
        State.WATCH,
        "no cover from 12-04 18:00 and no bank holds a successor",
    )
    harness.report("A", "committed", NEW)
    assert coverage().text == "no cover from 12-04 18:00 unless bank A is activated"
    at = now + timedelta(days=2)
    plan = Planned("A", "activation", at, NEW, "zen-2", 2, now, now + timedelta(days=20), "")
    assert (coverage([plan]).state, coverage([plan]).text) == (State.OK, "cover until 2026-12-21")
    late = Planned("A", "activation", now + timedelta(days=4), NEW, "zen-2", 2, now, now + timedelta(days=20), "")
    assert coverage([late]).state is State.WATCH
    unknown = Planned("A", "activation", at, "", "", None, None, None, "")
    assert (coverage([unknown]).state, "does not have the content of bank A" in coverage([unknown]).text) == (
        State.WATCH,
        True,
    )
    short = Planned("A", "activation", at, NEW, "zen-2", 2, now, now + timedelta(days=2, hours=12), "")
    assert coverage([short]).until == now + timedelta(days=2, hours=12)
    back = Planned("B", "activation", now + timedelta(days=2, hours=6), OLD, "zen", 1, now, None, "")
    assert (coverage([short, back]).state, coverage([short, back]).text) == (
        State.OK,
        "bank B follows and does not expire",
    )


def test_the_cover_of_a_catalogue_that_was_read_back_is_unknown(harness):
    """A catalogue that was read back has no period of validity. It is stated as unknown, not as unlimited, and such a
    catalogue is not proposed as successor."""
    harness.identify()
    now = harness.clock()
    harness.keep("zen-1", OLD, days=3)
    harness.keep("cubestar-read-back", NEW, read_back=True)
    harness.report("B", "committed", OLD, active=True)
    harness.report("A", "committed", NEW)

    def coverage(planned=()):
        return cover(harness.history.timeline(now - timedelta(days=1), now).stays, planned, now, watch_days=5.0)

    assert coverage().text == "no cover from 12-04 18:00 and no bank holds a successor"
    plan = Planned("A", "activation", now + timedelta(days=2), NEW, "cubestar-read-back", 2, None, None, "", False)
    expected = (State.WATCH, "the validity of bank A is unknown (read back)", None)
    planned = coverage([plan])
    harness.report("B", "committed", OLD)
    harness.report("A", "committed", NEW, active=True)
    for seen in (planned, coverage()):
        assert (seen.state, seen.text, seen.until) == expected


def test_reports_of_a_new_device_are_not_added_to_the_history_of_the_last(harness, monkeypatch):
    """The device of a contact could not be looked up when it answered. The next report does it."""
    harness.identify("FM1")
    harness.report("A", "committed", OLD, active=True)
    with monkeypatch.context() as patch:

        def fails(*_):
            raise StoreDown("the database is locked")

        patch.setattr(bank_history.store, "device_of_contact", fails)
        with pytest.raises(StoreDown):
            harness.identify("FM2")
    harness.report("A", "committed", NEW, active=True)
    with harness.database.unit_of_work() as session:
        found = {device.name: device.id for device in bank_history.store.devices(session)}
        kept = {
            row.sha256: row.device_id for name in found for row in bank_history.store.still_so(session, found[name])
        }
    assert kept == {OLD: found["FM1"], NEW: found["FM2"]}
