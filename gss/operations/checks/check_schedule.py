"""Conformance checks of the schedule, of power switching and of training commands. The checks leave no entry in the
schedule."""

from __future__ import annotations

from gss.device.protocol.codec import decode
from gss.device.protocol.packet import Packet, PacketType
from gss.instruments.dictionary.definitions import Value
from gss.operations.checks.check_findings import Findings
from gss.operations.checks.probe import CommandOutcome, Probe

SOON_S, FAR_S = 2.0, 1.0e6
HEADER_STEP_S = 1e-3
"""Resolution of the device time in a packet's header."""
IMAGE_COMMANDS = ("TAKE_IMAGE", "RUN_ITERATION")


def device_time_s(probe: Probe) -> float:
    """Return the device time of the latest packet, in seconds."""
    answer = probe.order("GET_STATUS")
    return answer.packets[-1].time_s if answer.packets else 0.0


def is_due(late_s: float) -> bool:
    """True if a packet was not sent before its scheduled time. ``late_s``: time of the packet minus scheduled time. An
    early packet within the resolution of the header's time is accepted."""
    return late_s > -HEADER_STEP_S


def schedule(probe: Probe, at_s: float, code: int, payload: bytes = b"") -> CommandOutcome:
    """Send SCHEDULE for a command with this code and payload, without checking them."""
    values: dict[str, Value] = {"at_s": at_s, "command_code": code, "length": len(payload)}
    return probe.order("SCHEDULE", values | {"payload": payload.ljust(64, b"\0")})


def check_schedule(probe: Probe, findings: Findings) -> None:
    """Check clauses 4.15, 4.16 and 4.19."""
    dictionary = probe.dictionary
    status = dictionary.command("GET_STATUS").code
    event = dictionary.event_named("SCHEDULE_RUN").code
    now_s = device_time_s(probe)
    scheduled = schedule(probe, now_s + SOON_S, status)
    findings.check("4.15", "SCHEDULE of GET_STATUS", scheduled.is_("completed"), scheduled.text)

    def ran(packet: Packet) -> bool:
        return packet.type is PacketType.EVENT and packet.code == event and packet.request_id == scheduled.request_id

    received = probe.wait(ran, SOON_S + 3.0)
    if findings.check("4.15", "it runs and is reported", bool(received) and ran(received[-1])):
        late_s = received[-1].time_s - (now_s + SOON_S)
        findings.check("4.15", "not before its time", is_due(late_s), f"{late_s:.3f} s after it")
        housekeeping = dictionary.packet("housekeeping").code
        caused = [p for p in received if p.type is PacketType.TELEMETRY and p.request_id == scheduled.request_id]
        findings.check("4.15", "its packets have the id of SCHEDULE", any(p.code == housekeeping for p in caused))
    for subject, code, payload, reason in (
        (
            "a code that no command has",
            next(c for c in range(255, 0, -1) if dictionary.command_of_code(c) is None),
            b"",
            "unknown_command",
        ),
        ("arguments of the wrong length", status, b"\0", "bad_length"),
        ("an argument outside its range", dictionary.command("SET_EXPOSURE").code, b"\0\0", "out_of_range"),
    ):
        refused = schedule(probe, now_s + FAR_S, code, payload)
        findings.check("4.16", subject, refused.is_("failed", reason), refused.text)
    past = schedule(probe, 0.0, status)
    findings.check("4.16", "a time in the past", past.is_("failed", "out_of_range"), past.text)
    far = schedule(probe, now_s + FAR_S, status)
    number = far.last.values.get("schedule_id", 0) if far.last else 0
    cancelled = probe.order("CANCEL", {"schedule_id": number})
    findings.check("4.19", "CANCEL of one", cancelled.is_("completed"), cancelled.text)
    row = dictionary.packet("schedule_entry")
    reported = [decode(row.fields, p.payload).values for p in cancelled.packets if p.code == row.code]
    findings.check("4.19", "the entry is cancelled", any(t.get("state") == "cancelled" for t in reported))
    again = probe.order("CANCEL", {"schedule_id": number})
    findings.check("4.19", "CANCEL of it again", again.is_("failed", "not_found"), again.text)


def check_training(probe: Probe, findings: Findings) -> None:
    """Check clause 4.20: a real unit rejects training commands."""
    for command in probe.dictionary.commands:
        if not command.simulator_only:
            continue
        if probe.device.hello.simulated:
            findings.skip("4.20", command.name, "this is a simulator")
            continue
        answer = probe.order(command.name)
        findings.check("4.20", command.name, answer.is_("rejected", "unknown_command"), answer.text)


def check_power(probe: Probe, findings: Findings) -> None:
    """Check clause 4.14 by switching the imager off and on again."""
    off = probe.order("POWER", {"rail": "imager", "state": "off"})
    try:
        findings.check("4.14", "POWER imager off", off.is_("completed"), off.text)
        findings.check("4.14", "housekeeping confirms it", probe.status()["imager_on"] is False)
        for name in IMAGE_COMMANDS:
            answer = probe.order(name)
            findings.check("4.14", name, answer.is_("rejected", "powered_off"), answer.text)
    finally:
        on = probe.order("POWER", {"rail": "imager", "state": "on"})
    findings.check("4.14", "POWER imager on", on.is_("completed") and probe.status()["imager_on"] is True, on.text)
