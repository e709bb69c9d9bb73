"""Results of the pipeline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.errors import BadInput
from gss.domain.results import Centroids


def test_centroids_have_as_many_rows_as_columns() -> None:
    """The positions are an (n, 2) array. Centroids with another number of rows than of columns are rejected."""
    centroids = Centroids.from_pixels(np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), np.ones(3), 0.2)
    assert centroids.pixels.tolist() == [[1, 2], [3, 4], [5, 6]]
    with pytest.raises(BadInput, match="different numbers of columns and rows"):
        replace(centroids, row_px=np.array([7.0]))
