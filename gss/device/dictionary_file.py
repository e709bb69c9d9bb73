"""Reads ``dictionary.yaml`` and refuses whatever could not work: double codes, defaults out of range, unknown fields."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from typing import Any

import yaml

from gss.device.dictionary import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    Choice,
    Command,
    Conversion,
    Dictionary,
    EventDefinition,
    Group,
    Hazard,
    Item,
    Layout,
    Packet,
    Precondition,
    Service,
    TelemetryField,
)
from gss.domain.errors import BadInput
from gss.domain.limits import Limits, State

SIZED = re.compile(r"(bytes|str)([1-9][0-9]{0,2})")
PLAIN_TYPES = (*INTEGER_RANGES, *FLOATS, "bool", "enum", "text", "rest")
OPERATORS = ("eq", "ne", "lt", "le", "gt", "ge")
SERVICE_PACKETS = ("report", "event", "transfer")
Row = Mapping[str, Any]
Enums = dict[str, tuple[Choice, ...]]


@lru_cache(maxsize=1)
def load_dictionary() -> Dictionary:
    """The dictionary that comes with this version."""
    return parse_dictionary(resources.files("gss.device").joinpath("dictionary.yaml").read_text("utf-8"))


def parse_dictionary(text: str) -> Dictionary:
    """Dictionary from YAML text; BadInput names the row that is wrong."""
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise BadInput("dictionary is not YAML", got=str(error)) from error
    if not isinstance(content, dict):
        raise BadInput("dictionary is empty", expected="a mapping with commands, telemetry, events, services")
    enums = {name: _choices(name, rows) for name, rows in content.get("enums", {}).items()}
    dictionary = Dictionary(
        version=int(content["version"]),
        device_model=str(content["device_model"]),
        commands=tuple(_command(row, enums) for row in content["commands"]),
        telemetry=tuple(_packet(row, enums) for row in content["telemetry"]),
        events=tuple(_event(row) for row in content["events"]),
        services=tuple(_service(row, enums) for row in content["services"]),
        hash=content_hash(content),
    )
    _check_whole(dictionary)
    return dictionary


def content_hash(content: Mapping[str, Any]) -> bytes:
    """SHA-256 of the content as JSON with sorted keys: comments and layout of the file do not count."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).digest()


def _choices(name: str, rows: Sequence[Row]) -> tuple[Choice, ...]:
    choices = tuple(
        Choice(str(r["name"]), int(r["value"]), Hazard(r.get("hazard", "none")), str(r.get("note", ""))) for r in rows
    )
    _unique(f"enum {name}", [c.name for c in choices])
    _unique(f"enum {name}", [c.value for c in choices])
    if any(not 0 <= c.value <= 0xFF for c in choices):
        raise BadInput(f"enum {name} does not fit its byte", expected="values 0 – 255")
    return choices


def _unique(where: str, keys: Sequence[object]) -> None:
    doubles = {k for k in keys if keys.count(k) > 1}
    if doubles:
        raise BadInput(f"{where}: given twice", got=", ".join(map(str, sorted(doubles, key=str))))


def _known(where: str, row: Row, keys: str) -> None:
    unknown = set(row) - set(keys.split())
    if unknown:
        raise BadInput(f"{where}: unknown keys", expected=keys, got=", ".join(sorted(unknown)))


def _item(where: str, row: Row, enums: Enums) -> dict[str, Any]:
    """The arguments that every kind of Item shares."""
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
        "type": sized[1] if sized else kind,
        "size": int(sized[2]) if sized else 0,
        "unit": str(row.get("unit", "")),
        "purpose": str(row.get("purpose", "")),
        "choices": enums[row["enum"]] if kind == "enum" else (),
    }


def _argument(where: str, row: Row, enums: Enums) -> Argument:
    _known(f"{where}.{row.get('name')}", row, "name type enum unit min max default purpose")
    argument = Argument(
        **_item(where, row, enums), minimum=row.get("min"), maximum=row.get("max"), default=row.get("default")
    )
    where = f"{where}.{argument.name}"
    numeric = argument.type in INTEGER_RANGES or argument.type in FLOATS
    if numeric and (argument.minimum is None or argument.maximum is None):
        raise BadInput(f"{where}: a number needs min and max")
    if argument.type in INTEGER_RANGES:
        low, high = INTEGER_RANGES[argument.type]
        if argument.minimum < low or argument.maximum > high:  # type: ignore[operator]
            raise BadInput(
                f"{where}: range does not fit {argument.type}", expected=f"{low} – {high}", got=argument.range_text
            )
    _check_default(where, argument, numeric)
    return argument


def _check_default(where: str, argument: Argument, numeric: bool) -> None:
    default = argument.default
    if default is None:
        return
    good = True
    if numeric:
        good = not isinstance(default, bool | str | bytes) and argument.minimum <= default <= argument.maximum  # type: ignore[operator]
    elif argument.choices:
        good = any(c.name == default for c in argument.choices)
    elif argument.type == "bool":
        good = isinstance(default, bool)
    if not good:
        raise BadInput(f"{where}: default is not allowed", expected=argument.range_text, got=repr(default))


def _layout(where: str, rows: Sequence[Row], enums: Enums) -> Layout:
    layout: list[Item | Group] = []
    for row in rows:
        if "list" in row:
            layout.append(Group(str(row["name"]), _items(f"{where}.{row['name']}", row["list"], enums)))
        else:
            layout.append(Item(**_item(where, row, enums)))
    _unique(where, [entry.name for entry in layout])
    return tuple(layout)


def _items(where: str, rows: Sequence[Row], enums: Enums) -> tuple[Item, ...]:
    items = tuple(Item(**_item(where, row, enums)) for row in rows)
    if any(item.type == "rest" for item in items):
        raise BadInput(f"{where}: rest cannot be inside a list")
    return items


