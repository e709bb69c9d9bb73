"""Services and the API use standard operations and quantities. Only the driver level uses the names of one sensor."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from gss.instruments.dictionary.definitions import TelemetryField
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.operations import ARGUMENTS
from gss.instruments.telemetry_roles import Quantities

ROOT = Path(__file__).parents[2]
ROOMS = ("gss/operations", "gss/api")
DRIVER = {
    "gss/operations/checks/": "the conformance check sends the shared protocol's own packets",
    "gss/operations/contacts/capture_decoder.py": "decodes HELLO as the driver does",
}
"""Files at the driver level, with the reason."""
ALLOWED: dict[str, tuple[set[str], str]] = {
    "gss/operations/telemetry/alarm_text.py": ({"housekeeping"}, "key of a stored alarm, which must not change"),
    "gss/operations/studies/calibration_sheet.py": ({"gain"}, "gain of the camera, not of the sensor's telemetry"),
    "gss/operations/studies/photograph_numbers.py": ({"gain"}, "gain of the camera, not of the sensor's telemetry"),
    "gss/api/present/link.py": ({"frames_good", "frames_bad"}, "counters of the shared protocol's line"),
}
"""Names of the dictionary that a file may still contain, with the reason. Remove a name when its file no longer needs it."""
WORDS = {"memory", "address", "value", "length", "direction", "duration_s", "state"}
"""Plain words that are also names in the dictionary."""


def standard_names() -> set[str]:
    """Names of standard quantities, their packets and standard arguments; services may use these."""
    names = {name for arguments in ARGUMENTS.values() for name in arguments}
    for purpose, field in Quantities.model_fields.items():
        assert isinstance(field.annotation, type)
        names |= {purpose, *vars(field.annotation())}
    return names | {f"quaternion_{axis}" for axis in "xyzw"}


def own_names() -> set[str]:
    """Names of commands, arguments, packets, fields and events in the shared protocol that are not standard names."""
    dictionary = load_dictionary()
    names = {c.name for c in dictionary.commands} | {e.name for e in dictionary.events}
    names |= {a.name for c in dictionary.commands for a in c.arguments}
    for packet in dictionary.telemetry:
        fields = {f.name for f in packet.fields if isinstance(f, TelemetryField)}
        names |= {packet.name, *fields, *(f"{packet.name}.{field}" for field in fields)}
    return names - standard_names() - WORDS


def literals(file: Path) -> Iterator[tuple[int, str]]:
    """Yield line and text of every string in a file that is not a docstring."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    texts = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in texts:
            yield node.lineno, node.value


def files() -> list[str]:
    """Return the files of the packages above the driver level."""
    paths = (path.relative_to(ROOT).as_posix() for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    return sorted(name for name in paths if not name.startswith(tuple(DRIVER)))


def test_no_service_contains_a_sensor_s_own_names() -> None:
    """Above the driver level, no command, packet, field or event of one protocol is named, except the names in the
    list.
    """
    names = own_names()
    violations = [
        f"{name}:{line}: {text}"
        for name in files()
        for line, text in literals(ROOT / name)
        if text in names and text not in ALLOWED.get(name, (set(), ""))[0]
    ]
    assert violations == []


@pytest.mark.parametrize("name", sorted(ALLOWED))
def test_the_list_only_has_what_is_needed(name: str) -> None:
    """Every allowed name occurs in its file, and every entry has a reason."""
    allowed, reason = ALLOWED[name]
    assert reason
    assert allowed <= {text for _, text in literals(ROOT / name)}
