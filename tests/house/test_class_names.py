"""A class name occurs once in gss and validation, so that a reader knows which class is meant. ``gss.client`` is left out: it
stands alone, and its records have the names of what the server stores."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ALLOWED: dict[str, str] = {
    "Alarm": "the open condition of a service and its row",
    "Analysis": "a finished analysis and its row",
    "Answer": "response headers and a reply to a device check: rename one",
    "Base": "the rooms' first stage and the base of the rows: rename one",
    "Check": "check of a command and health check: rename one",
    "ChoiceOut": "schemas of commands and telemetry: merge them",
    "ClockOut": "schemas of schedule and upkeep: rename one",
    "Outcome": "outcome of a chain and its column in the store: rename one",
    "Picture": "part of a report and decoded frame: rename one",
    "Report": "reports of checks, of studies and of the store: rename two",
    "Run": "a job's run and an analysis' run: rename one",
    "Sample": "samples of gaps and of metrics: rename one",
    "Series": "plotted series and archived series: rename one",
    "SeriesOut": "schemas of reports and telemetry: rename one",
    "Stage": "stage of a command and stage of a replay: rename one",
    "Stretch": "contrast stretch and period of rollups: rename one",
    "Turns": "turns of hashing and of parsing: rename one",
    "Verdict": "verdicts on results, audit chains and replays: rename two",
}
"""Names of several classes, with the reason. Only shrinks: rename a class instead of adding a line."""
SLACK = 3
"""Lines that may be obsolete, because changes land at the same time."""


def defined(root: Path) -> Iterator[tuple[str, str]]:
    """Yield name and ``path:line`` of each public class at the top level of a module."""
    for room in ("gss", "validation"):
        for path in sorted(set((root / room).rglob("*.py")) - set((root / "gss" / "client").rglob("*.py"))):
            for node in ast.parse(path.read_text("utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    yield node.name, f"{path.relative_to(root)}:{node.lineno}"


def test_class_names_are_unique(root: Path) -> None:
    """Two classes do not share a name, except those of the allow-list."""
    places: dict[str, list[str]] = defaultdict(list)
    for name, place in defined(root):
        places[name].append(place)
    shared = {name: where for name, where in places.items() if len(where) > 1}
    unexpected = {name: where for name, where in shared.items() if name not in ALLOWED}
    assert not unexpected, "\n".join(f"{name}: {', '.join(where)}" for name, where in unexpected.items())
    assert len(set(ALLOWED) - set(shared)) <= SLACK, "remove the names that only one class has from the allow-list"
    assert all(ALLOWED.values())
