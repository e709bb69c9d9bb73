"""Decode packets from the device into session events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gss.device.dictionary import Command, Dictionary, EventDefinition, Value
from gss.device.protocol.codec import Decoded, decode
from gss.device.protocol.decoder import Decoder
from gss.device.protocol.packet import Packet
from gss.device.session_events import DeviceEvent, HelloReceived, Stage, Telemetry

COMPLETED = bytes([5])


def read_report(packet: Packet, command: Command, dictionary: Dictionary) -> tuple[Stage, dict[str, Any]]:
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


def read_hello(v: Mapping[str, Value], device_time_s: float, own_hash: bytes) -> HelloReceived:
    """Return the device's identity from the values that HELLO returns; ``own_hash``: of the host's dictionary."""
    told = bytes(v["dictionary_hash"])  # type: ignore[arg-type]  # bytes32 decodes to bytes
    return HelloReceived(
        device_model=str(v["device_model"]),
        profile=str(v["profile"]),
        firmware=str(v["firmware"]),
        serial=str(v["serial"]),
        simulated=bool(v["simulated"]),
        dictionary_hash=told.hex(),
        dictionary_match=told == own_hash,
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


class TelemetryReader:
    """Decodes telemetry packets, with a prepared decoder per packet type because they are most of the traffic."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._kinds = {p.code: (p, Decoder(p.fields)) for p in reversed(dictionary.telemetry)}

    def read(self, packet: Packet) -> Telemetry | None:
        """Return a telemetry packet, raw and in engineering units; None if the dictionary does not define its code."""
        kind = self._kinds.get(packet.code)
        if kind is None:
            return None
        definition, decoder = kind
        message: Decoded = decoder.decode(packet.payload)
        return Telemetry(
            definition.name,
            packet.time_s,
            packet.request_id,
            message.raw,
            message.values,
            message.lists,
            definition.simulator_only,
        )


def read_event(packet: Packet, definition: EventDefinition, dictionary: Dictionary) -> DeviceEvent:
    """Return the device event in a packet."""
    text = str(decode(dictionary.service("EVENT").fields, packet.payload).values["text"])
    return DeviceEvent(definition.name, definition.severity, text, packet.time_s, packet.request_id)
