"""Conformance check of a device against the interface document. Each clause that can be tested from the ground is tested.

The device must be idle and must not have a bank on trial. Hazardous commands are not executed. The check overwrites the
image slots at the limits of the slot range. It restores settings, mode and cycle, and withdraws the a-priori attitude. The
attitude hint and the orbit cannot be read back and are not restored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from statistics import median

from gss.device.protocol.codec import decode
from gss.device.protocol.framing import MAX_PACKET_BYTES
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.sender import encode_frame, encode_packet
from gss.domain.callbacks import no_progress
from gss.domain.errors import Conflict, CorruptData
from gss.instruments.dictionary.definitions import Value
from gss.operations.checks.check_commands import (
    check_boundaries,
    check_conditions,
    check_old_ids,
    check_refusals,
    check_repeats,
)
from gss.operations.checks.check_contents import check_parts, check_results, check_sections, check_tables
from gss.operations.checks.check_findings import Findings, shown
from gss.operations.checks.check_schedule import check_power, check_schedule, check_training
from gss.operations.checks.check_telemetry import problems
from gss.operations.checks.check_transfers import (
    check_aborts,
    check_downloads,
    check_table_writing,
    check_upload_refusals,
    check_writing,
)
from gss.operations.checks.probe import QUIET_S, Probe

HOUSEKEEPING_PACKETS = 5
RATE_TOLERANCE_S = 0.1
REJECTED = b"\2"
"""First byte of a report with the stage *rejected*. Only such a report can have request id 0."""
SETTINGS = ("exposure_ms", "threshold_dn", "min_pixels", "max_pixels", "gain", "period_ms")
DETECTION = SETTINGS[1:4]

OnPart = Callable[[str], None]


def check_device(probe: Probe, *, write: bool, on_part: OnPart = no_progress) -> Findings:
    """Check all clauses and return the findings. ``write``: also upload into an inactive bank. ``on_part``: called with the
    name of each part of the check before it starts."""
    findings = Findings()
    on_part("identity")
    check_identity(probe, findings)
    if not probe.device.hello.dictionary_match:
        return findings
    oldest = probe.order("GET_STATUS").request_id
    before = _ready(probe)
    parts: dict[str, Callable[[], None]] = {
        "housekeeping": lambda: check_housekeeping(probe, findings),
        "damaged frames": lambda: check_damage(probe, findings),
        "refusals": lambda: check_refusals(probe, findings),
        "repeated ids": lambda: check_repeats(probe, findings),
        "ranges": lambda: check_boundaries(probe, findings, write=write),
        "settings": lambda: _restore_settings(probe, before),
        "old ids": lambda: check_old_ids(probe, findings, oldest),
        "conditions": lambda: check_conditions(probe, findings),
        "downloads": lambda: check_downloads(probe, findings),
        "parts of images": lambda: check_parts(probe, findings),
        "sections": lambda: check_sections(probe, findings),
        "tables": lambda: check_tables(probe, findings),
        "results and memories": lambda: check_results(probe, findings),
        "schedule": lambda: check_schedule(probe, findings),
        "training": lambda: check_training(probe, findings),
        "refused uploads": lambda: check_upload_refusals(probe, findings),
        "abort": lambda: check_aborts(probe, findings),
    }
    if write:
        parts["flash"] = lambda: check_writing(probe, findings)
        parts["tables in flash"] = lambda: check_table_writing(probe, findings)
        parts["power"] = lambda: check_power(probe, findings)
    try:
        for name, part in parts.items():
            on_part(name)
            with findings.trying("4.1", name):
                part()
    finally:
        on_part("restoring")
        _restore(probe, before, findings)
    check_record(probe, findings)
    return findings


def _ready(probe: Probe) -> Mapping[str, Value]:
    """Return the current housekeeping, then stop the cycle. Raises Conflict if a bank is on trial."""
    status = probe.status()
    if int(status["confirm_left_s"]):
        raise Conflict(
            f"bank {shown(status['active_bank'])} awaits CONFIRM_BANK",
            expected="no bank awaiting CONFIRM_BANK",
            hint="confirm it or roll it back first",
        )
    if status["cycle_running"]:
        probe.order("STOP_CYCLE")
    return status


def _restore_settings(probe: Probe, before: Mapping[str, Value]) -> None:
    """Restore exposure, detection, gain and period. The range tests leave extreme values, with which matching can take longer
    than the dictionary allows."""
    probe.order("SET_EXPOSURE", {"exposure_ms": before["exposure_ms"]})
    probe.order("SET_DETECTION", {name: before[name] for name in DETECTION})
    probe.order("SET_GAIN", {"gain": before["gain"]})
    probe.order("SET_FRAME_RATE", {"period_ms": before["period_ms"]})


def _restore(probe: Probe, before: Mapping[str, Value], findings: Findings) -> None:
    """Restore settings, mode and cycle. Settings that cannot be restored are listed in ``findings.not_restored``."""
    try:
        probe.order("ABORT")
        _restore_settings(probe, before)
        probe.order("SET_MODE", {"mode": before["mode"]})
        if before["cycle_running"]:
            probe.order("START_CYCLE")
        after = probe.status()
    except (Conflict, CorruptData) as error:
        findings.not_restored.append(f"settings: {error}")
        return
    for name in (*SETTINGS, "mode", "cycle_running", "active_bank"):
        if after[name] != before[name]:
            findings.not_restored.append(f"{name} is {shown(after[name])}, was {shown(before[name])}")


def check_identity(probe: Probe, findings: Findings) -> None:
    """Check clauses 3.1 to 3.3."""
    dictionary, hello = probe.dictionary, probe.device.hello
    status_id = probe.order("GET_STATUS").request_id
    with findings.trying("3.1", "HELLO"):
        code, other = dictionary.command("HELLO").code, dictionary.prefix ^ 0xFFFF
        answer = probe.raw(code, b"", command=dictionary.command("HELLO"), prefix=other)
        if not findings.check("3.1", "from another dictionary", answer.is_("completed"), answer.text):
            return
        values = answer.last.values if answer.last else {}
        findings.check(
            "3.1", "device_model", values["device_model"] == dictionary.device_model, str(values["device_model"])
        )
        for name in ("profile", "firmware", "serial"):
            findings.check("3.1", name, bool(values[name]), shown(values[name]))
        minima = {"columns": 1, "rows": 1, "bits": 1, "image_slots": 1, "bank_bytes": 1, "boot_count": 1}
        for name, minimum in (minima | {"window_chunks": 1, "max_chunk_bytes": 1}).items():
            findings.check("3.1", name, int(values[name]) >= minimum, shown(values[name]))
        reported, expected = hello.dictionary_hash, dictionary.hash_hex
        findings.check(
            "3.2", "dictionary_hash", reported == expected, f"device {reported[:12]}, ground {expected[:12]}"
        )
        findings.check(
            "3.3",
            "last_request_id",
            int(values["last_request_id"]) >= status_id,
            f"{shown(values['last_request_id'])}, used {status_id}",
        )


def check_housekeeping(probe: Probe, findings: Findings) -> None:
    """Check clauses 5.1, 5.2 and 5.4."""
    code = probe.dictionary.packet("housekeeping").code

    def is_periodic(packet: Packet) -> bool:
        return packet.type is PacketType.TELEMETRY and packet.code == code and not packet.request_id

    times_s = []
    for _ in range(HOUSEKEEPING_PACKETS):
        received = probe.wait(is_periodic, 5.0)
        times_s += [received[-1].time_s] if received and is_periodic(received[-1]) else []
    if findings.check("5.1", "periodic packets", len(times_s) == HOUSEKEEPING_PACKETS, f"{len(times_s)} received"):
        step_s = median(b - a for a, b in pairwise(times_s))
        findings.check("5.1", "interval", abs(step_s - 1.0) <= RATE_TOLERANCE_S, f"{step_s:.3f} s")
    with findings.trying("5.2", "GET_STATUS"):
        first = probe.status()
        findings.check("5.2", "GET_STATUS", True)
        probe.raw(_unused_code(probe), b"")
        second = probe.status()
        for name, change in (("commands_accepted", 1), ("commands_rejected", 1)):
            counted = (int(second[name]) - int(first[name])) & 0xFFFF
            findings.check("5.4", name, counted == change, f"{counted} more, expected {change}")


def _unused_code(probe: Probe) -> int:
    assigned_codes = {c.code for c in probe.dictionary.commands}
    return next(code for code in range(255, 0, -1) if code not in assigned_codes)


def _frame(probe: Probe, payload: bytes, request_id: int) -> bytes:
    """Return an encoded GET_STATUS packet with the given payload, without framing."""
    code = probe.dictionary.command("GET_STATUS").code
    return encode_packet(Packet(PacketType.COMMAND, code, request_id, payload, probe.dictionary.prefix, True))


def check_damage(probe: Probe, findings: Findings) -> None:
    """Check clauses 1.2, 1.3 and 1.5: invalid bytes are dropped and counted, and do not affect other packets."""
    request_id = probe.order("GET_STATUS").request_id
    good = _frame(probe, b"", request_id + 1000)
    with_bad_crc = good[:-1] + bytes([good[-1] ^ 0x10])
    too_long = _frame(probe, bytes(MAX_PACKET_BYTES + 200), request_id + 1000)
    for number, subject, data, damaged in (
        ("1.2", "empty frames", b"\0" * 8, False),
        ("1.5", "wrong CRC-32", encode_frame(with_bad_crc), True),
        ("1.3", "a packet too long", encode_frame(too_long), True),
        ("1.3", "a frame without end", encode_frame(b"\1" * 4 * MAX_PACKET_BYTES), True),
    ):
        with findings.trying(number, subject):
            before = int(probe.status()["frames_bad"])
            probe.write(data)
            received = probe.wait(lambda p: p.request_id == request_id + 1000, QUIET_S)
            answered = any(p.request_id == request_id + 1000 for p in received)
            findings.check(number, f"{subject}: no answer", not answered)
            counted = int(probe.status()["frames_bad"]) - before
            is_as_expected = counted >= 1 if damaged else counted == 0
            findings.check(
                number, f"{subject}: {'counted' if damaged else 'not counted'}", is_as_expected, f"{counted} more"
            )


def check_record(probe: Probe, findings: Findings) -> None:
    """Check clauses 2.1 to 2.4 and 5.3 on all packets that were received during the check."""
    receiver, packets, dictionary = probe.tap.receiver, probe.tap.packets, probe.dictionary
    findings.damaged = receiver.bad_total
    findings.check("2.1", "packets read", bool(packets) and not receiver.unknown, f"{receiver.unknown} unreadable")
    if receiver.bad_total:
        findings.skip("2.2", "sequence", f"{receiver.bad_total} packets were received damaged")
    else:
        sequence_errors = receiver.sequence.gaps + receiver.sequence.duplicates
        findings.check(
            "2.2",
            "sequence",
            sequence_errors == 0,
            f"{receiver.sequence.gaps} missing, {receiver.sequence.duplicates} twice",
        )
    foreign = sum(p.prefix != dictionary.prefix for p in packets)
    findings.check("2.3", "prefix", foreign == 0, f"{foreign} of {len(packets)} packets have a different prefix")
    reports = [p for p in packets if p.type is PacketType.REPORT]
    findings.check("2.4", "reports", bool(reports) and all(p.request_id or p.payload[:1] == REJECTED for p in reports))
    for row in dictionary.telemetry:
        matching = [p for p in packets if p.type is PacketType.TELEMETRY and p.code == row.code]
        if not matching:
            findings.skip("5.3", row.name, "no packet was received")
            continue
        records: set[str] = set()
        for packet in matching:
            try:
                records |= set(problems(row, decode(row.fields, packet.payload)))
            except CorruptData as error:
                records.add(str(error))
        findings.check("5.3", f"{row.name} ({len(matching)})", not records, "; ".join(sorted(records)))
    unknown = {p.code for p in packets if p.type is PacketType.TELEMETRY and dictionary.packet_of_code(p.code) is None}
    findings.check("5.3", "packets of the dictionary only", not unknown, f"codes {sorted(unknown)}" if unknown else "")
