"""The benchmark program runs. No test depends on measured values."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def _bench(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tools.bench", "--quick", *arguments]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=100)


def test_a_section_becomes_a_document_with_its_conditions(root: Path) -> None:
    """The JSON document has machine, seeds, conditions and rows of numbers.

    The tables are also written to standard error.
    """
    result = _bench(root, "--json", "packets", "render")
    assert result.returncode == 0, result.stderr
    report: dict[str, Any] = json.loads(result.stdout)
    assert report["quick"] is True
    assert report["threads"] == 1
    assert report["machine"].keys() >= {"processor", "cores", "python", "packages", "load_average"}
    assert {table["section"] for table in report["tables"]} == {"packets", "render"}
    for table in report["tables"]:
        assert table["conditions"]
        assert isinstance(table["seed"], int)
        assert table["title"] in result.stderr
        for row in table["rows"]:
            figures = {name: value for name, value in row.items() if name != "what"}
            assert figures
            assert all(isinstance(value, int | float) and value > 0 for value in figures.values())


def test_an_unknown_section_is_named(root: Path) -> None:
    """An unknown section gives no traceback; the message names it and lists the known sections."""
    result = _bench(root, "weather")
    assert result.returncode == 2
    assert "weather" in result.stderr
    assert "lost_in_space" in result.stderr
    assert "Traceback" not in result.stderr
