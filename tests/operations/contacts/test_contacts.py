"""Contacts from opening to closing: counters, gaps with their causes, notes and capture files."""

from __future__ import annotations

import numpy as np
import pytest
from sqlalchemy import insert

from gss.device.simulator.faults import FaultRates, LineFaults
from gss.domain.errors import Busy, NotFound
from gss.instruments.registry import shipped_registry, shipped_version
from gss.operations.contacts.contact_report import _attitude, contact_report
from gss.operations.contacts.contacts import MAX_LISTED
from gss.operations.contacts.read_limit import ReadLimit
from gss.operations.line.capture_files import capture_files
from gss.operations.line.link import JOIN_WITHIN_S
from gss.operations.line.raw_capture import Retention, read_captures
from gss.store.models import Command, TelemetryPacket


def test_a_contact_has_times_counters_packets_and_captures(station):
    """A contact has its times, counters, packets and captures. The counters of the next contact start at zero."""
    first = station.open()
    station.command("GET_STATUS")
    station.listen(12)
    station.close()
    detail = station.contacts.detail(first)
    assert detail.row.ended is not None
    assert 12 <= detail.duration_s < 20
    assert [c.name for c in detail.commands.rows] == ["GET_STATUS"]
    assert detail.packets["housekeeping"] >= 12
    assert "ground_line" not in detail.packets
    assert (detail.counters["bad_crc"], detail.counters["gaps"], detail.error_rate) == (0, 0, 0.0)
    assert detail.counters["bytes"] == detail.row.rx_bytes > 1000
    assert detail.counters["sent_good"] >= 2
    assert (detail.row.instrument, detail.row.instrument_version) == ("cubestar", shipped_version("cubestar"))
    assert detail.silences == []
    (file,) = detail.captures
    assert file.present
    assert file.bytes == station.contacts.file(first, file.file).stat().st_size
    second = station.open()
    station.listen(3)
    station.close()
    second_detail = station.contacts.detail(second)
    assert second_detail.row.rx_bytes < detail.row.rx_bytes
    assert [c.id for c, *_ in station.contacts.newest(10)] == [second, first]
    assert [c.id for c, *_ in station.contacts.newest(10, 1)] == [first]
    assert station.contacts.total() == 2


def test_a_note_is_stored_with_its_author(station):
    """A note is stored and recorded with its author. A note on an unknown contact is rejected."""
    contact_id = station.open()
    assert station.contacts.note(contact_id, "first light", user="ann").row.note == "first light"
    assert any(e.text == f"ann noted on contact {contact_id}: first light" for e in station.bus.after(0, 1000))
    with pytest.raises(NotFound, match="no such contact"):
        station.contacts.note(999, "x", user="ann")
    with pytest.raises(NotFound, match="no such file"):
        station.contacts.file(contact_id, "contact-000009-000.raw")


def test_a_silence_is_a_span_with_a_cause(station):
    """Six seconds without data are one silence. Because of the sequence counts its cause is the line."""
    contact_id = station.open()
    station.listen(5)
    station.spoil = lambda data: b""
    station.listen(6)
    station.spoil = lambda data: data
    station.listen(4)
    station.close()
    (silence,) = station.contacts.detail(contact_id).silences
    assert 5 <= silence.to_s - silence.from_s <= 9
    assert silence.cause.startswith("lost on the line")
    record = station.contacts.record(contact_id)
    (gap,) = record.gaps
    assert (gap.missing, gap.explained, record.unexplained) == (6, True, ())


def test_packets_received_on_a_full_disk_are_missing_because_of_the_disk(station):
    """The cause of packets that were not stored on a full disk is the server, not the line."""
    contact_id = station.open()
    station.listen(5)
    station.room = False
    station.listen(6)
    station.room = True
    station.listen(4)
    station.close()
    (gap,) = station.contacts.record(contact_id).gaps
    assert gap.missing == 6
    assert gap.cause.startswith("not stored by the server: telemetry is not stored, only captured: the disk is full")


def test_a_line_that_paused_and_then_delivered_everything_has_lost_nothing(station):
    """If data arrive seven seconds late, there is a silence with its cause and no gap."""
    contact_id = station.open()
    station.listen(4)
    delayed: list[bytes] = []
    station.spoil = lambda data: (delayed.append(data), b"")[1]
    station.listen(7)

    def release(data: bytes) -> bytes:
        station.spoil = lambda data: data
        return b"".join(delayed) + data

    station.spoil = release
    station.listen(4)
    station.close()
    record = station.contacts.record(contact_id)
    assert (record.gaps, len(record.late)) == ((), 1)
    (silence,) = station.contacts.detail(contact_id).silences
    assert silence.cause.startswith("received late")


