"""Jacobs' calibration rerun in small: his 0.24 px are beaten both ways, and what is left is the centroids'."""

from __future__ import annotations

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from validation.entries import ENTRIES
from validation.jacobs.calibration import jacobs_6


def test_position_error_is_below_the_documents() -> None:
    """Eight images: both calibrations come within a tenth of the true camera's σ_pos, on other images too, and below 0.24 px;
    magnitudes are as good as the document's."""
    progress: list[float] = []
    made = jacobs_6(propagate(load_stars(8.0), 1991.25), 8, 3, progress.append)
    rows = {str(r[0]): dict(zip(made.columns, r, strict=True)) for r in made.rows}
    assert progress[-1] == 1.0
    for name in ("σ_pos, px", "σ_pos on other images, px"):
        row = rows[name]
        assert float(str(row["true"])) < 0.2
        for way in ("step by step", "self-calibrated"):
            assert float(str(row[way])) < 0.24
            assert float(str(row[way])) < 1.15 * float(str(row["true"])) + 0.01
        assert float(str(row["before"])) > float(str(row["self-calibrated"]))
    assert float(str(rows["σ_mag with a colour term"]["before"])) < 0.25
    assert float(str(rows["images' stars"]["true"])) > 90
    assert "jacobs-6" in ENTRIES
