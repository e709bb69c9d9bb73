"""Tests and sections named in docs/assurance.md, docs/hardening.md and docs/console-findings.md exist."""

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


def test_every_finding_of_the_console_names_its_test(root: Path) -> None:
    """Each row of docs/console-findings.md names existing tests, or states that there is none."""
    text = (root / "docs" / "console-findings.md").read_text()
    findings = re.findall(r"^\| ([BMmI]\d+) \| .+ \| .+ \| (.+) \|$", text, re.MULTILINE)
    assert [number[0] for number, _ in findings].count("M") == 16
    assert len({number for number, _ in findings}) == len(findings) > 45
    for number, shown in findings:
        named = re.findall(r"`((?:tests|web)/[\w/.]+?\.(py|ts))(?:::([^`]+))?`", shown)
        assert named or shown == "No test", number
        for path, kind, name in named:
            source = (root / path).read_text()
            line = rf"^(?:async )?def {name}\(" if kind == "py" else rf"(?:it|test)\(['\"]{re.escape(name)}['\"]"
            assert not name or re.search(line, source, re.MULTILINE), f"{path}::{name}"


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