def test_every_gap_of_a_noisy_line_is_explained(station):
    """After a minute with bit errors, packets are missing, each gap has the line as its cause, and the number of expected
    packets is correct."""
    contact_id = station.open()
    faults = LineFaults(FaultRates(bit_error_rate=2e-4), 1)
    station.spoil = faults.apply
    station.listen(60)
    station.spoil = lambda data: data
    station.listen(3)
    station.close()
    record = station.contacts.record(contact_id)
    assert len(record.gaps) >= 3
    assert record.unexplained == ()
    assert record.held < record.expected
    assert abs(record.expected - 63) <= 3
    assert all("the line" in gap.cause for gap in record.gaps)


def test_a_restart_of_the_device_leaves_nothing_unexplained(station):
    """A reset restarts clock and sequence counts. It is the cause of all gaps, and none is unexplained."""
    contact_id = station.open()
    station.listen(5)
    station.commands.send("RESET", {}, confirm="RESET", user="ann", source="form")
    station.listen(12)
    station.close()
    record = station.contacts.record(contact_id)
    assert record.unexplained == ()
    assert all(gap.cause.startswith("the device restarted") for gap in record.gaps)
    assert any(e.text.startswith("BOOT") for e in station.bus.after(0, 1000))


def test_a_device_that_stops_sending_leaves_an_unexplained_gap(station):
    """If the device sends no housekeeping and nothing was lost on the line, the gap has no known cause."""
    contact_id = station.open()
    station.listen(4)
    device, advance = station.sensor.device, station.sensor.device._send_housekeeping
    device._send_housekeeping = lambda request_id: None
    station.listen(5)
    device._send_housekeeping = advance
    station.listen(4)
    station.close()
    (gap,) = station.contacts.record(contact_id).unexplained
    assert gap.missing == 5


def test_closing_the_line_does_not_explain_an_earlier_silence(station):
    """If the device stopped sending before the operator closed the line, the gap remains unexplained."""
    contact_id = station.open()
    station.listen(4)
    station.sensor.device._send_housekeeping = lambda request_id: None
    station.listen(6)
    station.close()
    (gap,) = station.contacts.record(contact_id).unexplained
    assert gap.missing >= 5


def test_a_lost_line_ends_the_contact_and_is_the_cause(station):
    """A disconnected cable ends the contact, and no gap is unexplained."""
    first = station.open()
    station.listen(3)
    station.sensor.cut = True
    station.wait(lambda: station.link.contact_id is None)
    assert station.contacts.record(first).unexplained == ()
    assert station.contacts.detail(first).row.ended is not None


def test_a_line_lost_for_seconds_continues_the_same_contact(station):
    """If the line is open again within seconds, the contact continues: one row, counters from its start, a further capture
    file, and the missing packets are explained by the lost line."""
    first = station.open()
    station.listen(5)
    station.sensor.cut = True
    station.wait(lambda: station.link.contact_id is None)
    bytes_before = station.contacts.detail(first).row.rx_bytes
    station.spoil = lambda data: b""
    station.sensor.cut = False
    station.listen(4)
    station.spoil = lambda data: data
    station.wait(lambda: station.link.hello is not None)
    assert station.link.contact_id == first
    assert station.contacts.detail(first).row.ended is None
    station.listen(6)
    station.close()
    detail, record = station.contacts.detail(first), station.contacts.record(first)
    assert station.contacts.total() == 1
    assert detail.row.ended is not None
    assert detail.row.rx_bytes > bytes_before
    assert len(detail.captures) == 2
    assert all(file.present for file in detail.captures)
    (gap,) = record.gaps
    assert gap.missing >= 3
    assert gap.cause.startswith("the line was lost (the cable is disconnected")
    assert any(f"contact {first} continues" in event.text for event in station.bus.after(0, 1000))


def test_a_line_lost_for_longer_begins_a_new_contact(station):
    """If the line is open again after more than ten seconds, a new contact begins."""
    first = station.open()
    station.listen(3)
    station.sensor.cut = True
    station.wait(lambda: station.link.contact_id is None)
    station.sensor.now_s += JOIN_WITHIN_S
    station.sensor.cut = False
    station.wait(lambda: station.link.contact_id is not None)
    assert station.link.contact_id == first + 1


