"""Encode values to payload bytes and decode them, using the dictionary's layouts. Both directions check every value.

Big-endian unless ``order`` is ``<`` (little-endian), which some third-party sensors use.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.checked_values import check_arguments, coerce
from gss.instruments.dictionary.definitions import (
    CommandDefinition,
    Group,
    Item,
    Layout,
    TelemetryField,
    Value,
    Values,
)

BIG, LITTLE = ">", "<"
CODES = {
    "u8": "B",
    "u16": "H",
    "u32": "I",
    "u64": "Q",
    "i8": "b",
    "i16": "h",
    "i32": "i",
    "f32": "f",
    "f64": "d",
    "bool": "B",
    "enum": "B",
}
STRUCTS = {order: {name: struct.Struct(order + code) for name, code in CODES.items()} for order in (BIG, LITTLE)}
STRUCT = STRUCTS[BIG]
MAX_LIST = 255
Lists = Mapping[str, Sequence[Values]]


@dataclass(frozen=True)
class Decoded:
    """Values and lists of a decoded payload. ``values`` and ``lists`` contain enumerations as names, ``raw`` as
    numbers."""

    raw: dict[str, Value] = field(default_factory=dict)
    values: dict[str, Value] = field(default_factory=dict)
    lists: dict[str, tuple[dict[str, Value], ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class EncodedCommand:
    """A command with its arguments validated and encoded. ``arguments``: all values, with defaults. ``groups``: (argument, bytes)
    in the order of the payload."""

    command: CommandDefinition
    arguments: Values
    groups: tuple[tuple[str, bytes], ...]

    @property
    def payload(self) -> bytes:
        """The encoded arguments."""
        return b"".join(data for _, data in self.groups)


def encode_command(command: CommandDefinition, arguments: Values, order: str = BIG) -> EncodedCommand:
    """Validate the arguments of a command, fill in defaults, and encode them. Raises BadInput naming the invalid
    argument."""
    values = check_arguments(command, arguments)
    groups = tuple((a.name, _bytes_of(a, values[a.name], order)) for a in command.arguments)
    return EncodedCommand(command, values, groups)


def fixed_bytes(layout: Layout | Sequence[Item]) -> int:
    """Return the size in bytes of the fixed-size items of a layout; lists and items of variable length are not
    counted."""
    return sum(STRUCT[e.type].size if e.type in STRUCT else e.size for e in layout if isinstance(e, Item))


def encode_item(item: Item, value: Value, order: str = BIG) -> bytes:
    """Return the bytes of one value. Raises BadInput if it does not fit."""
    return _bytes_of(item, coerce(item, value), order)


def _bytes_of(item: Item, value: Value, order: str) -> bytes:
    """Return the bytes of a value that already has the item's type."""
    if item.type == "enum":
        return bytes([item.choice(str(value)).value])
    if item.type in STRUCT:
        return STRUCTS[order][item.type].pack(value)
    if isinstance(value, str):
        data = value.encode()
        return bytes([len(data)]) + data if item.type == "text" else data.ljust(item.size, b"\0")
    return bytes(value)  # type: ignore[arg-type]  # a number or bytes by the tests above


def encode(layout: Layout | Sequence[Item], values: Values, lists: Lists | None = None, order: str = BIG) -> bytes:
    """Return the payload of a layout. Raises BadInput if a value is missing or does not fit."""
    parts: list[bytes] = []
    for entry in layout:
        if isinstance(entry, Group):
            rows = (lists or {}).get(entry.name, ())
            max_rows = entry.slots or MAX_LIST
            if len(rows) > max_rows:
                raise BadInput(f"list {entry.name} is too long", expected=f"at most {max_rows}", got=str(len(rows)))
            parts.append(STRUCTS[order][entry.count].pack(len(rows)))
            parts += [encode_item(item, row[item.name], order) for row in rows for item in entry.items]
            parts.append(bytes((entry.slots - len(rows)) * fixed_bytes(entry.items) if entry.slots else 0))
        else:
            if entry.name not in values:
                raise BadInput(f"{entry.name} is missing")
            parts.append(encode_item(entry, values[entry.name], order))
    return b"".join(parts)


class _FieldReader:
    """Reads values sequentially from a payload. Raises CorruptData if the payload is too short."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def take(self, count: int) -> bytes:
        if self._at + count > len(self._data):
            raise CorruptData("payload is too short", expected=f"{self._at + count} B", got=f"{len(self._data)} B")
        piece = self._data[self._at : self._at + count]
        self._at += count
        return piece

    def rest(self) -> bytes:
        return self.take(len(self._data) - self._at)

    def end(self) -> None:
        if self._at != len(self._data):
            raise CorruptData("payload is too long", expected=f"{self._at} B", got=f"{len(self._data)} B")


def decode(layout: Layout | Sequence[Item], payload: bytes, order: str = BIG) -> Decoded:
    """Return the values of a payload. Raises CorruptData unless the payload fits the layout exactly."""
    reader, result = _FieldReader(payload), Decoded()
    for entry in layout:
        if isinstance(entry, Group):
            width = STRUCTS[order][entry.count]
            count = width.unpack(reader.take(width.size))[0]
            rows = entry.slots or count
            if count > rows:
                raise CorruptData(f"list {entry.name} is too long", expected=f"at most {rows}", got=str(count))
            result.lists[entry.name] = tuple(
                {item.name: _named(item, _take(item, reader, order)) for item in entry.items} for _ in range(count)
            )
            reader.take((rows - count) * fixed_bytes(entry.items))
        else:
            raw = _take(entry, reader, order)
            result.raw[entry.name] = raw
            result.values[entry.name] = _named(entry, raw)
    reader.end()
    return result


def _take(item: Item, reader: _FieldReader, order: str) -> Value:
    kind = item.type
    if kind in STRUCT:
        value: Value = STRUCTS[order][kind].unpack(reader.take(STRUCT[kind].size))[0]
        if kind == "bool":
            if value not in (0, 1):
                raise CorruptData(f"{item.name} is not a valid bool", expected="0 or 1", got=str(value))
            return bool(value)
        return value
    if kind == "rest":
        return reader.rest()
    if kind == "bytes":
        return reader.take(item.size)
    data = reader.take(reader.take(1)[0]) if kind == "text" else reader.take(item.size).rstrip(b"\0")
    try:
        return text_of(data)
    except UnicodeDecodeError:
        raise CorruptData(f"{item.name} is not valid UTF-8") from None


def text_of(data: bytes) -> str:
    """Return the text in UTF-8 bytes. NUL becomes U+FFFD, because PostgreSQL cannot store it and it ends texts in C."""
    return data.decode().replace("\0", "\N{REPLACEMENT CHARACTER}")


def _named(item: Item, raw: Value) -> Value:
    """Return the name of an enumeration value, or a telemetry value in engineering units."""
    if item.type == "enum":
        name = item.choice_name(int(raw))
        if name is None:
            raise CorruptData(
                f"{item.name} has no such choice", expected=" | ".join(c.name for c in item.choices), got=str(raw)
            )
        return name
    if not isinstance(item, TelemetryField):
        return raw
    value = item.conversion.engineering(raw)
    if item.valid is not None and not (isinstance(value, int | float) and item.valid[0] <= value <= item.valid[1]):
        low, high = item.valid
        raise CorruptData(f"{item.name} is out of its valid range", expected=f"{low:g} – {high:g}", got=str(value))
    return value
