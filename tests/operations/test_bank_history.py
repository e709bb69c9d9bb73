"""Banks on record: what a device tells becomes spans that survive a restart, with plans, cover and an alarm before the end."""

from __future__ import annotations

from datetime import timedelta

import pytest

from gss.device.dictionary_file import load_dictionary
from gss.device.session_events import (
    CommandStage,
    DeviceEvent,
    Direction,
    HelloReceived,
    Stage,
    Telemetry,
    TransferDone,
)
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.domain.limits import State
from gss.operations.line.line_events import LineBatch, LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.bank_history import BankHistoryService, Planned
from gss.operations.transfers.bank_plans import cover
from gss.operations.transfers.expiry import ExpiryWatch
from gss.store import catalogues, commands, devices
from gss.store.models import Catalogue

DICTIONARY = load_dictionary()
OLD, NEW = "a1" * 32, "b2" * 32


class Room:
    """Bank history, alarms and a device that is on record, without a line."""

    def __init__(self, database, bus, clock, folder) -> None:
        self.database, self.clock = database, clock
        self.link = LinkService(
            DICTIONARY, database, bus, folder, clock, lambda: 0.0, LineEventQueue(clock, lambda: 0.0)
        )
        telemetry = TelemetryService(DICTIONARY, database, bus, clock, lambda: None, lambda: True)
        self.alarms = AlarmService(DICTIONARY, telemetry, self.link, database, bus, clock)
        self.alarms.start()
        self.history = BankHistoryService(self.link, database, clock, [])
        self.expiry = ExpiryWatch(self.history, self.alarms, clock, watch_days=5.0)

    def meet(self, serial="FM2") -> None:
        """A device says hello on a new contact."""
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

    def tell(self, bank, state, sha256="", active=False) -> None:
        """A bank report."""
        values = {"bank": bank, "state": state, "active": active, "sha256": bytes.fromhex(sha256 or "00" * 32)}
        self.history.handle(LineBatch((Telemetry("bank_info", 1.0, 0, values, values),), self.clock(), 0.0))

    def keep(self, name, sha256, *, days=None) -> Catalogue:
        """A catalogue in the store, valid from now for so many days."""
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
            request={},
            manifest={},
            report={},
        )
        with self.database.unit_of_work() as session:
            return catalogues.add(session, row)

    def command(self, name, bank) -> None:
        """A command of ann's on a bank completes."""
        facts = {"contact_id": None, "request_id": 77, "name": name, "arguments": {"bank": bank}, "user": "ann"}
        with self.database.unit_of_work() as session:
            commands.add(session, self.clock(), source="form", **facts)
        self.history.handle(LineBatch((CommandStage(77, name, Stage.COMPLETED),), self.clock(), 0.0))

    def rows(self, history=None):
        """(bank, state, hash's begin, how, user, ended?) of the last year."""
        span = self.clock() - timedelta(days=365), self.clock() + timedelta(days=1)
        stays = (history or self.history).timeline(*span).stays
        return [
            (s.row.bank, s.row.state, s.row.sha256[:2], s.row.how, s.row.user, s.row.ended is not None) for s in stays
        ]


@pytest.fixture
def room(database, bus, clock, tmp_path):
    return Room(database, bus, clock, tmp_path)


def test_the_same_report_again_is_the_same_span(room):
    """Only what changes makes a row; what is told again is confirmed."""
    room.meet()
    room.tell("A", "committed", OLD, active=True)
    room.clock.forward(60)
    room.tell("A", "committed", OLD, active=True)
    assert room.rows() == [("A", "active", "a1", "reported", "", False)]
    (stay,) = room.history.timeline(room.clock() - timedelta(days=1), room.clock()).stays
    assert stay.row.told - stay.row.began == timedelta(seconds=60)


def test_upload_activation_and_confirmation_are_told_with_who_and_how(room):
    """An upload fills the bank, ann's activation is a trial, and the confirmation makes it active; the old bank is held."""
    room.meet()
    room.tell("A", "empty")
    room.tell("B", "committed", OLD, active=True)
    room.history.handle(LineBatch((TransferDone(1, Direction.UP, "catalogue", 0, 0, b"", NEW),), room.clock(), 0.0))
    room.tell("A", "committed", NEW)
    room.command("ACTIVATE_BANK", "A")
    room.tell("A", "committed", NEW, active=True)
    room.tell("B", "committed", OLD)
    room.history.handle(LineBatch((DeviceEvent("BANK_CONFIRMED", "ok", "", 2.0),), room.clock(), 0.0))
    assert room.rows() == [
        ("A", "empty", "", "reported", "", True),
        ("A", "held", "b2", "upload", "", True),
        ("A", "trial", "b2", "ACTIVATE_BANK", "ann", True),
        ("A", "active", "b2", "CONFIRM_BANK", "ann", False),
        ("B", "active", "a1", "reported", "", True),
        ("B", "held", "a1", "ACTIVATE_BANK", "ann", False),
    ]


