"""Read ``operations.yaml``: the standard operations, quantities and events of an instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import cast

from pydantic import Field, ValidationError

from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.marked_yaml import MarkedYaml, parse_yaml
from gss.instruments.operations import Operation, OperationRow, StandardOperations, check_operation
from gss.instruments.quantities import Strict
from gss.instruments.telemetry_roles import Events, Quantities, check_packet

SHARED = "gss-common"
"""Name of the protocol of the driver ``gss``, which the shipped instruments share."""


class RolesFile(Strict):
    """``operations.yaml``."""

    operations: Mapping[Operation, OperationRow] = Field(default_factory=dict)
    quantities: Quantities = Quantities()
    events: Events = Events()


@dataclass(frozen=True)
class Roles:
    """Operations, quantities and events of an instrument, in standard names."""

    operations: StandardOperations
    quantities: Quantities
    events: Events


def read_roles(file: MarkedYaml, dictionary: Dictionary) -> Roles:
    """Return the roles in a file. Raises BadInput with file, line, field and reason of each error."""
    content = _parsed(file)
    mistakes = _mistakes(content, dictionary)
    if mistakes:
        raise BadInput("\n".join(file.error(place, reason).message for place, reason in mistakes))
    return Roles(StandardOperations(content.operations, dictionary), content.quantities, content.events)


def default_roles(dictionary: Dictionary) -> Roles:
    """Return the roles of an instrument without ``operations.yaml``: the roles of the shared protocol that its
    dictionary supports."""
    content = _parsed(_shared_file())
    wrong = {place for place, _ in _mistakes(content, dictionary)}
    absent = {place[1] for place in wrong if place[0] == "operations"}
    rows = {operation: row for operation, row in content.operations.items() if operation not in absent}
    packets, events = content.quantities.roles(), content.events
    valid_roles = {
        name: role for name, role in packets.items() if not any(p[:2] == ("quantities", name) for p in wrong)
    }
    named = {name: value for name, value in events.model_dump().items() if ("events", name) not in wrong}
    return Roles(StandardOperations(rows, dictionary), Quantities.model_validate(valid_roles), Events(**named))


@lru_cache(maxsize=1)
def _shared_file() -> MarkedYaml:
    name = f"{SHARED}.operations.yaml"
    return parse_yaml(name, resources.files("gss.instruments.dictionary").joinpath(name).read_bytes())


def _parsed(file: MarkedYaml) -> RolesFile:
    if not isinstance(file.content, dict):
        raise file.error((), "the file must be a mapping of names to values")
    try:
        return RolesFile.model_validate(file.content)
    except ValidationError as error:
        reasons = [(e["loc"], e["msg"].removeprefix("Value error, ")) for e in error.errors()[:20]]
    raise BadInput("\n".join(file.error(place, reason).message for place, reason in reasons))


def _mistakes(content: RolesFile, dictionary: Dictionary) -> list[tuple[tuple[str, ...], str]]:
    """Return path and reason of each entry that does not fit the dictionary."""
    mistakes: list[tuple[tuple[str, ...], str]] = []
    for operation, row in content.operations.items():
        mistake = check_operation(operation, row, dictionary)
        if mistake:
            mistakes.append((("operations", operation.value, *mistake[0]), mistake[1]))
    packets = {packet.name: packet for packet in dictionary.telemetry}
    for name in content.quantities.model_fields_set:
        mistake = check_packet(getattr(content.quantities, name), packets)
        if mistake:
            mistakes.append((("quantities", name, *mistake[0]), mistake[1]))
    events = {event.name for event in dictionary.events}
    for name, value in cast(dict[str, str], content.events.model_dump()).items():
        if value and value not in events:
            mistakes.append((("events", name), f"the dictionary has no event {value}"))
    return mistakes
