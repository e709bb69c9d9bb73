"""A replay of a capture through the decoder gives the data of the live link at any speed and changes no stored data."""

from __future__ import annotations

import json
import time

import pytest

from gss.device.session_events import DeviceEvent, Telemetry
from gss.device.simulator.faults import FaultRates, LineFaults
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.instruments.roles import default_roles
from gss.operations.clock import monotonic_s
from gss.operations.contacts.capture_decoder import CaptureDecoder, CommandSaid, decoded
from gss.operations.contacts.replay_capture import CaptureReplay, paced
from gss.operations.line.capture_files import capture_files
from gss.operations.line.raw_capture import RECEIVED, RECORD, Retention, capture_span, read_captures
from gss.operations.telemetry.telemetry import stored_values
from gss.store.devices import events_between


@pytest.fixture
def contact(make_station):
    """(station, contact id) of a closed contact with commands, a running cycle, damage, and several capture files."""
    station = make_station(Retention(file_bytes=5000))
    contact_id = station.open()
    station.command("SET_EXPOSURE", exposure_ms=200)
    station.command("START_CYCLE")
    station.listen(8)
    station.spoil = LineFaults(FaultRates(bit_error_rate=1e-4), 3).apply
    station.listen(10)
    station.spoil = lambda data: data
    station.command("STOP_CYCLE")
    station.listen(2)
    station.close()
    return station, contact_id


def items_of(station, contact_id) -> tuple[list, CaptureDecoder]:
    """Return every item decoded from the capture, and the decoder."""
    decoder = CaptureDecoder(station.dictionary)
    return list(decoded(read_captures(capture_files(station.folder, contact_id)), decoder)), decoder


def test_replayed_packets_equal_the_stored_ones(contact):
    """The replay has the names, device times, request ids, values and lists of all stored packets in order, and the same
    events, commands and counts of damaged data."""
    station, contact_id = contact
    items, decoder = items_of(station, contact_id)
    packets = [r.item for r in items if isinstance(r.item, Telemetry)]
    rows = [
        r
        for r in reversed(station.telemetry.archive.packets(None, None, None, 100_000, None, contact_id))
        if r.packet != "ground_line"
    ]
    assert len(packets) == len(rows) > 40
    assert {p.packet for p in packets} >= {"housekeeping", "attitude", "centroids", "matches", "timing"}
    for packet, row in zip(packets, rows, strict=True):
        assert (packet.packet, packet.device_time_s, packet.request_id) == (
            row.packet,
            row.device_time_s,
            row.request_id,
        )
        assert json.loads(json.dumps(stored_values(packet))) == row.values
    detail = station.contacts.detail(contact_id)
    sent = [
        r.item for r in items if isinstance(r.item, CommandSaid) and r.item.stage == "sent" and r.item.name != "HELLO"
    ]
    assert [s.name for s in sent] == [c.name for c in detail.commands.rows]
    assert sent[0].values["exposure_ms"] == 200
    events = [r.item.name for r in items if isinstance(r.item, DeviceEvent)]
    with station.database.unit_of_work() as session:
        recorded = events_between(session, detail.row.started, detail.end, ("device",))
    assert events == [e.text.partition(":")[0] for e in recorded]
    assert {"CYCLE_STARTED", "CYCLE_STOPPED"} <= set(events)
    assert decoder.damaged == sum(detail.counters[n] for n in ("bad_crc", "too_long", "too_short")) > 0
    assert decoder.received.gaps == detail.counters["gaps"]
    assert decoder.foreign == 0


def test_truncated_and_invalid_ends_of_files_are_skipped(contact):
    """A truncated record, a record with an impossible length and an empty file are skipped, and all others are read."""
    station, contact_id = contact
    files = capture_files(station.folder, contact_id)
    assert len(files) >= 3
    all_records = list(read_captures(files))
    file_bytes = files[0].read_bytes()
    files[0].write_bytes(file_bytes[:-1])
    files[-1].write_bytes(files[-1].read_bytes() + RECORD.pack(1e9, RECEIVED, 0xFFFFFFFF) + b"x" * 50)
    assert len(list(read_captures(files))) == len(all_records) - 1
    assert capture_span(files) == (all_records[0][0], all_records[-1][0])
    files[1].write_bytes(b"")
    items, _ = items_of(station, contact_id)
    assert any(isinstance(r.item, Telemetry) for r in items)


class SleepingClock:
    """Clock that ``sleep`` advances."""

    def __init__(self) -> None:
        self.now_s, self.slept = 0.0, 0.0

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        self.slept += seconds


