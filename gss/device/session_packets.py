"""Packets that a host session shows or builds without tracking them: dry runs and device tests."""

from __future__ import annotations

from collections.abc import Mapping

from gss.device.dictionary import Dictionary, Value
from gss.device.protocol.codec import check_arguments, encode_item
from gss.device.protocol.line import LineSender
from gss.device.protocol.packet import CRC_BYTES, PacketType, labelled_bytes


def command_preview(
    dictionary: Dictionary, sender: LineSender, request_id: int, name: str, arguments: Mapping[str, Value]
) -> list[tuple[str, bytes]]:
    """Return the packet before framing as labelled groups; an argument's group has its name as label.

    Uses up no sequence count and changes no counter.
    """
    command = dictionary.command(name)
    values = check_arguments(command, arguments)
    groups = [(a.name, encode_item(a, values[a.name])) for a in command.arguments]
    payload = b"".join(data for _, data in groups)
    packet = sender.next_packet(PacketType.COMMAND, command.code, request_id, payload)
    return [*labelled_bytes(packet), *groups, ("CRC-32", packet[-CRC_BYTES:])]


def crafted_frame(
    sender: LineSender, kind: PacketType, code: int, request_id: int, payload: bytes, prefix: int | None
) -> bytes:
    """Return a frame with arbitrary content; ``prefix`` replaces the sender's unless None."""
    own = sender.prefix
    sender.prefix = own if prefix is None else prefix
    frame = sender.packet(kind, code, request_id, payload)
    sender.prefix = own
    return frame
