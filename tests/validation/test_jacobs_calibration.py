"""Jacobs' calibration with few images: the errors of both methods are below his 0.24 px and close to those of the
centroids.
"""

from __future__ import annotations

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from validation.entries import ENTRIES
from validation.jacobs.calibration import jacobs_6


def test_position_error_is_below_that_of_the_document() -> None:
    """With eight images, σ_pos of both calibrations is within 15 % of that of the true camera and below 0.24 px, also
    for other images.
    """
    progress: list[float] = []
    experiment = jacobs_6(propagate(load_stars(8.0), 1991.25), 8, 3, progress.append)
    rows = {str(cells[0]): dict(zip(experiment.columns, cells, strict=True)) for cells in experiment.rows}
    assert progress[-1] == 1.0
    for name in ("σ_pos, px", "σ_pos on other images, px"):
        row = rows[name]
        assert float(str(row["true"])) < 0.2
        for method in ("step by step", "self-calibrated"):
            assert float(str(row[method])) < 0.24
            assert float(str(row[method])) < 1.15 * float(str(row["true"])) + 0.01
        assert float(str(row["before"])) > float(str(row["self-calibrated"]))
    assert float(str(rows["σ_mag with a colour term"]["before"])) < 0.25
    assert float(str(rows["images' stars"]["true"])) > 90
    assert "jacobs-6" in ENTRIES
