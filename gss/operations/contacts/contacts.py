"""Contacts. A contact begins when the line is opened, ends when it is closed, and contains everything recorded in between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Generic, TypeVar

from gss.device.session_events import DirectionCounters, LinkCounters
from gss.domain.errors import NotFound
from gss.instruments.telemetry_roles import Quantities
from gss.operations.clock import Now
from gss.operations.contacts.gaps import (
    CLOCK_JUMPED,
    CLOCK_SET,
    GROUND_CLOCK,
    LINE_LOST,
    NOT_STORED,
    RESTARTED,
    Count,
    Gap,
    Happening,
    HousekeepingSample,
    RecordCheck,
    check_record,
    why_silent,
)
from gss.operations.contacts.read_limit import ReadLimit
from gss.operations.events import EventBus
from gss.operations.line.capture_files import PACKED, capture_files, capture_sizes, plain_name
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarm_text import AlarmView
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import STORED_AGAIN, TELEMETRY_STORE, UNSTORED
from gss.store import devices as store
from gss.store import telemetry as telemetry_store
from gss.store.engine import Database
from gss.store.models import Command, Contact, Device, Event, Frame, TelemetryPacket, Transfer

GROUND = "ground_line"
"""Packet name of the host's line counters, which are archived like telemetry."""
SILENT_AFTER_S = 3.0
STORE_EVERY_S = 10.0
MAX_LISTED = 500
"""Maximum number of frames, commands and transfers of a contact in one response. Separate pages list all of them."""
JUMPS_WITHIN = timedelta(days=2)
T = TypeVar("T")
BY_US = ("closed by the operator", "the port was changed")


@dataclass(frozen=True)
class CaptureFile:
    """A file of the raw capture. ``present``: False if the file was removed to free disk space."""

    file: str
    bytes: int
    present: bool


@dataclass(frozen=True)
class Listed(Generic[T]):
    """The latest rows, oldest first. ``total``: number of all rows."""

    rows: list[T]
    total: int


@dataclass(frozen=True)
class ContactDetail:
    """All data of a contact, with the latest frames, commands and transfers. ``counters``: receive counters, and packets and
    bytes sent. ``silences``: intervals without a good packet. ``frame_bytes``: total size of the downloaded images.
    ``events``: number of events."""

    row: Contact
    device: Device | None
    end: datetime
    counters: dict[str, int]
    silences: list[Gap]
    packets: dict[str, int]
    frames: Listed[Frame]
    commands: Listed[Command]
    transfers: Listed[Transfer]
    frame_bytes: int
    alarms: list[AlarmView]
    events: int
    captures: list[CaptureFile]

    @property
    def duration_s(self) -> float:
        """Seconds from opening to closing the line, or until now if it is open."""
        return (self.end - self.row.started).total_seconds()

    @property
    def error_rate(self) -> float:
        """Fraction of damaged packets."""
        bad = sum(self.counters.get(name, 0) for name in ("bad_crc", "too_long", "too_short"))
        good = self.counters.get("good", 0)
        return bad / (good + bad) if good + bad else 0.0


