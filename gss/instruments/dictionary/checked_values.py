"""Check values against the type and the range of their item, and convert them to its Python type."""

from __future__ import annotations

import math
import struct

from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    CommandDefinition,
    Item,
    Value,
    Values,
)

F32_MAX = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0]


def check_arguments(command: CommandDefinition, arguments: Values) -> dict[str, Value]:
    """Return all arguments in the command's order, converted to their types and with defaults filled in.

    Raises BadInput naming the invalid argument.
    """
    unknown = set(arguments) - {a.name for a in command.arguments}
    if unknown:
        expected = ", ".join(a.name for a in command.arguments) or "no arguments"
        raise BadInput(f"{command.name}: unknown argument", expected=expected, got=", ".join(sorted(unknown)))
    return {a.name: check_argument(a, arguments.get(a.name, a.default)) for a in command.arguments}


def check_argument(argument: Argument, value: Value | None) -> Value:
    """Return the value converted to the argument's type. Raises BadInput ("0 – 255, got 300") if it is missing or out
    of range."""
    if value is None:
        raise BadInput(f"{argument.name} is missing", expected=argument.range_text)
    value = coerce(argument, value)
    low, high = argument.minimum, argument.maximum
    if low is not None and high is not None and isinstance(value, int | float) and not low <= value <= high:
        raise _bad(argument, value)
    return value


def _bad(item: Item, value: object) -> BadInput:
    expected = item.range_text if isinstance(item, Argument) and item.range_text else _type_text(item)
    shown = value.hex() if isinstance(value, bytes) else value
    unit = f" {item.unit}" if item.unit else ""
    return BadInput(f"{item.name}: {expected}, got {shown}", expected=f"{expected}{unit}", got=f"{shown}")


def _type_text(item: Item) -> str:
    if item.type in INTEGER_RANGES:
        low, high = INTEGER_RANGES[item.type]
        return f"{low} – {high}"
    return f"{item.type}{item.size or ''}"


def coerce(item: Item, value: Value) -> Value:
    """Convert a value to the item's Python type without rounding. Numbers are not accepted as booleans.

    Raises BadInput if the value does not fit.
    """
    kind = item.type
    if kind in INTEGER_RANGES:
        low, high = INTEGER_RANGES[kind]
        is_integer = isinstance(value, int) and not isinstance(value, bool)
        is_integer = is_integer or (isinstance(value, float) and value.is_integer())
        if not is_integer or not low <= value <= high:  # type: ignore[operator]  # a number or bytes by the tests above
            raise _bad(item, value)
        return int(value)
    if kind in FLOATS:
        return _coerce_float(item, value)
    if kind == "bool":
        if not isinstance(value, bool):
            raise _bad(item, value)
        return value
    if kind == "enum":
        if isinstance(value, int) and not isinstance(value, bool):
            value = item.choice_name(value) or str(value)
        return item.choice(str(value)).name
    return _coerce_bytes(item, value)


def _coerce_float(item: Item, value: Value) -> float:
    if isinstance(value, bool | str | bytes):
        raise _bad(item, value)
    try:
        number = float(value)
    except OverflowError:
        raise _bad(item, value) from None
    # A telemetry value may be unknown (NaN); an argument may not.
    if isinstance(item, Argument) and not math.isfinite(number):
        raise _bad(item, value)
    if item.type == "f32" and math.isfinite(number) and abs(number) > F32_MAX:
        raise _bad(item, value)
    return number


def _coerce_bytes(item: Item, value: Value) -> Value:
    if item.type in ("str", "text"):
        room = item.size if item.type == "str" else 255
        if not isinstance(value, str) or len(value.encode()) > room or "\0" in value:
            raise _bad(item, value)
        return value
    if isinstance(value, str):
        try:
            value = bytes.fromhex(value)
        except ValueError:
            raise _bad(item, value) from None
    if not isinstance(value, bytes):
        raise _bad(item, value)
    if isinstance(item, Argument) and item.type == "bytes" and len(value) < item.size:
        # A user can enter fewer bytes than the field has. The remaining bytes of the field are zero.
        value = value.ljust(item.size, b"\0")
    if item.type == "bytes" and len(value) != item.size:
        raise _bad(item, value)
    return value
