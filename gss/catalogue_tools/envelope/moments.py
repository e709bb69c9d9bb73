"""Attitudes of an envelope at moments of its validity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array


@dataclass(frozen=True)
class Moments:
    """Attitudes at n times. ``cam_from_icrs``: (n, 3, 3). ``part``: (n,) elapsed fraction of the validity. ``nadir``:
    (n, 3) ICRS direction to the Earth's centre, None if the law does not define it. ``distance_m``: (n,) distance from the
    Earth's centre, None for a circular orbit."""

    cam_from_icrs: Array
    part: Array
    nadir: Array | None = None
    distance_m: Array | None = None

    def take(self, rows: NDArray[np.intp]) -> Moments:
        """Return the moments of these rows."""
        nadir = None if self.nadir is None else self.nadir[rows]
        distance_m = None if self.distance_m is None else self.distance_m[rows]
        return Moments(self.cam_from_icrs[rows], self.part[rows], nadir, distance_m)


def joined(parts: Sequence[Moments]) -> Moments:
    """Return the moments of several batches in their order."""
    nadirs = [p.nadir for p in parts if p.nadir is not None]
    distances = [p.distance_m for p in parts if p.distance_m is not None]
    return Moments(
        np.concatenate([p.cam_from_icrs for p in parts]),
        np.concatenate([p.part for p in parts]),
        np.concatenate(nadirs) if nadirs else None,
        np.concatenate(distances) if distances else None,
    )
