"""Differences between the files of two packages."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import unified_diff

from gss.instruments.package_source import Files


@dataclass(frozen=True)
class FileDifference:
    """Changed lines of one file in unified diff format. ``state``: added, removed or changed."""

    file: str
    state: str
    lines: tuple[str, ...]


def compare(old: Files, new: Files, old_name: str = "old", new_name: str = "new") -> tuple[FileDifference, ...]:
    """Return the files that differ, sorted by name. Files with equal texts are omitted."""
    differences = []
    for file in sorted({*old, *new}):
        before, after = (files.get(file, b"").decode("utf-8", "replace").splitlines() for files in (old, new))
        lines = unified_diff(before, after, f"{old_name}/{file}", f"{new_name}/{file}", lineterm="", n=1)
        state = "added" if file not in old else "removed" if file not in new else "changed"
        if shown := tuple(lines):
            differences.append(FileDifference(file, state, shown))
    return tuple(differences)
