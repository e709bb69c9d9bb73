"""A class name occurs once in gss and validation, so that it identifies one class.

``gss.client`` is excluded: it is a separate package for scripts, and its records have the names of the server's
records.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path


def defined(root: Path) -> Iterator[tuple[str, str]]:
    """Yield name and ``path:line`` of each public class at the top level of a module."""
    for room in ("gss", "validation"):
        for path in sorted(set((root / room).rglob("*.py")) - set((root / "gss" / "client").rglob("*.py"))):
            for node in ast.parse(path.read_text("utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    yield node.name, f"{path.relative_to(root)}:{node.lineno}"


def test_class_names_are_unique(root: Path) -> None:
    """Two classes do not share a name."""
    places: dict[str, list[str]] = defaultdict(list)
    for name, place in defined(root):
        places[name].append(place)
    shared = {name: where for name, where in places.items() if len(where) > 1}
    assert not shared, "\n".join(f"{name}: {', '.join(where)}" for name, where in shared.items())
