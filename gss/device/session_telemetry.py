"""Decode telemetry packets into events. For speed, consecutive items of fixed size are unpacked together.

Invalid payloads (wrong length, invalid bool, unknown choice, invalid text) are passed to
:func:`gss.device.protocol.codec.decode`, which raises the detailed error.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from gss.device.protocol.codec import STRUCT, Decoded, decode, text_of
from gss.device.protocol.packet import Packet
from gss.device.session_events import Telemetry
from gss.instruments.dictionary.definitions import Dictionary, Group, Item, Layout, TelemetryField, Value

BOOLS: Mapping[Any, Value] = {0: False, 1: True}
Change = tuple[str, Callable[[Any], Value]]
"""Name of an item and the conversion of its unpacked value, which raises KeyError or ValueError for an invalid
value."""


class TelemetryReader:
    """Decodes telemetry packets. Uses a prepared decoder per packet type, because most packets are telemetry."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._kinds = {p.code: (p, Decoder(p.fields)) for p in reversed(dictionary.telemetry)}

    def read(self, packet: Packet) -> Telemetry | None:
        """Return the decoded telemetry, raw and in engineering units; None if the dictionary does not define its
        code."""
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
            packet.arrival,
        )


class Decoder:
    """Prepared :func:`gss.device.protocol.codec.decode` for one layout."""

    def __init__(self, layout: Layout | Sequence[Item]) -> None:
        self._layout = tuple(layout)
        self._parts = [_Run(part.items, part.name) if isinstance(part, Group) else _Run(part) for part in _cut(layout)]
        plain = all(
            part.count == "u8" and not part.slots
            if isinstance(part, Group)
            else not (isinstance(part, TelemetryField) and part.valid)
            for part in layout
        )
        self._prepared = plain and all(part.decodable for part in self._parts)

    def decode(self, payload: bytes) -> Decoded:
        """Return the values of a payload. Raises CorruptData unless the payload fits the layout exactly."""
        if self._prepared:
            try:
                return self._unpacked(payload)
            except (struct.error, LookupError, ValueError):
                pass
        return decode(self._layout, payload)

    def _unpacked(self, payload: bytes) -> Decoded:
        result, at = Decoded(), 0
        for part in self._parts:
            if part.group:
                count, at = payload[at], at + 1
                end = at + count * part.size
                rows = part.rows(payload[at:end]) if count else ()
                if len(rows) != count:
                    raise ValueError("too short")
                result.lists[part.group], at = rows, end
            else:
                at = part.take(payload, at, result)
        if at != len(payload):
            raise ValueError("too long")
        return result


class _Run:
    """Consecutive items of a layout or of a list's rows. ``decodable``: True if every item has a fixed size and no name
    occurs twice."""

    def __init__(self, items: Sequence[Item], group: str = "") -> None:
        self.group, self._names = group, [item.name for item in items]
        codes = [_code(item) for item in items]
        self.decodable = all(codes) and len(set(self._names)) == len(items)
        self._struct = struct.Struct(">" + "".join(codes))
        self.size = self._struct.size
        self._raw: list[Change] = []
        self._named: list[Change] = []
        for item in items:
            if item.type == "bool":
                self._raw.append((item.name, BOOLS.__getitem__))
            elif item.type == "str":
                self._raw.append((item.name, _text))
            elif item.type == "enum":
                names = {choice.value: choice.name for choice in reversed(item.choices)}
                self._named.append((item.name, names.__getitem__))
            if isinstance(item, TelemetryField) and item.type != "enum" and item.conversion.coefficients:
                self._named.append((item.name, item.conversion.engineering))

    def take(self, payload: bytes, at: int, result: Decoded) -> int:
        """Decode the items at offset ``at`` into the result. Returns the offset after them."""
        raw: dict[str, Value] = dict(zip(self._names, self._struct.unpack_from(payload, at), strict=True))
        for name, change in self._raw:
            raw[name] = change(raw[name])
        result.raw.update(raw)
        for name, change in self._named:
            raw[name] = change(raw[name])
        result.values.update(raw)
        return at + self.size

    def rows(self, piece: bytes) -> tuple[dict[str, Value], ...]:
        """Return the decoded rows of a list."""
        changes, names = (*self._raw, *self._named), self._names
        rows = []
        for values in self._struct.iter_unpack(piece):
            row: dict[str, Value] = dict(zip(names, values, strict=True))
            for name, change in changes:
                row[name] = change(row[name])
            rows.append(row)
        return tuple(rows)


def _cut(layout: Layout | Sequence[Item]) -> Iterator[Group | list[Item]]:
    """Yield each list of a layout, and the consecutive items between lists as one sequence."""
    run: list[Item] = []
    for entry in layout:
        if isinstance(entry, Group):
            if run:
                yield run
                run = []
            yield entry
        else:
            run.append(entry)
    if run:
        yield run


def _code(item: Item) -> str:
    """Return the item's struct format code, "" for an item of variable length."""
    if item.type in STRUCT:
        return STRUCT[item.type].format.lstrip(">")
    return f"{item.size}s" if item.type in ("bytes", "str") and item.size else ""


def _text(data: bytes) -> str:
    return text_of(data.rstrip(b"\0"))
