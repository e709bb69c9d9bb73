"""The walks drawn in ARCHITECTURE.md lead through code that exists, and stay short."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAX_FILES = {"telemetry": 14, "frame": 14, "command": 12, "catalogue": 12}
STEP = re.compile(r"^\d+\. `([\w./-]+):([\w.]+)`", re.MULTILINE)


def _walks() -> dict[str, list[tuple[str, str]]]:
    """Return the steps (file, function) of each walk by the first word of its heading in lower case."""
    section = (ROOT / "ARCHITECTURE.md").read_text().split("\n## Walks\n")[1].split("\n## ")[0]
    headings = re.split(r"^### (\w+).*$", section, flags=re.MULTILINE)[1:]
    return {name.lower(): STEP.findall(steps) for name, steps in zip(headings[::2], headings[1::2], strict=True)}


WALKS = _walks()


def _names(path: Path) -> set[str]:
    """Return the functions of a file: ``function``, ``Class``, ``Class.method``."""
    if path.suffix != ".py":
        return set(re.findall(r"\b(\w+)\s*\(", path.read_text()))
    tree = ast.parse(path.read_text())
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    methods = {
        f"{c.name}.{f.name}" for c in classes for f in c.body if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    return methods | {
        node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
    }


@pytest.mark.parametrize("walk", sorted(MAX_FILES))
def test_a_walk_is_drawn(walk):
    """The page describes each of the four walks in steps numbered from 1."""
    assert WALKS.get(walk), f"ARCHITECTURE.md, Walks: no steps of {walk}"


@pytest.mark.parametrize(("path", "name"), sorted({step for steps in WALKS.values() for step in steps}))
def test_a_step_exists(path, name):
    """The file of every step exists and defines the function."""
    assert (ROOT / path).is_file(), path
    assert name in _names(ROOT / path), f"{path} does not define {name}"


@pytest.mark.parametrize("walk", sorted(WALKS))
def test_a_walk_is_short(walk):
    """The steps of a walk are in no more files than its limit."""
    files = {path for path, _ in WALKS[walk]}
    assert len(files) <= MAX_FILES[walk], sorted(files)
