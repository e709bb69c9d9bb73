"""``gss design`` on the terminal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gss.cli import main


def test_figures_are_printed_with_units_sources_and_the_papers(capsys: pytest.CaptureFixture[str]) -> None:
    """The output names the changed fields, the limit of the paper, sources, units and cameras."""
    assert main(["design", "--profile", "sunsat", "--quick", "--focal-mm", "35", "--f-number", "2"]) == 0
    out = capsys.readouterr().out
    assert "focal_mm 35, f_number 2" in out
    assert "paper 6 (Jacobs 1995 §6.3)" in out
    for words in ("Huffman 2006 eq. 3.18", "Moniteq 1983 §5.2", "cubestar", "e/s", "°/s"):
        assert words in out


def test_json_and_page_come_from_one_run(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """One run prints a JSON object and writes the page. An inclination limits the sky to the orbit."""
    page = tmp_path / "design.html"
    command = ["design", "--profile", "far_mst", "--quick", "--json", "--html", str(page), "--inclination-deg", "97"]
    command += ["--roll-deg", "-5:5"]
    assert main(command) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["profile"] == "far_mst"
    assert record["sky"] == "along the orbit"
    assert page.read_text("utf-8").startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--focal-mm", "0"], "focal_mm is out of range. Expected 1 to 2000 mm; got 0 mm"),
        (["--profile", "hubble"], "Unknown instrument"),
        (["--f-number", "32", "--exposure-s", "0.0001"], "detects no star"),
        (["--roll-deg", "-5:5"], "--roll-deg needs an orbit. Expected --inclination-deg"),
        (["--pointing", "nadir"], "--pointing needs an orbit"),
        (["--seed", "-1"], "Seed is out of range. Expected greater than or equal to 0; got -1"),
    ],
)
def test_impossible_cameras_end_with_a_sentence(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """An impossible camera gives exit code 2 and a message on standard error."""
    assert main(["design", "--quick", *arguments]) == 2
    assert words.lower() in capsys.readouterr().err.lower()