def test_a_third_concurrent_read_of_a_contact_waits():
    """Two requests can read at the same time. A third gets Busy after its wait, and can read when one of them has ended."""
    limit = ReadLimit(2, wait_s=0.05)
    with limit.reading():
        with limit.reading(), pytest.raises(Busy, match="Too many requests read contacts"), limit.reading():
            pytest.fail("a third reader")
        with limit.reading():
            pass


def test_capture_rotates_without_losing_a_byte(make_station):
    """Several small capture files contain every byte of both directions in order, and all are listed."""
    station = make_station(Retention(file_bytes=1500, keep_bytes=1 << 30))
    received: list[bytes] = []
    station.spoil = lambda data: (received.append(data), data)[1]
    contact_id = station.open()
    station.listen(20)
    station.close()
    files = capture_files(station.folder, contact_id)
    assert len(files) >= 3
    records = list(read_captures(files))
    assert b"".join(d for _, way, d in records if way == 0) == b"".join(received)
    assert b"".join(d for _, way, d in records if way == 1) == b"".join(station.sensor.written)
    assert [at for at, _, _ in records] == sorted(at for at, _, _ in records)
    assert [c.file for c in station.contacts.detail(contact_id).captures] == [p.name for p in files]


def test_deleted_captures_are_listed_as_deleted(make_station):
    """Capture files that retention deleted are listed and marked as missing."""
    station = make_station(Retention(file_bytes=1000, keep_bytes=3000))
    contact_id = station.open()
    station.listen(20)
    station.close()
    captures = station.contacts.detail(contact_id).captures
    assert not captures[0].present
    assert captures[-1].present
    assert sum(c.bytes for c in captures if c.present) <= 3000 + 2 * 1600


def test_the_report_counts_iterations_and_plots_their_series(station):
    """The report of a contact counts every iteration and has the quality and series of the contact."""
    contact_id = station.open()
    station.command("START_CYCLE")
    station.listen(15)
    station.command("STOP_CYCLE")
    station.close()
    report = contact_report(station.contacts, station.telemetry.archive, station.database, contact_id)
    rows = station.telemetry.archive.packets("attitude", None, None, 1000, None, contact_id)
    assert report.attitude.iterations == len(rows) >= 10
    assert report.attitude.solved == sum(r.values["outcome"] == "solved" for r in rows)
    assert report.telemetry_packets == sum(report.detail.packets.values())
    assert {s.key for s in report.series} >= {"housekeeping.stars_matched", "attitude.sigma_cross_arcsec"}
    assert all(share == 0 for _, share in report.quality)


@pytest.mark.parametrize("name", ["nos3", "sagitta", "oresat"])
def test_the_report_summarises_the_attitude_of_a_foreign_sensor(station, name):
    """The sensor's own field names are mapped to standard quantities; the pointing comes from the quaternion if the sensor
    reports no angles."""
    contact_id = station.open()
    station.listen(2)
    station.close()
    detail = station.contacts.detail(contact_id)
    role = shipped_registry().get(name).roles.quantities.attitude
    values = dict.fromkeys(role.fields().values(), 0.5) | {role.ra_deg: 90.0, role.dec_deg: 0.0, role.roll_deg: 0.0}
    with station.database.unit_of_work() as session:
        for outcome in ("solved", "none"):
            packet = {**values, role.outcome: outcome}
            session.add(
                TelemetryPacket(
                    packet=role.packet,
                    received=detail.row.started,
                    device_time_s=1.0,
                    request_id=0,
                    values=packet,
                    contact_id=contact_id,
                )
            )
    summary = _attitude(station.database, detail, role)
    assert (summary.iterations, summary.solved) == (2, 1)
    assert summary.first == summary.last
    assert summary.first is not None
    assert np.isfinite(summary.first).all()


def test_a_contact_with_many_commands_lists_the_newest(station):
    """Only the newest commands are listed, and the total is that of the complete contact."""
    contact_id = station.open()
    station.listen(2)
    row = {
        "contact_id": contact_id,
        "name": "GET_STATUS",
        "arguments": {},
        "user": "ann",
        "source": "api",
        "result": "done",
    }
    with station.database.unit_of_work() as session:
        rows = [row | {"request_id": n, "created": station.now()} for n in range(1, 3 * MAX_LISTED)]
        session.execute(insert(Command), rows)
    station.close()
    commands = station.contacts.detail(contact_id).commands
    assert (len(commands.rows), commands.total) == (MAX_LISTED, 3 * MAX_LISTED - 1)
    assert [c.request_id for c in commands.rows] == list(range(2 * MAX_LISTED, 3 * MAX_LISTED))
