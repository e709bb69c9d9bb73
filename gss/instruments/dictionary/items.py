"""Types of dictionary rows: values on the wire with type, unit, range, choices, conversion and limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from gss.domain.errors import BadInput
from gss.domain.limits import Limits

Value = int | float | bool | str | bytes
Values = Mapping[str, Value]

INTEGER_RANGES: dict[str, tuple[int, int]] = {
    "u8": (0, 0xFF),
    "u16": (0, 0xFFFF),
    "u32": (0, 0xFFFF_FFFF),
    "u64": (0, 0xFFFF_FFFF_FFFF_FFFF),
    "i8": (-0x80, 0x7F),
    "i16": (-0x8000, 0x7FFF),
    "i32": (-0x8000_0000, 0x7FFF_FFFF),
}
FLOATS = ("f32", "f64")


class Hazard(StrEnum):
    """Hazard level of a command. WARNING needs a confirmation; for CRITICAL the user must type the command's name."""

    NONE = "none"
    WATCH = "watch"
    WARNING = "warning"
    CRITICAL = "critical"

    @property
    def rank(self) -> int:
        """Rank of the level, from 0 (NONE) to 3 (CRITICAL)."""
        return list(Hazard).index(self)


def number_text(value: float) -> str:
    """Return a number as text without rounding: "4294967295", "0.0625"."""
    short = f"{value:g}"
    return short if not isinstance(value, int) and float(short) == value else str(value)


@dataclass(frozen=True)
class EnumChoice:
    """One value of an enumeration."""

    name: str
    value: int
    hazard: Hazard = Hazard.NONE
    note: str = ""


@dataclass(frozen=True)
class Item:
    """One value on the wire. ``size``: number of bytes of a ``bytes`` or ``str`` item. ``choices``: choices of an
    ``enum`` item, whose values are the names."""

    name: str
    type: str
    size: int = 0
    unit: str = ""
    purpose: str = ""
    choices: tuple[EnumChoice, ...] = ()

    def choice(self, name: str) -> EnumChoice:
        """Return a choice by its name. Raises BadInput with the valid names."""
        for choice in self.choices:
            if choice.name == name:
                return choice
        expected = " | ".join(c.name for c in self.choices)
        raise BadInput(f"{self.name} has no such choice", expected=expected, got=repr(name))

    def choice_name(self, value: int) -> str | None:
        """Return the name of a choice by its number; None for an unknown number."""
        return next((c.name for c in self.choices if c.value == value), None)


@dataclass(frozen=True)
class Argument(Item):
    """An argument of a command, with an inclusive range."""

    minimum: float | None = None
    maximum: float | None = None
    default: Value | None = None

    @property
    def range_text(self) -> str:
        """Range as text: "0 – 255", or the names of the choices."""
        if self.choices:
            return " | ".join(c.name for c in self.choices)
        if self.type == "bool":
            return "true | false"
        if self.minimum is None or self.maximum is None:
            return ""
        return f"{number_text(self.minimum)} – {number_text(self.maximum)}"


@dataclass(frozen=True)
class Conversion:
    """Conversion from raw to engineering value: Σ cᵢ·rawⁱ. Without coefficients, both values are equal."""

    coefficients: tuple[float, ...] = ()

    def engineering(self, raw: Value) -> Value:
        """Return the value in the field's unit."""
        if not self.coefficients or not isinstance(raw, int | float):
            return raw
        total = 0.0
        for coefficient in reversed(self.coefficients):
            total = total * raw + coefficient
        return total


@dataclass(frozen=True)
class TelemetryField(Item):
    """One telemetry value.

    ``valid``: range of valid values; a packet with a value outside this range is dropped. ``stale_after_s``: 0 = never
    stale. ``page``: page of the console that shows the field. ``persistence``: number of consecutive samples that must
    agree before the limit state changes. ``sets``: limits by limit set, active while the set is selected. ``action``:
    what the operator should do when a limit is violated.
    """

    title: str = ""
    page: str = ""
    decimals: int = 0
    conversion: Conversion = field(default_factory=Conversion)
    limits: Limits = field(default_factory=Limits)
    stale_after_s: float = 0.0
    persistence: int = 1
    valid: tuple[float, float] | None = None
    sets: Mapping[str, Limits] = field(default_factory=dict)
    action: str = ""


@dataclass(frozen=True)
class Group:
    """A list: a count, followed by that number of rows of items. ``count``: type of the count. ``slots``: fixed number
    of rows in the packet, of which only the counted rows are valid; 0 = only the counted rows are sent."""

    name: str
    items: tuple[Item, ...]
    purpose: str = ""
    count: str = "u8"
    slots: int = 0


Layout = tuple[Item | Group, ...]
