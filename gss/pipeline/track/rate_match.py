"""Rate match: pairs of predicted and measured stars that are mutual nearest neighbours (Huffman 2006 §5.5.3, §8.1.2).

The rate is assumed constant: the rotation of the last interval predicts the next rotation. The document searches
forward (frame 1's stars in frame 2) and backward; agreement in both directions means mutual nearest neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, lengths
from gss.domain.camera import Camera

Rows = NDArray[np.intp]


def turned(unit_cam: Array, relative: Array, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
    """Return (n, 3) directions rotated by ``relative`` (3, 3), new camera from old, and a mask of the stars still in the frame."""
    moved = np.asarray(unit_cam, float) @ np.asarray(relative).T
    return moved, camera.contains(camera.project(moved))


def mutual_nearest(predicted: Array, measured: Array, radius_rad: float) -> Rows:
    """Return (m, 2) rows (predicted, measured) of (n, 3) directions that are mutual nearest neighbours within ``radius_rad``."""
    if not len(predicted) or not len(measured):
        return np.empty((0, 2), np.intp)
    chord = lengths(predicted[:, None] - measured[None])
    forward, backward = np.argmin(chord, axis=1), np.argmin(chord, axis=0)
    rows = np.arange(len(predicted))
    good = (backward[forward] == rows) & (chord[rows, forward] <= 2 * np.sin(radius_rad / 2))
    return np.column_stack([rows[good], forward[good]])


def rate_match(before: Array, after: Array, relative: Array, camera: Camera, radius_rad: float) -> Rows:
    """Return the (m, 2) matches (star of frame 1, star of frame 2). ``before``, ``after``: (n, 3), (m, 3) directions;
    ``relative``: (3, 3) expected rotation, frame 2 from frame 1."""
    moved, inside = turned(before, relative, camera)
    rows = np.flatnonzero(inside)
    pairs = mutual_nearest(moved[rows], np.asarray(after, float), radius_rad)
    return np.column_stack([rows[pairs[:, 0]], pairs[:, 1]])
