"""Read ``dictionary.yaml`` and reject invalid content: duplicate codes, defaults out of range, unknown fields."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib import resources
from typing import Any

import yaml

from gss.device.dictionary import (
    Command,
    Conversion,
    Dictionary,
    EventDefinition,
    Group,
    Hazard,
    Item,
    LimitSet,
    Packet,
    Precondition,
    Service,
    TelemetryField,
)
from gss.device.dictionary_items import (
    Enums,
    Row,
    known_keys,
    read_argument,
    read_choices,
    read_item,
    read_items,
    read_layout,
    unique,
)
from gss.domain.errors import BadInput
from gss.domain.limits import PERSISTENCE_MAX, Limits, State

OPERATORS = ("eq", "ne", "lt", "le", "gt", "ge")
SERVICE_PACKETS = ("report", "event", "transfer")


@lru_cache(maxsize=1)
def load_dictionary() -> Dictionary:
    """Return the dictionary of this version."""
    return parse_dictionary(resources.files("gss.device").joinpath("dictionary.yaml").read_text("utf-8"))


def parse_dictionary(text: str) -> Dictionary:
    """Return the dictionary in a YAML text. Raises BadInput naming the invalid row."""
    try:
        content = yaml.load(text, _PlainLoader)  # noqa: S506  # a SafeLoader with fewer features
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BadInput("dictionary is not YAML", got=str(error)[:300] or type(error).__name__) from error
    if not isinstance(content, dict):
        raise BadInput("dictionary is empty", expected="a mapping with commands, telemetry, events, services")
    try:
        return _dictionary(content)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, RecursionError) as error:
        # Missing keys and wrong types are named in the original error's text.
        got = f"{type(error).__name__}: {error}"[:200]
        raise BadInput(
            "a row of the dictionary is not as it must be", expected="its keys and types", got=got
        ) from error


class _PlainLoader(yaml.SafeLoader):
    """YAML loader without aliases, which can expand a few bytes to gigabytes; the dictionary does not need them."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias (*) stands for a value")
        return super().compose_node(parent, index)


def _dictionary(content: Mapping[str, Any]) -> Dictionary:
    known_keys("dictionary", content, "version device_model limit_sets enums commands telemetry events services")
    enums = {name: read_choices(name, rows) for name, rows in content.get("enums", {}).items()}
    dictionary = Dictionary(
        version=int(content["version"]),
        device_model=str(content["device_model"]),
        commands=tuple(_command(row, enums) for row in content["commands"]),
        telemetry=tuple(_packet(row, enums) for row in content["telemetry"]),
        events=tuple(_event(row) for row in content["events"]),
        services=tuple(_service(row, enums) for row in content["services"]),
        hash=content_hash(content),
        limit_sets=tuple(_limit_set(row) for row in content.get("limit_sets", ())),
    )
    _check_whole(dictionary)
    return dictionary


