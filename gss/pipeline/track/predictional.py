"""Predictional estimate: predict stars from a coarse attitude, match them by least distance, and correct the attitude
until the predicted and measured images coincide (Liebe 1992, "Predictional estimate", Figs. 15 to 17)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.kernels import kernels
from gss.pipeline.track.differential import differential_attitude
from gss.pipeline.track.least_distance import pair_least_distance

Index = NDArray[np.intp]
ROUNDS = 6


@dataclass(frozen=True)
class Fit:
    """Result of the estimate. ``cam_from_icrs`` (3, 3); ``measured``, ``row``: matched measured stars and their rows in
    the list; ``compared``: number of distances compared."""

    cam_from_icrs: Array
    measured: Index
    row: Index
    compared: int


def predictional_fit(
    unit_cam: Array,
    icrs: Array,
    rows: Index,
    cam_from_icrs: Array,
    radii_rad: Sequence[float],
    view_rad: float,
    fast: bool | None = None,
) -> Fit | None:
    """Fit (n, 3) measured directions to the ``rows`` of a star list (m, 3) that are within ``view_rad`` of the
    boresight.

    ``radii_rad`` decrease from the error of the attitude to the error of a star's position. The last radius is repeated
    until the pairs no longer change. None if there are fewer than two pairs or the attitude does not converge.
    ``fast``: see ``kernels.kernels``.
    """
    loops = kernels(fast).lists
    if loops is not None:
        fitted = loops.predictional_fit(unit_cam, icrs, rows, cam_from_icrs, radii_rad, view_rad)
        return None if fitted is None else Fit(*fitted)
    attitude, compared = np.asarray(cam_from_icrs, float), 0
    before: tuple[bytes, bytes] | None = None
    for radius_rad in [*radii_rad, *[radii_rad[-1]] * ROUNDS]:
        near = rows[icrs[rows] @ attitude[2] > np.cos(view_rad + radius_rad)]
        i, j = pair_least_distance(unit_cam, icrs[near] @ attitude.T, radius_rad)
        compared += len(unit_cam) * len(near)
        corrected = differential_attitude(unit_cam[i], icrs[near[j]], attitude)
        if corrected is None:
            return None
        attitude = corrected
        same = (i.tobytes(), near[j].tobytes())
        if same == before and radius_rad == radii_rad[-1]:
            return Fit(attitude, i, near[j], compared)
        before = same
    return None


def shrinking_radii_rad(coarse_rad: float, fine_rad: float) -> tuple[float, ...]:
    """Return the radii from coarse to fine; each is half of the previous radius."""
    radii = [coarse_rad]
    while radii[-1] > fine_rad:
        radii.append(max(fine_rad, radii[-1] / 2))
    return tuple(radii)
