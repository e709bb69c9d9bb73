"""Parts of a band of sky that a camera which rotates with the orbit sees past the Earth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.attitude import euler_123
from gss.catalogue_tools.envelope.envelope import BandEnvelope
from gss.catalogue_tools.envelope.views import Views
from gss.domain.angles import Array

# Largest distance between two visible directions of the same interval.
GAP_RAD = float(np.radians(0.25))
# Accuracy of the ends of a band. The computed ends are then moved outwards by this angle.
END_RAD = 1e-4
FIRST, KEPT, CHILDREN, ROUNDS, SHRINK = 12_000, 24, 60, 16, 0.55


def seen_bands(band: BandEnvelope, views: Views, earth_rad: float, rounds: int = ROUNDS) -> list[tuple[float, float]]:
    """Return the intervals of the component along orbit +y in which directions are visible clear of the Earth.

    Without an Earth the result is the single interval ``band.polar_interval``. ``views``: views of the band's field and
    limits. The Earth is fixed in the orbit's axes. A star is visible if, at some angle around +y, its direction is
    clear of the Earth and is in the field of an attitude whose boresight is also clear. Clear views locate the
    intervals; their ends are then searched.
    """
    lowest, highest = band.polar_interval
    if earth_rad <= 0:
        return [(lowest, highest)]
    near, far = float(np.arccos(min(1.0, highest))), float(np.arccos(max(-1.0, lowest)))
    limit = float(np.cos(earth_rad))
    angles = np.sort(views.from_y_rad[(views.direction[:, 2] <= limit) & (views.boresight[:, 2] <= limit)])
    if not len(angles):
        return []
    cut = np.flatnonzero(np.diff(angles) > GAP_RAD)
    starts, stops = angles[np.concatenate([[0], cut + 1])], angles[np.concatenate([cut, [len(angles) - 1]])]
    middle = (stops[:-1] + starts[1:]) / 2
    bounds = np.concatenate([[near], middle, [far]])
    bands = []
    for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        first = min(start, _end(band, limit, bounds[k], bounds[k + 1], 1.0, rounds))
        last = max(stop, _end(band, limit, bounds[k], bounds[k + 1], -1.0, rounds))
        bands.append((max(near, first - END_RAD), min(far, last + END_RAD)))
    return [(float(np.cos(b)), float(np.cos(a))) for a, b in bands]


def _end(band: BandEnvelope, limit: float, low_rad: float, high_rad: float, sign: float, rounds: int) -> float:
    """Return the smallest (``sign`` 1) or largest angle from orbit +y of a clear direction, between ``low_rad`` and
    ``high_rad``.

    The random search over attitudes and positions is refined around the best samples. The extreme is on the field's
    outline or on the Earth's limb.
    """
    rng = np.random.default_rng(0)
    cube = np.clip(rng.uniform(-0.25, 1.25, (FIRST, 3)), 0, 1)
    tries = np.column_stack([cube, rng.random(FIRST), np.arange(FIRST) % 2])
    scale = 0.3
    best = np.inf
    for _ in range(rounds):
        angle, ok = _angles(band, limit, tries)
        value = np.where(ok & (angle >= low_rad) & (angle <= high_rad), sign * angle, np.inf)
        order = np.argsort(value)[:KEPT]
        best = min(best, float(value[order[0]]))
        near = np.repeat(tries[order[np.isfinite(value[order])]], CHILDREN, axis=0)
        if not len(near):
            break
        step = rng.normal(size=(len(near), 4)) * scale
        # Clipping places samples exactly at the ends of the limits. With the random mask, each number changes
        # independently of the others.
        step *= rng.random((len(near), 4)) < 0.6
        step[::CHILDREN] = 0
        near[:, :3] = np.clip(near[:, :3] + step[:, :3], 0, 1)
        near[:, 3] += step[:, 3]
        tries, scale = near, scale * SHRINK
    return sign * best


def _angles(band: BandEnvelope, limit: float, tries: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return, for each try, the (n,) angle of its direction from +y and the (n,) mask of directions visible clear of
    the Earth.

    A try consists of three numbers for the attitude, the position on the outline or on the limb, and the choice between
    outline and limb.
    """
    limits = band.limits
    cam = limits.cam_from_body @ euler_123(limits.low + (limits.high - limits.low) * tries[:, :3])
    on_limb = tries[:, 4] > 0
    turn, flat = 2 * np.pi * tries[:, 3], np.sqrt(1 - limit * limit)
    limb = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.full_like(turn, limit)], axis=-1)
    outline = np.einsum("nji,nj->ni", cam, band.shape.edge(4 * tries[:, 3]))
    direction = np.where(on_limb[:, None], limb, outline)
    in_field = ~on_limb | band.shape.inside(np.einsum("nij,nj->ni", cam, direction))
    clear = (cam[:, 2, 2] <= limit) & (direction[:, 2] <= limit + 1e-12)
    return np.arccos(np.clip(direction[:, 1], -1, 1)), in_field & clear