def content_hash(content: Mapping[str, Any]) -> bytes:
    """Return the SHA-256 of the content as JSON with sorted keys; the file's comments and layout do not affect it."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).digest()


def _command(row: Row, enums: Enums) -> Command:
    name = str(row["name"])
    known_keys(
        name,
        row,
        "name code subsystem purpose arguments returns hazard hazard_reason preconditions idempotent role favourite "
        "accept_s complete_s any_dictionary simulator_only",
    )
    hazard = Hazard(row.get("hazard", "none"))
    if hazard is not Hazard.NONE and not row.get("hazard_reason"):
        raise BadInput(f"{name}: a hazard needs its reason")
    arguments = tuple(read_argument(name, r, enums) for r in row.get("arguments", ()))
    unique(name, [a.name for a in arguments])
    return Command(
        name=name,
        code=int(row["code"]),
        subsystem=str(row["subsystem"]),
        purpose=str(row["purpose"]),
        arguments=arguments,
        returns=read_layout(name, row.get("returns", ()), enums),
        hazard=hazard,
        hazard_reason=str(row.get("hazard_reason", "")),
        preconditions=tuple(_precondition(name, r) for r in row.get("preconditions", ())),
        idempotent=bool(row["idempotent"]),
        role=str(row.get("role", "operator")),
        favourite=bool(row.get("favourite", False)),
        accept_s=float(row["accept_s"]),
        complete_s=float(row["complete_s"]),
        any_dictionary=bool(row.get("any_dictionary", False)),
        simulator_only=bool(row.get("simulator_only", False)),
    )


def _precondition(where: str, row: Row) -> Precondition:
    known_keys(where, row, "field op value text")
    if row["op"] not in OPERATORS:
        raise BadInput(f"{where}: unknown operator", expected=" ".join(OPERATORS), got=str(row["op"]))
    return Precondition(str(row["field"]), str(row["op"]), row["value"], str(row["text"]))


def _packet(row: Row, enums: Enums) -> Packet:
    name = str(row["name"])
    known_keys(name, row, "name code purpose fields stale_after_s simulator_only")
    stale_after_s = float(row["stale_after_s"])
    fields: list[Item | Group] = []
    for entry in row["fields"]:
        if "list" in entry:
            fields.append(Group(str(entry["name"]), read_items(f"{name}.{entry['name']}", entry["list"], enums)))
        else:
            fields.append(_field(name, entry, enums, stale_after_s))
    unique(name, [f.name for f in fields])
    return Packet(
        name, int(row["code"]), str(row["purpose"]), tuple(fields), stale_after_s, bool(row.get("simulator_only"))
    )


def _field(where: str, row: Row, enums: Enums, stale_after_s: float) -> TelemetryField:
    known_keys(
        f"{where}.{row.get('name')}",
        row,
        "name type enum unit purpose title page decimals conversion watch warning critical stale_after_s persistence sets",
    )
    return TelemetryField(
        **read_item(where, row, enums),
        title=str(row.get("title", row["name"])),
        page=str(row.get("page", "")),
        decimals=int(row.get("decimals", 0)),
        conversion=_conversion(f"{where}.{row['name']}", row.get("conversion", {})),
        limits=_limits(f"{where}.{row['name']}", row),
        persistence=_persistence(f"{where}.{row['name']}", row.get("persistence", 1)),
        sets={str(name): _limit_row(f"{where}.{row['name']}", limits) for name, limits in row.get("sets", {}).items()},
        stale_after_s=float(row.get("stale_after_s", stale_after_s)),
    )


def _limits(where: str, row: Row) -> Limits:
    """Return the limits in a row. Raises BadInput if one reaches beyond a more severe one."""
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
        raise BadInput(f"{where}: persistence counts samples", expected=f"1 – {PERSISTENCE_MAX}", got=str(value))
    return value


def _limit_set(row: Row) -> LimitSet:
    known_keys("limit set", row, "name note")
    return LimitSet(str(row["name"]), str(row.get("note", "")))


def _pair(where: str, value: Sequence[float | None]) -> tuple[float | None, float | None]:
    low, high = value
    if low is not None and high is not None and low > high:
        raise BadInput(f"{where}: limits are crossed", got=f"{low} > {high}")
    return low, high


def _conversion(where: str, row: Row) -> Conversion:
    """Return the conversion ``{linear: [scale, offset]}`` or ``{polynomial: [c0, c1, …]}``; no other expression is evaluated."""
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
    known_keys(str(row["name"]), row, "name code severity purpose")
    return EventDefinition(str(row["name"]), int(row["code"]), State(row["severity"]).value, str(row["purpose"]))


def _service(row: Row, enums: Enums) -> Service:
    name, packet = str(row["name"]), str(row["packet"])
    known_keys(name, row, "name packet code purpose fields")
    if packet not in SERVICE_PACKETS:
        raise BadInput(f"{name}: unknown packet type", expected=" ".join(SERVICE_PACKETS), got=packet)
    return Service(name, packet, int(row["code"]), str(row["purpose"]), read_layout(name, row["fields"], enums))


def _check_whole(dictionary: Dictionary) -> None:
    """Check rules across rows: unique names and codes, one-byte codes, limit sets and precondition fields that exist."""
    for where, rows in (
        ("commands", dictionary.commands),
        ("telemetry", dictionary.telemetry),
        ("events", dictionary.events),
    ):
        unique(where, [r.name for r in rows])
        unique(f"{where} codes", [r.code for r in rows])
        if any(not 0 <= r.code <= 0xFF for r in rows):
            raise BadInput(f"{where}: codes must fit a byte")
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
    known = {f.name for f in dictionary.packet("housekeeping").values}
    for command in dictionary.commands:
        for p in command.preconditions:
            if p.field not in known:
                raise BadInput(
                    f"{command.name}: precondition on an unknown field", expected="a housekeeping field", got=p.field
                )