def _command(row: Row, enums: Enums) -> Command:
    name = str(row["name"])
    _known(
        name,
        row,
        "name code subsystem purpose arguments returns hazard hazard_reason preconditions idempotent role favourite "
        "accept_s complete_s any_dictionary",
    )
    hazard = Hazard(row.get("hazard", "none"))
    if hazard is not Hazard.NONE and not row.get("hazard_reason"):
        raise BadInput(f"{name}: a hazard needs its reason")
    arguments = tuple(_argument(name, r, enums) for r in row.get("arguments", ()))
    _unique(name, [a.name for a in arguments])
    return Command(
        name=name,
        code=int(row["code"]),
        subsystem=str(row["subsystem"]),
        purpose=str(row["purpose"]),
        arguments=arguments,
        returns=_layout(name, row.get("returns", ()), enums),
        hazard=hazard,
        hazard_reason=str(row.get("hazard_reason", "")),
        preconditions=tuple(_precondition(name, r) for r in row.get("preconditions", ())),
        idempotent=bool(row["idempotent"]),
        role=str(row.get("role", "operator")),
        favourite=bool(row.get("favourite", False)),
        accept_s=float(row["accept_s"]),
        complete_s=float(row["complete_s"]),
        any_dictionary=bool(row.get("any_dictionary", False)),
    )


def _precondition(where: str, row: Row) -> Precondition:
    _known(where, row, "field op value text")
    if row["op"] not in OPERATORS:
        raise BadInput(f"{where}: unknown operator", expected=" ".join(OPERATORS), got=str(row["op"]))
    return Precondition(str(row["field"]), str(row["op"]), row["value"], str(row["text"]))


def _packet(row: Row, enums: Enums) -> Packet:
    name = str(row["name"])
    _known(name, row, "name code purpose fields stale_after_s simulator_only")
    stale_after_s = float(row["stale_after_s"])
    fields: list[Item | Group] = []
    for entry in row["fields"]:
        if "list" in entry:
            fields.append(Group(str(entry["name"]), _items(f"{name}.{entry['name']}", entry["list"], enums)))
        else:
            fields.append(_field(name, entry, enums, stale_after_s))
    _unique(name, [f.name for f in fields])
    return Packet(
        name, int(row["code"]), str(row["purpose"]), tuple(fields), stale_after_s, bool(row.get("simulator_only"))
    )


def _field(where: str, row: Row, enums: Enums, stale_after_s: float) -> TelemetryField:
    _known(
        f"{where}.{row.get('name')}",
        row,
        "name type enum unit purpose title page decimals conversion watch warning critical stale_after_s",
    )
    limits = Limits(**{s.value: _pair(where, row[s.value]) for s in list(State)[1:] if s.value in row})
    return TelemetryField(
        **_item(where, row, enums),
        title=str(row.get("title", row["name"])),
        page=str(row.get("page", "")),
        decimals=int(row.get("decimals", 0)),
        conversion=_conversion(f"{where}.{row['name']}", row.get("conversion", {})),
        limits=limits,
        stale_after_s=float(row.get("stale_after_s", stale_after_s)),
    )


def _pair(where: str, value: Sequence[float | None]) -> tuple[float | None, float | None]:
    low, high = value
    if low is not None and high is not None and low > high:
        raise BadInput(f"{where}: limits are crossed", got=f"{low} > {high}")
    return low, high


def _conversion(where: str, row: Row) -> Conversion:
    """``{linear: [scale, offset]}`` or ``{polynomial: [c0, c1, …]}``; nothing else is ever evaluated."""
    if not row:
        return Conversion()
    if set(row) == {"linear"} and len(row["linear"]) == 2:
        scale, offset = map(float, row["linear"])
        return Conversion((offset, scale))
    if set(row) == {"polynomial"} and row["polynomial"]:
        return Conversion(tuple(map(float, row["polynomial"])))
    raise BadInput(
        f"{where}: unknown conversion", expected="linear: [scale, offset] or polynomial: [c0, …]", got=str(row)
    )


def _event(row: Row) -> EventDefinition:
    _known(str(row["name"]), row, "name code severity purpose")
    return EventDefinition(str(row["name"]), int(row["code"]), State(row["severity"]).value, str(row["purpose"]))


def _service(row: Row, enums: Enums) -> Service:
    name, packet = str(row["name"]), str(row["packet"])
    _known(name, row, "name packet code purpose fields")
    if packet not in SERVICE_PACKETS:
        raise BadInput(f"{name}: unknown packet type", expected=" ".join(SERVICE_PACKETS), got=packet)
    return Service(name, packet, int(row["code"]), str(row["purpose"]), _layout(name, row["fields"], enums))


def _check_whole(dictionary: Dictionary) -> None:
    """What only shows across rows: unique names and codes, one-byte codes, preconditions on fields that exist."""
    for where, rows in (
        ("commands", dictionary.commands),
        ("telemetry", dictionary.telemetry),
        ("events", dictionary.events),
    ):
        _unique(where, [r.name for r in rows])
        _unique(f"{where} codes", [r.code for r in rows])
        if any(not 0 <= r.code <= 0xFF for r in rows):
            raise BadInput(f"{where}: codes must fit a byte")
    _unique("services", [(s.packet, s.code) for s in dictionary.services])
    known = {f.name for f in dictionary.packet("housekeeping").values}
    for command in dictionary.commands:
        for p in command.preconditions:
            if p.field not in known:
                raise BadInput(
                    f"{command.name}: precondition on an unknown field", expected="a housekeeping field", got=p.field
                )
