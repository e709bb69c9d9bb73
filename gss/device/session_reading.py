"""Decode packets from the device into session events."""

from __future__ import annotations

from collections.abc import Mapping

from gss.device.protocol.codec import decode
from gss.device.protocol.packet import Packet
from gss.device.session_events import DeviceEvent, HelloReceived, ReportFacts, Stage
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, EventDefinition, Value

COMPLETED = bytes([5])


def read_report(packet: Packet, command: CommandDefinition, dictionary: Dictionary) -> tuple[Stage, ReportFacts]:
    """Return the stage and the values in a command's report. A completed report includes the returned values."""
    fields = dictionary.service("REPORT").fields
    completed = packet.payload[:1] == COMPLETED
    values = decode((*fields, *command.returns) if completed else fields, packet.payload).values
    common = {f.name for f in fields}
    facts: ReportFacts = {
        "device_time_s": packet.time_s,
        "reason": "" if values["reason"] == "none" else str(values["reason"]),
        "detail": str(values["detail"]),
        "progress": int(values["progress"]),
        "replayed": bool(values["replayed"]),
        "values": {name: value for name, value in values.items() if name not in common},
    }
    return Stage(str(values["stage"])), facts


def read_hello(values: Mapping[str, Value], device_time_s: float, dictionary: Dictionary) -> HelloReceived:
    """Return the device's identity from the values of HELLO. ``dictionary``: the host's dictionary."""
    device_hash = bytes(values["dictionary_hash"])  # type: ignore[arg-type]  # bytes32 decodes to bytes
    return HelloReceived(
        device_model=str(values["device_model"]),
        profile=str(values["profile"]),
        firmware=str(values["firmware"]),
        serial=str(values["serial"]),
        simulated=bool(values["simulated"]),
        dictionary_hash=device_hash.hex(),
        dictionary_match=dictionary.describes(device_hash),
        line_baud=int(values["line_baud"]),
        columns=int(values["columns"]),
        rows=int(values["rows"]),
        bits=int(values["bits"]),
        image_slots=int(values["image_slots"]),
        bank_bytes=int(values["bank_bytes"]),
        boot_count=int(values["boot_count"]),
        last_request_id=int(values["last_request_id"]),
        device_time_s=device_time_s,
    )


def read_event(packet: Packet, definition: EventDefinition, dictionary: Dictionary) -> DeviceEvent:
    """Return the device event in a packet."""
    text = str(decode(dictionary.service("EVENT").fields, packet.payload).values["text"])
    return DeviceEvent(definition.name, definition.severity, text, packet.time_s, packet.request_id)
