"""Read the inner rows of ``dictionary.yaml``: choices, values, arguments, preconditions, lists. Errors name the invalid row."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict, TypeGuard

from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    EnumChoice,
    Group,
    Hazard,
    Item,
    Layout,
    Precondition,
)

ITEM_KEYS = "name type enum unit decimals purpose"
SIZED = re.compile(r"(bytes|str)([1-9][0-9]{0,2})")
PLAIN_TYPES = (*INTEGER_RANGES, *FLOATS, "bool", "enum", "text", "rest")
LONGEST = {"command": 60, "packet": 40, "field": 53, "limit set": 30}
"""Longest names that the database can store; of a field as ``packet.field``."""
OPERATORS = ("eq", "ne", "lt", "le", "gt", "ge")
COUNTS, MAX_SLOTS = ("u8", "u16"), 255
Row = Mapping[str, Any]
Enums = dict[str, tuple[EnumChoice, ...]]


def read_choices(name: str, rows: Sequence[Row]) -> tuple[EnumChoice, ...]:
    """Return the choices of an enumeration. Raises BadInput unless each value fits in one byte."""
    choices = tuple(
        EnumChoice(str(r["name"]), int(r["value"]), Hazard(r.get("hazard", "none")), str(r.get("note", "")))
        for r in rows
    )
    unique(f"enum {name}", [c.name for c in choices])
    unique(f"enum {name}", [c.value for c in choices])
    if any(not 0 <= c.value <= 0xFF for c in choices):
        raise BadInput(f"enum {name}: a value does not fit in one byte", expected="values 0 – 255")
    return choices


def unique(where: str, keys: Sequence[object]) -> None:
    """Raise BadInput if a key occurs twice."""
    doubles = {k for k in keys if keys.count(k) > 1}
    if doubles:
        raise BadInput(f"{where}: an entry appears twice", got=", ".join(map(str, sorted(doubles, key=str))))


def read_name(kind: str, row: Row, packet: str = "") -> str:
    """Return the name of a row. ``packet``: packet of a field. Raises BadInput if the database cannot store the name."""
    name = str(row["name"])
    key = f"{packet}.{name}" if packet else name
    if len(key) > LONGEST[kind]:
        expected = f"at most {LONGEST[kind]} characters"
        raise BadInput(f"{kind} {key}: the name is too long", expected=expected, got=str(len(key)))
    return name


def known_keys(where: str, row: Row, keys: str) -> None:
    """Raise BadInput if a row has unknown keys."""
    unknown = set(row) - set(keys.split())
    if unknown:
        raise BadInput(f"{where}: unknown keys", expected=keys, got=", ".join(map(str, sorted(unknown, key=str))))


def read_flag(where: str, row: Row, key: str, default: bool | None = None) -> bool:
    """Return a boolean of a row. Raises BadInput for other values; YAML reads ``no`` and ``off`` as text."""
    value = row.get(key, default)
    if not isinstance(value, bool):
        raise BadInput(f"{where}: {key} is not a boolean", expected="true or false", got=repr(value)[:80])
    return value


def finite(where: str, value: object) -> int | float:
    """Return a number of a row. Raises BadInput for text, a boolean, NaN and infinity."""
    if not _is_finite(value):
        raise BadInput(f"{where}: not a finite number", got=repr(value)[:80])
    return value


def _is_finite(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_value_of(item: Item, value: object) -> bool:
    """True if an item can have this value; an enumeration has the names of its choices."""
    if item.choices:
        return any(c.name == value for c in item.choices)
    if item.type in INTEGER_RANGES or item.type in FLOATS:
        return _is_finite(value)
    return isinstance(value, bool if item.type == "bool" else str)


class ItemFields(TypedDict):
    """Constructor arguments that all types of Item share."""

    name: str
    type: str
    size: int
    unit: str
    purpose: str
    choices: tuple[EnumChoice, ...]


def read_item(where: str, row: Row, enums: Enums) -> ItemFields:
    """Return the constructor arguments that all types of Item share."""
    name, kind = str(row["name"]), str(row["type"])
    sized = SIZED.fullmatch(kind)
    if not sized and kind not in PLAIN_TYPES:
        raise BadInput(f"{where}.{name}: unknown type", expected=" ".join(PLAIN_TYPES) + " bytesN strN", got=kind)
    if (kind == "enum") != ("enum" in row) or (kind == "enum" and row["enum"] not in enums):
        raise BadInput(
            f"{where}.{name}: enum is missing or unknown", expected=", ".join(enums), got=str(row.get("enum"))
        )
    return {
        "name": name,
        "type": str(sized[1]) if sized else kind,
        "size": int(sized[2]) if sized else 0,
        "unit": str(row.get("unit", "")),
        "purpose": str(row.get("purpose", "")),
        "choices": enums[row["enum"]] if kind == "enum" else (),
    }


def read_argument(where: str, row: Row, enums: Enums) -> Argument:
    """Return an argument. Raises BadInput for a number without range or a default outside the range."""
    known_keys(f"{where}.{row.get('name')}", row, "name type enum unit min max default purpose")
    argument = Argument(
        **read_item(where, row, enums), minimum=row.get("min"), maximum=row.get("max"), default=row.get("default")
    )
    where = f"{where}.{argument.name}"
    numeric = argument.type in INTEGER_RANGES or argument.type in FLOATS
    if numeric and (argument.minimum is None or argument.maximum is None):
        raise BadInput(f"{where}: a number needs min and max")
    if numeric:
        finite(f"{where}.min", argument.minimum)
        finite(f"{where}.max", argument.maximum)
    if argument.type in INTEGER_RANGES:
        low, high = INTEGER_RANGES[argument.type]
        if argument.minimum < low or argument.maximum > high:  # type: ignore[operator]  # a number has both, checked above
            raise BadInput(
                f"{where}: range does not fit {argument.type}", expected=f"{low} – {high}", got=argument.range_text
            )
    _check_default(where, argument, numeric)
    return argument


def _check_default(where: str, argument: Argument, numeric: bool) -> None:
    default = argument.default
    if default is None:
        return
    is_valid = _is_value_of(argument, default)
    if not is_valid or (numeric and not argument.minimum <= default <= argument.maximum):  # type: ignore[operator]  # a number has both, checked above
        raise BadInput(f"{where}: default is not allowed", expected=argument.range_text, got=repr(default))


def read_precondition(where: str, row: Row, fields: Mapping[str, Item]) -> Precondition:
    """Return a precondition on one of the fields of housekeeping."""
    known_keys(where, row, "field op value text")
    if row["op"] not in OPERATORS:
        raise BadInput(f"{where}: unknown operator", expected=" ".join(OPERATORS), got=str(row["op"]))
    field, value = fields.get(row["field"]), row["value"]
    if field is None:
        raise BadInput(
            f"{where}: precondition on an unknown field", expected="a housekeeping field", got=str(row["field"])
        )
    if not _is_value_of(field, value):
        expected = " | ".join(c.name for c in field.choices) or f"a value of the type {field.type}"
        raise BadInput(f"{where}: {field.name} cannot have this value", expected=expected, got=repr(value)[:80])
    return Precondition(str(row["field"]), str(row["op"]), row["value"], str(row["text"]))


def read_layout(where: str, rows: Sequence[Row], enums: Enums) -> Layout:
    """Return the values and lists in the order of the rows."""
    layout: list[Item | Group] = []
    for row in rows:
        if "list" in row:
            layout.append(read_group(where, row, enums))
        else:
            layout.append(_read_plain_item(where, row, enums))
    unique(where, [entry.name for entry in layout])
    return tuple(layout)


def _read_plain_item(where: str, row: Row, enums: Enums) -> Item:
    known_keys(f"{where}.{row.get('name')}", row, ITEM_KEYS)
    return Item(**read_item(where, row, enums))


def read_group(where: str, row: Row, enums: Enums) -> Group:
    """Return a list. Raises BadInput for an unsupported count type or an invalid number of slots."""
    where = f"{where}.{row['name']}"
    known_keys(where, row, "name list purpose count slots")
    count, slots = str(row.get("count", "u8")), int(row.get("slots", 0))
    if count not in COUNTS or not 0 <= slots <= MAX_SLOTS:
        expected = f"count {' or '.join(COUNTS)}, slots 0 – {MAX_SLOTS}"
        raise BadInput(f"{where}: invalid count or slots of a list", expected=expected, got=f"{count}, {slots}")
    return Group(str(row["name"]), read_items(where, row["list"], enums), str(row.get("purpose", "")), count, slots)


def read_items(where: str, rows: Sequence[Row], enums: Enums) -> tuple[Item, ...]:
    """Return the values in one row of a list."""
    items = tuple(_read_plain_item(where, row, enums) for row in rows)
    if any(item.type == "rest" for item in items):
        raise BadInput(f"{where}: a value of the type rest cannot be inside a list")
    return items