def test_a_replay_takes_the_contacts_duration_divided_by_its_speed(contact):
    """A replay takes the time from the first to the last item, divided by its speed, or no time without a speed."""
    station, contact_id = contact
    items, _ = items_of(station, contact_id)
    for speed in (0.1, 1.0, 7.0, 1000.0):
        clock = SleepingClock()
        assert list(paced(iter(items), speed, clock, clock.sleep)) == items
        assert clock.slept == pytest.approx((items[-1].at_s - items[0].at_s) / speed, rel=1e-6)
    clock = SleepingClock()
    assert list(paced(iter(items), None, clock, clock.sleep)) == items
    assert clock.slept == 0


@pytest.fixture
def view(contact):
    """Station, contact id and replay."""
    station, contact_id = contact
    replay = CaptureReplay(
        station.dictionary,
        station.folder,
        station.telemetry.limits,
        station.bus,
        monotonic_s,
        default_roles(station.dictionary).quantities.status,
    )
    yield station, contact_id, replay
    replay.stop()


def wait_for_end(replay) -> None:
    """Wait until the replay has ended."""
    limit_s = time.monotonic() + 30
    while replay.state.state in ("running", "paused"):
        assert time.monotonic() < limit_s
        time.sleep(0.005)


def test_the_replay_publishes_on_separate_topics_and_stores_nothing(view):
    """A replay publishes only on the topics of replays and stores no rows. Its final status board equals the live one."""
    station, contact_id, replay = view
    live = {(v.packet, v.name): v.value for v in station.telemetry.values()}
    before = len(station.telemetry.archive.packets(None, None, None, 100_000, None)), len(station.bus.after(0, 10_000))
    listener = station.bus.subscribe(lambda: None)
    replay.start(contact_id, None)
    wait_for_end(replay)
    messages, _ = listener.take()
    assert {m.topic for m in messages} == {"replay", "replay.telemetry", "replay.command", "replay.event"}
    assert all(m.seq is None for m in messages)
    after = len(station.telemetry.archive.packets(None, None, None, 100_000, None)), len(station.bus.after(0, 10_000))
    assert after == before
    state = replay.state
    assert (state.state, state.at_s) == ("ended", state.end_s)
    shown = {(v.packet, v.name): v.value for v in replay.board.values(station.now())}
    assert shown == live


def test_a_replay_cannot_be_changed_after_its_end_was_published(view):
    """A change directly after the end is rejected, although the thread of the replay still runs, and the state stays."""
    station, contact_id, replay = view
    rejected = []

    def change() -> None:
        if replay.state.state == "ended" and not rejected:
            try:
                replay.change(paused=True)
                rejected.append(False)
            except Conflict:
                rejected.append(True)

    station.bus.subscribe(change)
    replay.start(contact_id, None)
    wait_for_end(replay)
    replay.stop()
    assert rejected == [True]
    assert (replay.state.state, replay.state.reason) == ("ended", "end of the capture")


def test_a_replay_is_paused_moved_and_stopped(view):
    """A paused replay stays at its position, seeking works in both directions, and a stopped one ends. An invalid request
    is rejected with the reason."""
    station, contact_id, replay = view
    first_s, last_s = capture_span(capture_files(station.folder, contact_id))
    replay.start(contact_id, 0.1)
    replay.change(paused=True)
    position_s, limit_s = -1.0, time.monotonic() + 30
    while replay.state.at_s != position_s:  # a step in progress may still complete
        assert time.monotonic() < limit_s
        position_s = replay.state.at_s
        time.sleep(0.3)
    middle_s = (first_s + last_s) / 2
    for target_s in (middle_s, first_s + 1, last_s - 1):
        replay.change(paused=False, at_s=target_s)
        limit_s = time.monotonic() + 10
        while abs((replay.state.at_s or 0) - target_s) > 4:  # the targets are at least 9 s apart
            assert time.monotonic() < limit_s, replay.state
            time.sleep(0.005)
    replay.change(as_fast_as_possible=True)
    wait_for_end(replay)
    assert replay.state.speed is None
    with pytest.raises(Conflict, match="no replay is running"):
        replay.change(paused=True)
    replay.start(contact_id, 0.1, from_s=middle_s)
    assert replay.stop().reason == "stopped"
    with pytest.raises(NotFound, match="no capture"):
        replay.start(999, None)
    for speed in (0.05, 1001.0):
        with pytest.raises(BadInput, match="speed"):
            replay.start(contact_id, speed)
