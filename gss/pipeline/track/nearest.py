"""CubeStar's tracking: each centroid is matched with the catalogue star predicted within 0.3° of it (Erlank 2013 §4.5)."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.identify.geometric_voting import Mask, Rows


def match_nearest(unit_cam: Array, predicted_cam: Array, allowed: Mask, radius_rad: float) -> Rows:
    """Return the (n,) catalogue row of each centroid, or −1.

    ``unit_cam``: (n, 3) measured directions; ``predicted_cam``: (m, 3) catalogue directions at the previous attitude.
    The document compares each centroid with every star of the reduced list and considers a match under 0.3°
    unambiguous. If two stars qualify, the nearest is used here.
    """
    row = np.full(len(unit_cam), -1, np.intp)
    rows = np.flatnonzero(allowed)
    if not len(rows) or not len(unit_cam):
        return row
    chord = np.linalg.norm(unit_cam[:, None] - predicted_cam[rows][None], axis=2)
    nearest = np.argmin(chord, axis=1)
    close = chord[np.arange(len(unit_cam)), nearest] <= 2 * np.sin(radius_rad / 2)
    row[close] = rows[nearest[close]]
    return row