class ContactService:
    """Stores the line's counters over time and answers queries about contacts, including the open one.

    ``removed_before``: returns the time before which retention thins or removes packets, None if retention is off.
    """

    def __init__(
        self,
        link: LinkService,
        alarms: AlarmService,
        database: Database,
        bus: EventBus,
        captures: Path,
        now: Now,
        removed_before: Callable[[], datetime | None],
    ) -> None:
        self._link, self._alarms, self._database, self._bus = link, alarms, database, bus
        self.captures, self._now = captures, now
        self._stored_counters: tuple[int | None, float, dict[str, object]] = (None, 0.0, {})
        self._removed_before = removed_before
        self._limit = ReadLimit()

    @property
    def quantities(self) -> Quantities:
        """Standard quantities of the sensor."""
        return self._link.roles.quantities

    def handle(self, batch: LineBatch) -> None:
        """Store the line counters: immediately if an error counter or the silent flag changed, otherwise every
        ``STORE_EVERY_S``."""
        contact_id = self._link.contact_id
        counted = [event for event in batch.events if isinstance(event, LinkCounters)]
        if contact_id is None or not counted:
            return
        counters = self._link.contact.counters_of(counted[-1])
        now, now_s = batch.at, batch.at_s
        values: dict[str, object] = {
            **asdict(counters.received),
            "sent_good": counters.sent.good,
            "sent_bytes": counters.sent.bytes,
        }
        last_good_s = None if counters.last_good_s is None or not counters.received.good else counters.last_good_s
        quiet_s = 0.0 if last_good_s is None else max(0.0, now_s - last_good_s)
        values |= {"silent": last_good_s is None or quiet_s > SILENT_AFTER_S}
        values |= {"last_good": None if last_good_s is None else now.timestamp() - quiet_s}
        stored_contact, stored_s, stored = self._stored_counters
        steady = ("bad_crc", "too_long", "too_short", "unframed", "unknown", "gaps", "duplicates", "silent")
        changed = stored_contact != contact_id or any(values[name] != stored.get(name) for name in steady)
        if changed or now_s - stored_s >= STORE_EVERY_S or not self._link.connected:
            self._stored_counters = (contact_id, now_s, values)
            row = TelemetryPacket(
                contact_id=contact_id, packet=GROUND, received=now, device_time_s=0.0, request_id=0, values=values
            )
            with self._database.unit_of_work() as session:
                telemetry_store.add_batch(session, [row])

    # --- queries --------------------------------------------------------------------------------------------------

    def newest(self, limit: int, offset: int = 0) -> list[tuple[Contact, Device | None, int, int]]:
        """Return the latest contacts, each with its device and its numbers of frames and commands."""
        with self._database.unit_of_work() as session:
            return store.list_contacts(session, limit, offset)

    def had(self, url: str) -> bool:
        """True if the line was ever open at this address."""
        with self._database.unit_of_work() as session:
            return store.had_contact(session, url)

    def total(self) -> int:
        """Return the number of contacts in the store."""
        with self._database.unit_of_work() as session:
            return store.count_contacts(session)

    def note(self, contact_id: int, note: str, *, user: str) -> ContactDetail:
        """Store an operator's note on a contact and return the contact's detail."""
        with self._database.unit_of_work() as session:
            store.get_contact(session, contact_id)
            store.update_contact(session, contact_id, note=note)
        self._bus.record("contact", "ok", f"{user} noted on contact {contact_id}: {note}", contact_id=contact_id)
        return self.detail(contact_id)

    def detail(self, contact_id: int) -> ContactDetail:
        """Return all data of a contact. Raises NotFound if the contact does not exist, and Busy."""
        with self._limit.reading():
            return self._detail(contact_id)

    def _detail(self, contact_id: int) -> ContactDetail:
        with self._database.unit_of_work() as session:
            row, device = store.get_contact(session, contact_id)
            end = row.ended or self._now()
            frames = Listed(*store.recorded(session, Frame, contact_id, MAX_LISTED))
            commands = Listed(*store.recorded(session, Command, contact_id, MAX_LISTED))
            transfers = Listed(*store.recorded(session, Transfer, contact_id, MAX_LISTED))
            frame_bytes = store.downloaded_bytes(session, contact_id, ("frame", "thumbnail"))
            events = store.count_events(session, row.started, end)
            packets = telemetry_store.counts(session, contact_id)
        counts = self.counts(contact_id)
        last = counts[-1].values if counts else {}
        return ContactDetail(
            row,
            device,
            end,
            {name: int(last.get(name, 0)) for name in (*asdict(DirectionCounters()), "sent_good", "sent_bytes")},
            self._silences(row, end, counts),
            {name: number for name, number in packets.items() if name != GROUND},
            frames,
            commands,
            transfers,
            frame_bytes,
            self._alarms.between(row.started, end),
            events,
            self._files(row),
        )

    def file(self, contact_id: int, name: str) -> Path:
        """Return the path of a capture file of a contact. Raises NotFound if the file does not exist or was removed."""
        for path in capture_files(self.captures, contact_id):
            if plain_name(path) == name:
                return path
        raise NotFound("no such file of this contact's capture", got=name, hint="retention removes the oldest files")

    def _files(self, row: Contact) -> list[CaptureFile]:
        sized = capture_sizes(self.captures, row.id)
        sizes_on_disk = {plain_name(path): size for path, size in sized}
        unpacked = {path.name: size for path, size in sized if path.suffix != PACKED}  # these files can still grow
        expected_sizes = {str(f["file"]): int(f["bytes"]) for f in row.captures} or sizes_on_disk
        return [
            CaptureFile(name, unpacked.get(name, size), name in sizes_on_disk) for name, size in expected_sizes.items()
        ]

    # --- completeness of the record -------------------------------------------------------------------------------

    def counts(self, contact_id: int) -> list[Count]:
        """Return the stored line counters of a contact, in order of time."""
        with self._database.unit_of_work() as session:
            row, _ = store.get_contact(session, contact_id)
        names = (*asdict(DirectionCounters()), "sent_good", "sent_bytes", "silent", "last_good")
        rows = telemetry_store.rows(
            self._database, GROUND, names, row.started, row.ended or self._now(), contact_id=contact_id
        )
        counts = []
        for r in rows:
            values = {n: float(v) for n, v in zip(names, r.values, strict=True) if v is not None}
            counts.append(Count(r.received.timestamp(), values, contact_id))
        return counts

    def _silences(self, row: Contact, end: datetime, counts: Sequence[Count]) -> list[Gap]:
        """Return intervals longer than ``SILENT_AFTER_S`` without a good packet. Their end times are accurate to one second."""
        spans: list[tuple[float, float]] = []
        since_s: float | None = None
        for count in counts:
            if count.values.get("silent") and since_s is None:
                since_s = count.values.get("last_good", row.started.timestamp())
            elif not count.values.get("silent") and since_s is not None:
                spans.append((since_s, count.at_s))
                since_s = None
        if since_s is not None:
            spans.append((since_s, end.timestamp()))
        happenings = self._happenings(row, end)
        silences = [
            Gap(a, b, 0, why_silent(a, b, counts, happenings, row.id)) for a, b in spans if b - a > SILENT_AFTER_S
        ]
        if all(gap.explained for gap in silences):
            return silences
        late = self._record(row.id).late  # intervals in which packets arrived late
        return [gap if gap.explained else _if_late(gap, late) for gap in silences]

    def _happenings(self, row: Contact, end: datetime) -> list[Happening]:
        """Return the events that can explain gaps: restarts of the device, changes of its clock, telemetry that could not be
        stored, and a lost line."""
        with self._database.unit_of_work() as session:
            events = store.events_between(session, row.started, end, ("device", "link", TELEMETRY_STORE))
        roles = self._link.roles.events
        names = {roles.boot: RESTARTED, roles.time_set: CLOCK_SET, roles.clock_jump: CLOCK_JUMPED}
        happenings = []
        for event in events:
            name, _, text = event.text.partition(": ")
            if event.kind == "device" and name in names:
                happenings.append(Happening(event.at.timestamp(), names[name], text))
            elif event.kind == TELEMETRY_STORE and event.text.startswith((UNSTORED, STORED_AGAIN)):
                happenings.append(Happening(event.at.timestamp(), NOT_STORED, event.text))
        with self._database.unit_of_work() as session:
            closings = store.closings(session, row.id)
        for at, cause in closings:
            if cause not in BY_US:  # the last closing is recorded shortly after the end of the contact
                happenings.append(Happening(min(at, end).timestamp(), LINE_LOST, cause))
        return happenings

    def record(self, contact_id: int) -> RecordCheck:
        """Check the completeness of a contact's housekeeping record. Raises NotFound, Busy."""
        with self._limit.reading():
            return self._record(contact_id)

    def _record(self, contact_id: int) -> RecordCheck:
        with self._database.unit_of_work() as session:
            row, _ = store.get_contact(session, contact_id)
        end = row.ended or self._now()
        jumps = self._clock_jumps(row.started, end)
        # If the ground's clock was set, the times of some packets are outside the contact, but their order of arrival is
        # still valid.
        margin = timedelta(seconds=sum(abs(jump.data["jump_s"]) for jump in jumps))
        first, last = min(row.started, end) - margin, max(row.started, end) + margin
        status = self._link.roles.quantities.status
        rows = telemetry_store.rows(
            self._database, status.packet, [status.uptime_s], first, last, contact_id=contact_id, unsolicited=True
        )
        rows_in_order = sorted(rows, key=lambda r: r.id)
        samples = [
            HousekeepingSample(at := r.received.timestamp(), r.device_time_s or at, _number(r.values[0]), contact_id)
            for r in rows_in_order
        ]
        ground_jumps = [Happening(jump.at.timestamp(), GROUND_CLOCK, jump.text) for jump in jumps]
        check = check_record(
            samples,
            self.counts(contact_id),
            [*self._happenings(row, end), *ground_jumps],
            start_s=None if jumps else row.started.timestamp(),
            end_s=None if jumps else end.timestamp(),
        )
        return self._without_removed(check)

    def _clock_jumps(self, start: datetime, end: datetime) -> list[Event]:
        """Return jumps of the ground's clock near a contact. The search includes ``JUMPS_WITHIN`` before and after the
        contact: if the clock is set by days, the recorded time of the jump is days away from the contact."""
        with self._database.unit_of_work() as session:
            return store.clock_jumps(session, min(start, end) - JUMPS_WITHIN, max(start, end) + JUMPS_WITHIN)

    def _without_removed(self, check: RecordCheck) -> RecordCheck:
        """Return the check after setting the cause of unexplained gaps to retention where retention has thinned the
        packets."""
        removed = self._removed_before()
        if removed is None:
            return check
        cause = f"removed by retention, which thins data older than {removed:%Y-%m-%d %H:%M} UTC"
        gaps = [
            replace(g, cause=cause) if g.from_s < removed.timestamp() and not g.explained else g for g in check.gaps
        ]
        return replace(check, gaps=tuple(gaps))


def _if_late(silence: Gap, late: Sequence[Gap]) -> Gap:
    overlap = next((gap for gap in late if gap.from_s < silence.to_s and silence.from_s < gap.to_s), None)
    return silence if overlap is None else replace(silence, cause=overlap.cause)


def _number(value: Any) -> float | None:
    return None if value is None else float(value)
