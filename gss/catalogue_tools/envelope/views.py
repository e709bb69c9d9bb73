"""Random views within attitude limits. A direction in a view is visible and needs no exact search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.attitude import AttitudeLimits, euler_123
from gss.catalogue_tools.envelope.field import FieldShape
from gss.domain.angles import Array

ATTITUDES, POINTS = 512, 384
# Fraction by which samples are drawn beyond the limits before they are clipped. As a result, ends and corners of the
# limits occur often.
OVERDRAW = 0.25


@dataclass(frozen=True)
class Views:
    """Views as pairs of direction and boresight. ``direction``: (n, 3) visible directions. ``boresight``: (n, 3). Both
    are in the law's base axes."""

    direction: Array
    boresight: Array

    def __len__(self) -> int:
        return len(self.direction)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Views:
        """Return the selected views."""
        return Views(self.direction[rows], self.boresight[rows])

    @property
    def from_y_rad(self) -> Array:
        """(n,) angles of the directions from base +y."""
        return np.asarray(np.arccos(np.clip(self.direction[:, 1], -1, 1)))


def views_of(shape: FieldShape, limits: AttitudeLimits, seed: int = 0) -> Views:
    """Return all combinations of random attitudes within the limits and points of the field. About a quarter of the
    points are on the field's outline."""
    rng = np.random.default_rng(seed)
    cam_from_base = cams_within(limits, ATTITUDES, seed + 1)
    corners = 4 * np.arange(POINTS // 4) / (POINTS // 4)
    outline = shape.edge(np.concatenate([corners, np.arange(4.0)]))
    # Points on the outline are moved slightly inwards, because rounding could move them out of the field.
    part = np.concatenate([np.full(len(outline), 1 - 1e-9), rng.uniform(0, 1, POINTS - len(outline)) ** 0.5])
    edge = shape.edge(rng.uniform(0, 4, POINTS - len(outline)))
    points = np.concatenate([outline, edge]) * part[:, None] + np.array([0.0, 0.0, 1.0]) * (1 - part[:, None])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    direction = points @ cam_from_base
    return Views(direction.reshape(-1, 3), np.repeat(cam_from_base[:, 2], len(points), axis=0))


def cams_within(limits: AttitudeLimits, count: int, seed: int) -> Array:
    """Return (count, 3, 3) rotations cam_from_base within the limits, including their ends and corners."""
    cube = np.random.default_rng(seed).uniform(-OVERDRAW, 1 + OVERDRAW, (count, 3))
    return np.asarray(limits.cam_from_body @ euler_123(limits.low + (limits.high - limits.low) * np.clip(cube, 0, 1)))