def test_a_trial_that_falls_back_was_never_active(room):
    """Without a confirmation the bank before is active again, and the record says that it fell back."""
    room.meet()
    room.tell("A", "committed", OLD, active=True)
    room.command("ACTIVATE_BANK", "B")
    room.tell("A", "committed", OLD)
    room.tell("B", "committed", NEW, active=True)
    room.history.handle(LineBatch((DeviceEvent("BANK_FELL_BACK", "warning", "", 3.0),), room.clock(), 0.0))
    room.tell("A", "committed", OLD, active=True)
    room.tell("B", "committed", NEW)
    assert [(b, s, how) for b, s, _, how, _, ended in room.rows() if not ended] == [
        ("A", "active", "fell back"),
        ("B", "held", "fell back"),
    ]
    assert [s for b, s, *_ in room.rows() if b == "B"] == ["trial", "held"]


def test_the_record_survives_a_restart_and_devices_are_kept_apart(room):
    """A new service reads the same spans; another device has its own."""
    room.meet("FM1")
    room.tell("A", "committed", OLD, active=True)
    room.clock.forward(3600)
    room.meet("FM2")
    room.tell("A", "corrupt")
    again = BankHistoryService(room.link, room.database, room.clock, [])
    span = room.clock() - timedelta(days=1), room.clock()
    newest = again.timeline(*span)
    assert (newest.device.name, [d.name for d in newest.devices]) == ("FM2", ["FM2", "FM1"])
    assert [s.row.state for s in newest.stays] == ["damaged"]
    first = again.timeline(*span, device_id=newest.devices[1].id)
    assert [(s.row.state, s.row.sha256) for s in first.stays] == [("active", OLD)]


def test_a_bank_that_is_read_back_later_gets_its_name(room):
    """The record keeps the hash; the catalogue under it is found when it is known."""
    room.meet()
    room.tell("A", "committed", OLD, active=True)
    assert room.history.active().catalogue is None
    room.keep("read-back", OLD)
    assert room.history.active().catalogue.name == "read-back"


def test_nothing_on_record_and_impossible_spans_are_named(room):
    """No device, a device that never was, a span that ends before it starts."""
    span = room.clock() - timedelta(days=1), room.clock()
    with pytest.raises(NotFound, match="no banks are on record"):
        room.history.timeline(*span)
    room.meet()
    room.tell("A", "empty")
    with pytest.raises(NotFound, match="device 99"):
        room.history.timeline(*span, device_id=99)
    with pytest.raises(BadInput, match="span is impossible"):
        room.history.timeline(*reversed(span))


def test_an_expiring_catalogue_is_an_alarm_that_grows_and_is_seen(room):
    """Quiet, watch at five days, warning at one, critical when it has expired; a new active catalogue ends it."""
    room.meet()
    room.keep("zen-1", OLD, days=14)
    room.keep("zen-2", NEW, days=40)
    room.tell("B", "committed", OLD, active=True)
    levels = []
    for _ in range(15):
        room.expiry.tick()
        levels += [view.row.worst for view in room.alarms.opened()]
        room.clock.forward(86400)
    assert levels == ["watch"] * 4 + ["warning", "critical"]
    (view,) = room.alarms.opened()
    assert view.text == "Catalogue zen-1 expired 2026-12-15 18:00 UTC (critical)"
    with pytest.raises(Conflict, match="still there"):
        room.alarms.clear(view.row.id, user="ann")
    room.alarms.acknowledge(view.row.id, user="ann", note="new one follows")
    room.alarms.shelve(view.row.id, room.clock() + timedelta(hours=1), user="ann", note="pass at 20")
    room.tell("B", "committed", OLD)
    room.tell("A", "committed", NEW, active=True)
    room.expiry.tick()
    assert room.alarms.opened() == []


def test_the_expiry_alarm_needs_no_line_and_survives_a_restart(room):
    """The record knows what was active; a service that starts anew takes the open alarm up and does not raise another."""
    room.meet()
    room.keep("zen-1", OLD, days=3)
    room.tell("B", "committed", OLD, active=True)
    room.link.contact.contact_id = None
    room.expiry.tick()
    room.alarms.start()
    ExpiryWatch(BankHistoryService(room.link, room.database, room.clock, []), room.alarms, room.clock, 5.0).tick()
    (view,) = room.alarms.opened()
    assert view.level is State.WATCH
    assert len(room.alarms.newest(10)) == 1


def test_cover_is_said_in_words(room):
    """A gap is named, with the bank that would close it; a planned activation closes it."""
    room.meet()
    now = room.clock()
    room.keep("zen-1", OLD, days=3)
    room.keep("zen-2", NEW, days=20)
    room.tell("B", "committed", OLD, active=True)
    span = now - timedelta(days=1), now

    def word(planned=()):
        return cover(room.history.timeline(*span).stays, planned, now, watch_days=5.0)

    assert (word().state, word().text) == (State.WATCH, "no cover from 12-04 18:00 and no bank holds what follows")
    room.tell("A", "committed", NEW)
    assert word().text == "no cover from 12-04 18:00 unless bank A is activated"
    at = now + timedelta(days=2)
    plan = Planned("A", "activation", at, NEW, "zen-2", 2, now, now + timedelta(days=20), "")
    assert (word([plan]).state, word([plan]).text) == (State.OK, "cover until 2026-12-21")
    late = Planned("A", "activation", now + timedelta(days=4), NEW, "zen-2", 2, now, now + timedelta(days=20), "")
    assert word([late]).state is State.WATCH
