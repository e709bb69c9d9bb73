"""Tests and sections named in docs/assurance.md, and tests named in docs/hardening.md, exist."""

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


def test_every_test_of_a_finding_exists(root: Path) -> None:
    """Every file and test that docs/hardening.md names exists, and each finding has a commit or is marked as open."""
    text = (root / "docs" / "hardening.md").read_text()
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", text)
    assert len(named) > 60
    for path, name in named:
        source = (root / path).read_text()
        assert not name or re.search(rf"^(?:async )?def {name}\(", source, re.MULTILINE), f"{path}::{name}"
    findings = re.findall(r"^\| ([A-Z]+\d+[a-z]?) \| .+ \| .+ \| (.+) \| .+ \|$", text, re.MULTILINE)
    assert len(findings) > 50
    for number, commit in findings:
        assert re.search(r"\b[0-9a-f]{8}\b|\*\*open\*\*|figures: ", commit), number


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
