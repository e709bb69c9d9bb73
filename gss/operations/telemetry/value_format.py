"""Forms of a telemetry value: as transmitted, in its engineering unit, and as displayed."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from gss.device.protocol.codec import STRUCT
from gss.instruments.dictionary.definitions import FLOATS, INTEGER_RANGES, Conversion, Item, TelemetryField

UNKNOWN = "–"
OTHER_VALUES = "other_values"
"""Column of an export with the values that the types of their columns cannot hold, as JSON."""
Kind = Literal["number", "enum", "bool", "text", "bytes"]
ColumnType = Literal["int64", "uint64", "float64", "bool", "string"]
INTEGER_COLUMNS = {"int64": (-(2**63), 2**63 - 1), "uint64": (0, 2**64 - 1)}
PLAIN_TYPES = frozenset({int, bool, str})


def kind(field: Item) -> Kind:
    """Return the kind of a field: number, enum, bool, text or bytes."""
    if field.type in INTEGER_RANGES or field.type in FLOATS:
        return "number"
    if field.type == "enum":
        return "enum"
    if field.type == "bool":
        return "bool"
    return "text" if field.type in ("str", "text") else "bytes"


def column_type(field: Item) -> ColumnType:
    """Return the type of a field's engineering values in a table, by its name in Arrow. It does not depend on the values, so
    that files of different days can be read together."""
    if kind(field) == "number":
        converted = isinstance(field, TelemetryField) and bool(field.conversion.coefficients)
        if field.type not in INTEGER_RANGES or converted:
            return "float64"
        return "uint64" if field.type == "u64" else "int64"
    return "bool" if field.type == "bool" else "string"


def typed(field: Item, value: Any) -> Any:
    """Return a stored value in the type of its field's column, yes as 1 among numbers. None if the type cannot hold the
    value, which was stored when the field had another definition."""
    column = column_type(field)
    if column == "string":
        return value if isinstance(value, str) else None
    if column == "bool":
        return bool(value) if isinstance(value, int) and value in (0, 1) else None
    if not isinstance(value, int | float):
        return None
    if column == "float64":
        return float(value) if float(value) == value else None
    low, high = INTEGER_COLUMNS[column]
    return int(value) if low <= value <= high and value == int(value) else None


def json_text(value: Any) -> str:
    """Return compact JSON for a column of an export."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def plain(value: Any) -> Any:
    """Convert a value for JSON: bytes to hex, NaN and infinities to None."""
    if isinstance(value, bytes):
        return value.hex()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def plain_values(values: Mapping[str, Any]) -> dict[str, object]:
    """Apply :func:`plain` to each value, with a fast path for the most common types."""
    return {
        name: value
        if (kind := type(value)) in PLAIN_TYPES
        else ((value if value - value == 0 else None) if kind is float else plain(value))
        for name, value in values.items()
    }


def as_number(value: Any) -> float | int | None:
    """Return a value as a JSON number: yes as 1, no as 0; None for NaN, infinities and all other values."""
    if isinstance(value, bool):
        return float(value)
    return value if isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)) else None


def formatted(value: Any, decimals: int) -> str:
    """Format a value with the dictionary's decimals and a true minus sign; Booleans as yes or no; an unknown value as a
    dash."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float | int):
        text = f"{value:.{decimals}f}" if isinstance(value, float) else str(value)
        return text.replace("-", "−")
    return str(value)


def raw_text(field: Item, raw: Any) -> str:
    """Format a raw value: integers in hexadecimal of their width, floats as numbers, bytes in hexadecimal."""
    if raw is None:
        return UNKNOWN
    if isinstance(raw, bytes):
        return raw.hex()
    if isinstance(raw, float):
        return f"{raw:g}" if math.isfinite(raw) else "not a number"
    if isinstance(raw, int) and field.type in STRUCT:
        size = STRUCT[field.type].size
        return f"0x{int(raw) & ((1 << 8 * size) - 1):0{2 * size}X}"
    return str(raw)


def number(field: Item, value: Any) -> float | None:
    """Return a stored value as a number to plot: an enumeration as its number, yes as 1; None for all other values."""
    if isinstance(value, str):
        return next((float(c.value) for c in field.choices if c.name == value), None)
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def raw_of(field: Item, value: Any) -> Any:
    """Return the raw value of a stored engineering value; None if several raw values, or none, are converted to it. It is
    determined by bisection of each range in which the conversion is monotonic."""
    if value is None:
        return None
    if field.type == "enum":
        return next((c.value for c in field.choices if c.name == value), None)
    conversion = field.conversion if isinstance(field, TelemetryField) else None
    if conversion is None or not conversion.coefficients:
        return value
    if field.type not in INTEGER_RANGES:
        return None
    found: list[int] = []
    for low, high in _monotonic_ranges(conversion.coefficients, *INTEGER_RANGES[field.type]):
        first = _first_raw(conversion, value, low, high)
        found += [raw for raw in (first, first + 1) if raw <= high and conversion.engineering(raw) == value]
    return found[0] if len(found) == 1 else None


@lru_cache(maxsize=256)
def _monotonic_ranges(coefficients: tuple[float, ...], low: int, high: int) -> list[tuple[int, int]]:
    """Return ranges of raw values, with both ends, in which the conversion is monotonic. The integers beside a turning point
    have separate ranges, because its position is rounded."""
    if not all(map(math.isfinite, coefficients)):
        return []
    slope = [k * c for k, c in enumerate(coefficients)][1:]
    turning = [math.floor(root.real) for root in np.roots(slope[::-1]) if abs(root.imag) < 1e-6 * max(1.0, abs(root))]
    starts = sorted({low, *(k for t in turning for k in range(t - 1, t + 4) if low < k <= high)})
    return list(zip(starts, [start - 1 for start in starts[1:]] + [high], strict=True))


def _first_raw(conversion: Conversion, value: float, low: int, high: int) -> int:
    """Return the first raw value of a monotonic range whose engineering value has reached ``value``, or ``high``."""
    rising = float(conversion.engineering(high)) > float(conversion.engineering(low))
    while low < high:
        middle = (low + high) // 2
        if (float(conversion.engineering(middle)) >= value) == rising or conversion.engineering(middle) == value:
            high = middle
        else:
            low = middle + 1
    return low
