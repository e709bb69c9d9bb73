"""Read ``dictionary.yaml`` and reject invalid content: duplicate codes, defaults out of range, unknown fields."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from importlib import resources
from typing import Any, TypeVar, cast

from gss.domain.errors import BadInput, NotFound
from gss.domain.limits import PERSISTENCE_MAX, Limits, State
from gss.instruments.dictionary.definitions import (
    CommandDefinition,
    Conversion,
    Dictionary,
    EventDefinition,
    Group,
    Hazard,
    Item,
    LimitSet,
    PacketDefinition,
    Service,
    TelemetryField,
)
from gss.instruments.dictionary.read_items import (
    Enums,
    Row,
    finite,
    known_keys,
    read_argument,
    read_choices,
    read_flag,
    read_group,
    read_item,
    read_layout,
    read_name,
    read_precondition,
    unique,
)
from gss.instruments.marked_yaml import MarkedYaml, parse_yaml

SERVICE_PACKETS = ("report", "event", "transfer")
SECTIONS = ("version", "device_model", "commands", "telemetry", "events", "services")
DESCRIPTIVE = (
    "purpose",
    "action",
    "note",
    "title",
    "text",
    "hazard_reason",
    "page",
    "subsystem",
    "favourite",
    "decimals",
)
DESCRIPTIONS = frozenset((*DESCRIPTIVE, "same_layout_as"))
"""Keys that describe a row for users and have no effect on the bytes on the line."""
NAME_MAPS = ("enums", "sets")
"""Keys whose value is a map from names to rows."""
NAME = re.compile(r"[a-z][a-z0-9-]{0,39}")
WRONG_ROW = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError, NotFound)
T = TypeVar("T")


@lru_cache(maxsize=1)
def load_dictionary() -> Dictionary:
    """Return the shared dictionary of the shipped instruments."""
    return shared_dictionary("gss-common")


@lru_cache(maxsize=8)
def shared_dictionary(name: str) -> Dictionary:
    """Return a shared dictionary by its name. Raises NotFound."""
    file = resources.files("gss.instruments.dictionary").joinpath(f"{name}.yaml")
    if not NAME.fullmatch(name) or not file.is_file():
        raise NotFound(
            "unknown shared dictionary", expected="gss-common, or a dictionary.yaml in the package", got=name
        )
    return read_dictionary(f"{name}.yaml", file.read_bytes())


def parse_dictionary(text: str) -> Dictionary:
    """Return the dictionary in a YAML text. Raises BadInput naming line and row."""
    return read_dictionary("dictionary.yaml", text.encode())


def read_dictionary(name: str, data: bytes) -> Dictionary:
    """Return the dictionary in a file. Raises BadInput naming file, line and row."""
    file = parse_yaml(name, data)
    if not isinstance(file.content, dict):
        raise file.error((), "the dictionary is empty; it needs commands, telemetry, events, services")
    return read_content(file)


def read_content(file: MarkedYaml, content_hash: bytes | None = None) -> Dictionary:
    """Return the dictionary from the rows of a file. ``content_hash``: its hash; None computes the hash of the rows.
    Raises BadInput naming file, line and row."""
    content = cast(Mapping[str, Any], file.content)
    try:
        return _dictionary(file, content, content_hash)
    except WRONG_ROW as error:
        raise _placed(file, (), error) from error


def _rows(file: MarkedYaml, content: Mapping[str, Any], section: str, read: Callable[[Row], T]) -> tuple[T, ...]:
    """Return the rows of a section, read one at a time. Raises BadInput naming the line of the row."""
    rows: list[T] = []
    for index, row in enumerate(content.get(section, ())):
        try:
            rows.append(read(row))
        except (BadInput, *WRONG_ROW) as error:
            raise _placed(file, (section, index), error) from error
    return tuple(rows)


def _placed(file: MarkedYaml, path: tuple[str | int, ...], error: Exception) -> BadInput:
    """Return the error of a row with file and line. The text of a KeyError or TypeError names the missing key or
    type."""
    if isinstance(error, BadInput):
        return BadInput(f"{file.name}, line {file.line(path)}: {error.message}", expected=error.expected, got=error.got)
    return BadInput(
        f"{file.name}, line {file.line(path)}: a key is missing from a row, or a value has the wrong type",
        expected="the keys and types of this row",
        got=f"{type(error).__name__}: {error}"[:200],
    )


def _dictionary(file: MarkedYaml, content: Mapping[str, Any], content_hash: bytes | None) -> Dictionary:
    optional = ("same_layout_as", "limit_sets", "enums")
    known_keys("dictionary", content, " ".join((*SECTIONS, *optional)))
    enums = {name: read_choices(name, rows) for name, rows in content.get("enums", {}).items()}
    missing = [section for section in SECTIONS if section not in content]
    if missing:
        raise file.error((), f"missing: {', '.join(missing)}")
    telemetry = _rows(file, content, "telemetry", lambda row: _packet(row, enums))
    conditions = {f.name: f for p in telemetry if p.name == "housekeeping" for f in p.values}
    dictionary = Dictionary(
        version=int(content["version"]),
        device_model=str(content["device_model"]),
        commands=_rows(file, content, "commands", lambda row: _command(row, enums, conditions)),
        telemetry=telemetry,
        events=_rows(file, content, "events", _event),
        services=_rows(file, content, "services", lambda row: _service(row, enums)),
        hash=content_hash if content_hash is not None else layout_hash(content),
        same_layout_as=frozenset(bytes.fromhex(str(text)) for text in content.get("same_layout_as", ())),
        limit_sets=_rows(file, content, "limit_sets", _limit_set),
    )
    try:
        _check_across_rows(dictionary)
    except BadInput as error:
        raise _placed(file, (), error) from error
    return dictionary


def layout_hash(content: Mapping[str, Any]) -> bytes:
    """Return the SHA-256 of the content without descriptions, as JSON with sorted keys.

    Descriptions, comments and formatting do not affect the hash, so a reworded purpose needs no new firmware.
    """
    return hashlib.sha256(json.dumps(_layout(content), sort_keys=True, separators=(",", ":")).encode()).digest()


def _layout(content: Any, *, names: bool = False) -> Any:
    """Return rows without descriptions. ``names``: the keys of the content are names, not the keys of a row."""
    if isinstance(content, Mapping):
        return {
            key: _layout(value, names=key in NAME_MAPS and not names)
            for key, value in content.items()
            if names or key not in DESCRIPTIONS
        }
    return [_layout(value) for value in content] if isinstance(content, list) else content


def _command(row: Row, enums: Enums, conditions: Mapping[str, Item]) -> CommandDefinition:
    name = read_name("command", row)
    known_keys(
        name,
        row,
        "name code subsystem purpose arguments returns hazard hazard_reason preconditions idempotent role favourite "
        "accept_s complete_s any_dictionary simulator_only",
    )
    hazard = Hazard(row.get("hazard", "none"))
    if hazard is not Hazard.NONE and not row.get("hazard_reason"):
        raise BadInput(f"{name}: a hazard needs a hazard_reason")
    arguments = tuple(read_argument(name, r, enums) for r in row.get("arguments", ()))
    unique(name, [a.name for a in arguments])
    return CommandDefinition(
        name=name,
        code=int(row["code"]),
        subsystem=str(row["subsystem"]),
        purpose=str(row["purpose"]),
        arguments=arguments,
        returns=read_layout(name, row.get("returns", ()), enums),
        hazard=hazard,
        hazard_reason=str(row.get("hazard_reason", "")),
        preconditions=tuple(read_precondition(name, r, conditions) for r in row.get("preconditions", ())),
        idempotent=read_flag(name, row, "idempotent"),
        role=str(row.get("role", "operator")),
        favourite=read_flag(name, row, "favourite", False),
        accept_s=_timeout(name, row, "accept_s"),
        complete_s=_timeout(name, row, "complete_s"),
        any_dictionary=read_flag(name, row, "any_dictionary", False),
        simulator_only=read_flag(name, row, "simulator_only", False),
    )


def _timeout(where: str, row: Row, key: str) -> float:
    if finite(f"{where}.{key}", row[key]) <= 0:
        raise BadInput(f"{where}: {key} is not above 0", got=str(row[key]))
    return float(row[key])


def _packet(row: Row, enums: Enums) -> PacketDefinition:
    name = read_name("packet", row)
    known_keys(name, row, "name code purpose fields stale_after_s simulator_only")
    stale_after_s = float(finite(f"{name}.stale_after_s", row["stale_after_s"]))
    fields: list[Item | Group] = []
    for entry in row["fields"]:
        if "list" in entry:
            fields.append(read_group(name, entry, enums))
        else:
            fields.append(_field(name, entry, enums, stale_after_s))
    unique(name, [f.name for f in fields])
    return PacketDefinition(
        name,
        int(row["code"]),
        str(row["purpose"]),
        tuple(fields),
        stale_after_s,
        read_flag(name, row, "simulator_only", False),
    )


def _field(where: str, row: Row, enums: Enums, stale_after_s: float) -> TelemetryField:
    read_name("field", row, where)
    known_keys(
        f"{where}.{row.get('name')}",
        row,
        "name type enum unit purpose title page decimals conversion watch warning critical stale_after_s persistence sets valid "
        "action",
    )
    return TelemetryField(
        **read_item(where, row, enums),
        title=str(row.get("title", row["name"])),
        page=str(row.get("page", "")),
        decimals=int(row.get("decimals", 0)),
        conversion=_conversion(f"{where}.{row['name']}", row.get("conversion", {})),
        limits=_limits(f"{where}.{row['name']}", row),
        persistence=_persistence(f"{where}.{row['name']}", row.get("persistence", 1)),
        valid=_valid(f"{where}.{row['name']}", row["valid"]) if "valid" in row else None,
        sets={str(name): _limit_row(f"{where}.{row['name']}", limits) for name, limits in row.get("sets", {}).items()},
        stale_after_s=float(finite(f"{where}.{row['name']}", row.get("stale_after_s", stale_after_s))),
        action=str(row.get("action", "")),
    )


def _limits(where: str, row: Row) -> Limits:
    """Return the limits in a row. Raises BadInput if a limit lies outside a more severe limit."""
    limits = Limits(**{s.value: _pair(where, row[s.value]) for s in list(State)[1:] if s.value in row})
    try:
        return limits.checked()
    except BadInput as error:
        raise BadInput(f"{where}: {error.message}", expected=error.expected, got=error.got) from None


def _limit_row(where: str, row: Row) -> Limits:
    known_keys(f"{where}.sets", row, "watch warning critical")
    return _limits(where, row)


def _persistence(where: str, value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= PERSISTENCE_MAX:
        raise BadInput(f"{where}: persistence is out of range", expected=f"1 – {PERSISTENCE_MAX}", got=str(value))
    return value


def _limit_set(row: Row) -> LimitSet:
    known_keys("limit set", row, "name note")
    return LimitSet(read_name("limit set", row), str(row.get("note", "")))


def _pair(where: str, value: Sequence[float | None]) -> tuple[float | None, float | None]:
    low, high = (None if bound is None else finite(where, bound) for bound in value)
    if low is not None and high is not None and low > high:
        raise BadInput(f"{where}: the lower limit is above the upper limit", got=f"{low} > {high}")
    return low, high


def _valid(where: str, value: Sequence[float]) -> tuple[float, float]:
    low, high = (float(finite(where, bound)) for bound in value)
    if not low <= high:
        raise BadInput(f"{where}: the start of the valid range is above its end", got=f"{low:g} > {high:g}")
    return low, high


def _conversion(where: str, row: Row) -> Conversion:
    """Return the conversion ``{linear: [scale, offset]}`` or ``{polynomial: [c0, c1, …]}``. No other expressions are
    supported."""
    if not row:
        return Conversion()
    if set(row) == {"linear"} and len(row["linear"]) == 2:
        scale, offset = (float(finite(where, number)) for number in row["linear"])
        return Conversion((offset, scale))
    if set(row) == {"polynomial"} and row["polynomial"]:
        return Conversion(tuple(float(finite(where, number)) for number in row["polynomial"]))
    raise BadInput(
        f"{where}: unknown conversion", expected="linear: [scale, offset] or polynomial: [c0, …]", got=str(row)
    )


def _event(row: Row) -> EventDefinition:
    known_keys(str(row["name"]), row, "name code severity purpose action")
    severity, action = State(row["severity"]).value, str(row.get("action", ""))
    return EventDefinition(str(row["name"]), int(row["code"]), severity, str(row["purpose"]), action)


def _service(row: Row, enums: Enums) -> Service:
    name, packet = str(row["name"]), str(row["packet"])
    known_keys(name, row, "name packet code purpose fields")
    if packet not in SERVICE_PACKETS:
        raise BadInput(f"{name}: unknown packet type", expected=" ".join(SERVICE_PACKETS), got=packet)
    return Service(name, packet, int(row["code"]), str(row["purpose"]), read_layout(name, row["fields"], enums))


def _check_across_rows(dictionary: Dictionary) -> None:
    """Check rules across rows: unique names and codes, codes of one byte, existing limit sets."""
    for where, rows in (
        ("commands", dictionary.commands),
        ("telemetry", dictionary.telemetry),
        ("events", dictionary.events),
    ):
        unique(where, [r.name for r in rows])
        unique(f"{where} codes", [r.code for r in rows])
        if any(not 0 <= r.code <= 0xFF for r in rows):
            raise BadInput(f"{where}: codes must fit in one byte")
    unique("services", [(s.packet, s.code) for s in dictionary.services])
    unique("limit sets", [s.name for s in dictionary.limit_sets])
    sets = {s.name for s in dictionary.limit_sets}
    for packet in dictionary.telemetry:
        for value in packet.values:
            if not set(value.sets) <= sets:
                raise BadInput(
                    f"{packet.name}.{value.name}: unknown limit set",
                    expected=", ".join(sorted(sets)),
                    got=", ".join(sorted(set(value.sets) - sets)),
                )
