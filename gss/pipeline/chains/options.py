"""Listing and replacement of a chain's constants by name, for reruns with another method or limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypeVar

from gss.domain.errors import BadInput

P = TypeVar("P")
TRUE, FALSE = ("true", "yes", "1"), ("false", "no", "0")
Kind = Literal["number", "integer", "word", "yes or no", "numbers"]


@dataclass(frozen=True)
class ChainOption:
    """Constant that a rerun can change. ``value``: text for the camera and exposure, empty if not set; ``numbers`` are
    separated by commas. ``source``: section of the document, or reason for the value."""

    name: str
    kind: Kind
    value: str
    source: str


def names(parameters: Any) -> tuple[str, ...]:
    """Return the names of the constants that can be given as text: numbers, words, booleans and short tuples of numbers."""
    return tuple(
        f.name for f in fields(parameters) if _is_plain(getattr(parameters, f.name)) or f.name == "threshold_dn"
    )


def with_options(parameters: P, options: Mapping[str, str]) -> P:
    """Return the parameters with the given constants replaced. Raises BadInput for an unknown name (listing the valid ones), a
    value of another type, outside its limits or not finite, or one that the chain rejects."""
    changed: Any = parameters
    valid_names = names(parameters)
    for name, text in options.items():
        if name not in valid_names:
            raise BadInput("the chain has no such constant", expected=", ".join(valid_names), got=name)
        value = _value(name, getattr(parameters, name), text)
        _check_limits(name, value, text, changed.limits)
        changed = replace(changed, **{name: value})
    result: P = changed
    return result


def listed(parameters: Any, sources: Mapping[str, str]) -> tuple[ChainOption, ...]:
    """Return the constants that can be changed, with their values and sources. ``sources`` has an entry for
    each constant."""
    return tuple(
        ChainOption(name, _kind(value), _text(value), sources[name])
        for name in names(parameters)
        for value in (getattr(parameters, name),)
    )


def as_text(changed: Mapping[str, str]) -> str:
    """Return the changed constants as one line, ``NAME=VALUE, …`` in alphabetical order, as stored with a solution."""
    return ", ".join(f"{name}={changed[name].strip()}" for name in sorted(changed))


def _kind(value: Any) -> Kind:
    if isinstance(value, bool):
        return "yes or no"
    if isinstance(value, str):
        return "word"
    if isinstance(value, tuple):
        return "numbers"
    return "integer" if isinstance(value, int) else "number"


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ",".join(_text(v) for v in value)
    return value if isinstance(value, str) else f"{value:.10g}"


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(isinstance(v, int | float) for v in value)
    return isinstance(value, bool | int | float | str)


def _value(name: str, current: Any, text: str) -> Any:
    try:
        if isinstance(current, bool):
            return _truth(text)
        if isinstance(current, str):
            return text
        if isinstance(current, tuple):
            return _row(current, text)
        return int(text) if isinstance(current, int) else float(text)
    except ValueError:
        kind = "a number" if current is None else type(current).__name__
        raise BadInput(f"{name} is of another kind", expected=f"{kind}, such as {current}", got=text) from None


def _check_limits(name: str, value: Any, text: str, limits: Mapping[str, tuple[float, float]]) -> None:
    """Raise BadInput if a number, or one of several, is outside the limits of its constant."""
    if isinstance(value, bool | str):
        return
    low, high = limits[name]
    if not all(low <= number <= high for number in (value if isinstance(value, tuple) else (value,))):
        raise BadInput(f"{name} is outside its limits", expected=f"{low:g} to {high:g}", got=text)


def _truth(text: str) -> bool:
    if text.lower() not in (*TRUE, *FALSE):
        raise ValueError(text)
    return text.lower() in TRUE


def _row(current: Sequence[float], text: str) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) != len(current):
        raise ValueError(text)
    return tuple(type(o)(p) for o, p in zip(current, parts, strict=True))


def parse(pairs: Sequence[str]) -> dict[str, str]:
    """Parse ``NAME=VALUE`` pairs from the command line."""
    values: dict[str, str] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name:
            raise BadInput("invalid constant", expected="NAME=VALUE", got=pair)
        values[name.strip()] = value.strip()
    return values
