"""Packets that a host session shows or makes without following them: dry runs, and tests of the far end."""

from __future__ import annotations

from collections.abc import Mapping

from gss.device.dictionary import Dictionary, Value
from gss.device.protocol.codec import check_arguments, encode_item
from gss.device.protocol.line import LineSender
from gss.device.protocol.packet import CRC_BYTES, PacketType, labelled_bytes


def command_preview(
    dictionary: Dictionary, sender: LineSender, request_id: int, name: str, arguments: Mapping[str, Value]
) -> list[tuple[str, bytes]]:
    """The packet before framing as labelled groups; an argument's group has its name as label. Nothing is counted."""
    command = dictionary.command(name)
    values = check_arguments(command, arguments)
    groups = [(a.name, encode_item(a, values[a.name])) for a in command.arguments]
    payload = b"".join(data for _, data in groups)
    packet = sender.next_packet(PacketType.COMMAND, command.code, request_id, payload)
    return [*labelled_bytes(packet), *groups, ("CRC-32", packet[-CRC_BYTES:])]


def crafted_frame(
    sender: LineSender, kind: PacketType, code: int, request_id: int, payload: bytes, prefix: int | None
) -> bytes:
    """A frame of any content, with another prefix than the sender's where one is given."""
    own = sender.prefix
    sender.prefix = own if prefix is None else prefix
    frame = sender.packet(kind, code, request_id, payload)
    sender.prefix = own
    return frame
