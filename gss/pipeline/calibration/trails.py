"""Length of star trails in an exposure, measured from the shapes of the stars. The centroids can be from any source."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.results import Centroids
from gss.pipeline.psf import adaptive_shapes, cut_stamps

BRIGHTEST = 30
FEWEST = 4
HALF_PX = 11
START_SIGMA_PX = 1.5
TOGETHER = 0.7
MIN_PX = 1.5


def trail_px(image: NDArray[Any], centroids: Centroids, saturation_dn: float = float("inf")) -> float:
    """Return the length of the trails of a frame in px, accurate to about a quarter; 0 for round stars.

    If a star moves uniformly over the length L, its variance along the motion exceeds its variance across the motion by
    L²/12. If the camera moves, all stars are elongated in nearly the same direction. The result is 0 if the directions
    differ (coma, double stars, rotation about the boresight), or if fewer than four stars can be measured.
    """
    pick = np.argsort(-np.nan_to_num(centroids.flux_dn), kind="stable")[:BRIGHTEST]
    col, row = (np.rint(v[pick]).astype(np.intp) for v in (centroids.col_px, centroids.row_px))
    if len(pick) < FEWEST:
        return 0.0
    stamps = cut_stamps(image, col, row, np.zeros(len(pick)), HALF_PX, saturation_dn)
    ring = np.maximum(np.abs(stamps.dx), np.abs(stamps.dy)) > HALF_PX - 2
    sky = np.array(
        [
            float(np.median(v[ring & u])) if (ring & u).any() else np.nan
            for v, u in zip(stamps.value, stamps.use, strict=True)
        ]
    )
    complete = np.isfinite(sky) & stamps.use.all(axis=1)
    if complete.sum() < FEWEST:
        return 0.0
    stamps = cut_stamps(image, col[complete], row[complete], sky[complete], HALF_PX, saturation_dn)
    shapes = adaptive_shapes(stamps, START_SIGMA_PX)
    if shapes.good.sum() < FEWEST:
        return 0.0
    moments = shapes.covariance[shapes.good]
    # The angle is doubled because opposite directions of a trail are equivalent.
    along = (moments[:, 0, 0] - moments[:, 1, 1]) + 2j * moments[:, 0, 1]
    together = abs(np.mean(along / np.maximum(np.abs(along), 1e-12)))
    length = float(np.sqrt(12 * np.median(np.abs(along))))
    return length if together > TOGETHER and length > MIN_PX else 0.0
