"""Decode packets from the device into session events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gss.device.protocol.codec import decode
from gss.device.protocol.packet import Packet
from gss.device.session_events import DeviceEvent, HelloReceived, Stage
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, EventDefinition, Value

COMPLETED = bytes([5])


def read_report(packet: Packet, command: CommandDefinition, dictionary: Dictionary) -> tuple[Stage, dict[str, Any]]:
    """Return a command's stage and its report's values; a completed report includes the returned values."""
    fields = dictionary.service("REPORT").fields
    completed = packet.payload[:1] == COMPLETED
    v = decode((*fields, *command.returns) if completed else fields, packet.payload).values
    common = {f.name for f in fields}
    facts: dict[str, Any] = {
        "device_time_s": packet.time_s,
        "reason": "" if v["reason"] == "none" else v["reason"],
        "detail": v["detail"],
        "progress": v["progress"],
        "replayed": v["replayed"],
        "values": {name: value for name, value in v.items() if name not in common},
    }
    return Stage(str(v["stage"])), facts


def read_hello(v: Mapping[str, Value], device_time_s: float, dictionary: Dictionary) -> HelloReceived:
    """Return the device's identity from the values that HELLO returns; ``dictionary``: of the host."""
    device_hash = bytes(v["dictionary_hash"])  # type: ignore[arg-type]  # bytes32 decodes to bytes
    return HelloReceived(
        device_model=str(v["device_model"]),
        profile=str(v["profile"]),
        firmware=str(v["firmware"]),
        serial=str(v["serial"]),
        simulated=bool(v["simulated"]),
        dictionary_hash=device_hash.hex(),
        dictionary_match=dictionary.describes(device_hash),
        line_baud=int(v["line_baud"]),
        columns=int(v["columns"]),
        rows=int(v["rows"]),
        bits=int(v["bits"]),
        image_slots=int(v["image_slots"]),
        bank_bytes=int(v["bank_bytes"]),
        boot_count=int(v["boot_count"]),
        last_request_id=int(v["last_request_id"]),
        device_time_s=device_time_s,
    )


def read_event(packet: Packet, definition: EventDefinition, dictionary: Dictionary) -> DeviceEvent:
    """Return the device event in a packet."""
    text = str(decode(dictionary.service("EVENT").fields, packet.payload).values["text"])
    return DeviceEvent(definition.name, definition.severity, text, packet.time_s, packet.request_id)
