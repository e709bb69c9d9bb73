"""Files have at most 350 lines. A file that is one table may be longer, with a reason stated here."""

from __future__ import annotations

from pathlib import Path

MAX_LINES = 350
LONGER = {
    "gss/device/clauses.py": "one table: the clauses of the interface",
}
FOLDERS = ("gss", "validation", "tools", "web/src")
KINDS = (".py", ".ts", ".svelte")
MADE = ("gss/web/", "web/src/api/generated/")
"""Folders with build output."""


def test_files_are_short(root: Path) -> None:
    """No file exceeds the limit, and every exception is still needed."""
    long = set()
    for folder in FOLDERS:
        for path in (root / folder).rglob("*.*"):
            name = path.relative_to(root).as_posix()
            if path.suffix in KINDS and not name.startswith(MADE) and path.read_text("utf-8").count("\n") > MAX_LINES:
                long.add(name)
    assert long == set(LONGER), (
        f"split along a natural seam: {sorted(long - set(LONGER))}; not long: {set(LONGER) - long}"
    )
