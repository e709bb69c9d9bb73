"""Performance sheet of a camera on paper."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.cli import main
from gss.instruments.registry import shipped_camera
from gss.operations.catalogues.design import DesignQuestion
from gss.operations.studies.analyse import AnalysisResult
from gss.operations.studies.design_performance import sheet_file, sheet_of_design

STARS = load_stars()
SUNSAT = DesignCamera.from_profile(shipped_camera("sunsat"))
FOLLOW = ["pixel", "temporal-noise", "acquisition", "tracking", "end-of-life"]
KEYS = [
    "bias",
    "thermo-elastic",
    "field-of-view",
    "pixel",
    "temporal-noise",
    "aberration",
    "date",
    "acquisition",
    "tracking",
    "end-of-life",
    "robustness",
]


def sheet(**changes: Any) -> AnalysisResult:
    """Return the sheet of Sunsat's camera with changes."""
    return sheet_of_design(DesignQuestion(profile="sunsat", **changes), SUNSAT, STARS)


def value(result: AnalysisResult, row: str, name: str) -> float:
    """Return a figure of a sheet in user units."""
    [values] = [r for r in result.figures["rows"] if r["key"] == row]
    return float(next(f["value"] for f in values["figures"] if f["name"] == name))


def test_a_design_gives_the_rows_that_follow_from_it() -> None:
    """The sheet has all rows in the order of the sheet of a unit. The rows that a design does not determine state what they
    need, and every interval contains its value."""
    figures = sheet().figures
    assert [r["key"] for r in figures["rows"]] == KEYS
    assert [r["key"] for r in figures["rows"] if r["measured"]] == FOLLOW
    assert all(r["needs"] for r in figures["rows"] if not r["measured"])
    for row in figures["rows"]:
        for f in row["figures"]:
            assert f["low"] is None or f["low"] <= f["value"] <= f["high"]
    assert (figures["source"], figures["chain"]) == ("design", "")


def test_the_sheet_follows_the_changes_of_the_camera() -> None:
    """A wider star image has a smaller error within the pixel, a longer exposure smears at a lower rate, less light leaves
    fewer fields with enough stars, and an aged camera has more noise."""
    plain, wide, long = sheet(psf_sigma_px=0.5), sheet(psf_sigma_px=0.8), sheet(exposure_s=2 * SUNSAT.exposure_s)
    assert value(wide, "pixel", "one star, periodic") < 0.2 * value(plain, "pixel", "one star, periodic")
    rate = "rate that costs half a magnitude"
    assert value(long, "tracking", rate) == pytest.approx(value(sheet(), "tracking", rate) / 2)
    few = "at least 3 stars"
    assert value(sheet(transmission=0.02), "acquisition", few) < value(sheet(), "acquisition", few) - 5
    aged = value(sheet(), "end-of-life", "transmission −20 %: noise across")
    assert aged > value(sheet(), "temporal-noise", "x, y (rms of both)")


def test_a_camera_without_stars_has_a_sheet() -> None:
    """A camera that detects no star has a sheet: no field has enough stars, and the noise states what it needs."""
    figures = sheet(mag_limit=-1.4).figures
    rows = {r["key"]: r for r in figures["rows"]}
    assert rows["acquisition"]["figures"][0]["value"] == 0
    assert "at least 3 stars" in rows["temporal-noise"]["needs"]


def test_the_sheet_is_written_in_the_forms_of_every_sheet(tmp_path: Path) -> None:
    """PDF, page and JSON are those of the sheet of a unit. ``gss design --sheet`` writes the same content."""
    created = datetime(2026, 1, 1, tzinfo=UTC)
    assert sheet_file(sheet(), "pdf", created).startswith(b"%PDF")
    assert b"Performance sheet: sunsat (design)" in sheet_file(sheet(), "html", created)
    path = tmp_path / "sheet.json"
    assert main(["design", "--profile", "sunsat", "--quick", "--sheet", str(path)]) == 0
    assert json.loads(path.read_text()) == json.loads(sheet_file(sheet(), "json", created))
    with pytest.raises(SystemExit):
        main(["design", "--profile", "sunsat", "--sheet", "sheet.txt"])
