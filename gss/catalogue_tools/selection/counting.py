"""Count the stars in up to a million fields. Fields are grouped by pixel of the sky, so each group is tested against
few stars."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.field import CircularField, FieldShape
from gss.catalogue_tools.envelope.healpix import centres, pixel_of, pixel_radius_rad
from gss.domain.angles import Array

Counts = NDArray[np.int64]
Group = tuple[NDArray[np.intp], NDArray[np.intp]]
# Number of field–star tests in one step. Their data fit the cache of the processor.
STEP = 131_072
# Minimum number of fields per pixel, and limit of the resolution. With fewer fields, or with pixels much smaller than a
# field, grouping takes more time than it saves.
FIELDS_PER_PIXEL = 100
PIXEL_OF_FIELD = 0.3
MANY_STARS = 5000


@dataclass(frozen=True)
class Shadow:
    """Region hidden by the Earth. ``nadir``: (m, 3) ICRS unit vectors, one per field. ``radius_rad``: angle to the limb
    plus margin, (m,) or common."""

    nadir: Array
    radius_rad: Array | float


def stars_per_field(
    unit: Array,
    attitudes: Array,
    shape: FieldShape | CircularField,
    each: Callable[..., Iterable[Counts]] = map,
    shadow: Shadow | None = None,
) -> Counts:
    """Return the (m,) number of (n, 3) ICRS stars in each field of (m, 3, 3) cam_from_icrs.

    ``each``: ``map`` or the ``map`` method of a thread pool; numpy releases the interpreter lock. ``shadow``: stars in
    this region are not counted.
    """
    counts = np.zeros(len(attitudes), np.int64)
    if not len(unit) or not len(attitudes):
        return counts
    groups = _groups(unit, attitudes[:, 2], shape)

    def work(group: Group) -> Counts:
        return np.asarray(np.count_nonzero(_seen(unit, attitudes, shape, shadow, group), axis=1), np.int64)

    for (rows, _), group_counts in zip(groups, each(work, groups), strict=True):
        counts[rows] = group_counts
    return counts


def fields_per_star(
    unit: Array, attitudes: Array, shape: FieldShape | CircularField, shadow: Shadow | None = None
) -> Counts:
    """Return, for each of (n, 3) ICRS directions, the number of fields of (m, 3, 3) cam_from_icrs that contain it."""
    counts = np.zeros(len(unit), np.int64)
    if len(unit) and len(attitudes):
        for group in _groups(unit, attitudes[:, 2], shape):
            counts[group[1]] += np.count_nonzero(_seen(unit, attitudes, shape, shadow, group), axis=0)
    return counts


def _groups(unit: Array, boresight: Array, shape: FieldShape | CircularField) -> list[Group]:
    """Return, for each pixel of the sky, the rows of its fields and the rows of the stars that these fields can
    contain. The resolution of the pixels depends on the number of fields."""
    nside = 1
    worth = len(boresight) * max(1.0, len(unit) / MANY_STARS)
    while (
        12 * (2 * nside) ** 2 * FIELDS_PER_PIXEL <= worth
        and pixel_radius_rad(nside) > PIXEL_OF_FIELD * shape.half_diagonal_rad
    ):
        nside *= 2
    pixel = pixel_of(nside, boresight)
    order = np.argsort(pixel, kind="stable")
    used, starts = np.unique(pixel[order], return_index=True)
    reach = min(shape.half_diagonal_rad + pixel_radius_rad(nside), np.pi)
    near = unit @ centres(nside)[used].T >= np.cos(reach) - 1e-12
    groups = []
    for k, rows in enumerate(np.split(order, starts[1:])):
        stars = np.flatnonzero(near[:, k])
        if len(stars):
            size = max(1, STEP // len(stars))
            groups += [(rows[s : s + size], stars) for s in range(0, len(rows), size)]
    return groups


def _seen(
    unit: Array, attitudes: Array, shape: FieldShape | CircularField, shadow: Shadow | None, group: Group
) -> NDArray[np.bool_]:
    """Return the mask of shape (fields of the group, stars of the group) that is True if the field contains the
    star."""
    rows, stars = group
    near = unit[stars].T
    v = (attitudes[rows].reshape(-1, 3) @ near).reshape(len(rows), 3, len(stars))
    visible = shape.inside_planes(v[:, 0], v[:, 1], v[:, 2])
    if shadow is not None:
        limit = np.broadcast_to(np.cos(shadow.radius_rad), len(shadow.nadir))[rows]
        visible &= shadow.nadir[rows] @ near <= limit[:, None]
    return visible
