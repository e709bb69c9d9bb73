"""Tests and sections named in docs/assurance.md exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROW = re.compile(r"^\| ([A-Z]\d+) \| (.+?) \| (.+) \|$", re.MULTILINE)


@pytest.fixture(scope="module")
def rows(root: Path) -> list[tuple[str, str, str]]:
    """Return number, promise and evidence of each row."""
    return ROW.findall((root / "docs" / "assurance.md").read_text())


def test_every_test_that_is_named_exists(root: Path, rows: list[tuple[str, str, str]]) -> None:
    """Every test that the page names exists under that path and name."""
    named = [test for _, _, shown in rows for test in re.findall(r"`([\w/]+\.py)::(\w+)`", shown)]
    assert len(named) > 100
    for path, name in named:
        assert re.search(rf"^(?:async )?def {name}\(", (root / path).read_text(), re.MULTILINE), f"{path}::{name}"


def test_every_promise_names_its_evidence_or_states_that_there_is_none(
    root: Path, rows: list[tuple[str, str, str]]
) -> None:
    """Numbers are unique; a row names a test, a section of the figures, or *not shown* with a reason."""
    assert len({number for number, _, _ in rows}) == len(rows) > 40
    sections = set(re.findall(r"^## (.+)$", (root / "docs" / "benchmarks.md").read_text(), re.MULTILINE))
    for number, _, shown in rows:
        assert "::" in shown or "figures: " in shown or re.search(r"\*\*not shown\*\*: \w", shown), number
        for section in re.findall(r"figures: benchmarks\.md: ([^<|]+?)(?:<br>|$)", shown):
            assert section.strip() in sections, section
