"""Triplet features of stars, and the reference database of these features (Liebe 1992, "Star characteristics" and
"Including uncertainty in the database").

A star is identified by the distances to its two nearest neighbours and the angle between them, each rounded down to a
class. Position errors, neighbours near the detection limit, and a changed order of the neighbours can alter the
measured features. The database therefore also contains these altered features. This module contains the definitions
that image processing and database generation share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array, cross
from gss.domain.errors import BadInput
from gss.skytables.pairs import expanded

Keys = NDArray[np.uint32]
Rows = NDArray[np.int32]

DISTANCE_BITS, ANGLE_BITS = 12, 6
MAX_DISTANCE, MAX_ANGLE = (1 << DISTANCE_BITS) - 1, (1 << ANGLE_BITS) - 1
NEIGHBOURS = 24
EXCHANGE_UNCERTAINTIES = 4.0


@dataclass(frozen=True)
class TripletClasses:
    """Class widths used to round features.

    ``uncertainty_rad``: largest error of one star's position. Liebe 1992 uses 3′, distance classes of twice that, and
    angle classes of 5°.
    """

    distance_rad: float
    angle_rad: float
    uncertainty_rad: float

    def __post_init__(self) -> None:
        fits = self.angle_rad * MAX_ANGLE >= np.pi and self.distance_rad * MAX_DISTANCE >= np.pi / 4
        if not (self.distance_rad > 0 and self.uncertainty_rad > 0 and fits):
            raise BadInput(
                "invalid triplet classes",
                expected=f"at most {MAX_DISTANCE} distances over 45° and {MAX_ANGLE} angles over 180°",
                got=f"{np.degrees(self.distance_rad):g}° and {np.degrees(self.angle_rad):g}°",
            )

    @classmethod
    def of(cls, uncertainty_rad: float, angle_rad: float = float(np.radians(5.0))) -> TripletClasses:
        """Return classes whose distance width is twice the uncertainty."""
        return cls(2 * uncertainty_rad, angle_rad, uncertainty_rad)

    def key(self, first_rad: Array, second_rad: Array, angle_rad: Array) -> Keys:
        """Return the (n,) keys of n measured features. The class of the first distance is in the highest bits."""
        a, b = (np.minimum(np.floor(d / self.distance_rad), MAX_DISTANCE) for d in (first_rad, second_rad))
        return pack(a.astype(np.int64), b.astype(np.int64), np.floor(angle_rad / self.angle_rad).astype(np.int64))

    def angle_error_rad(self, first_rad: Array, second_rad: Array) -> Array:
        """Return the largest error of the angle between neighbours at the given distances, computed from chords.
        The error is 1.724° in the example of Liebe 1992."""
        arms = np.maximum(2 * np.sin(np.stack([first_rad, second_rad]) / 2), 1e-12)
        return np.asarray(np.sum(2 * self.uncertainty_rad / arms, axis=0))


def pack(first: NDArray[np.integer], second: NDArray[np.integer], angle: NDArray[np.integer]) -> Keys:
    """Pack class numbers into keys: 12 bits, 12 bits, 6 bits."""
    word = (np.asarray(first) << (DISTANCE_BITS + ANGLE_BITS)) | (np.asarray(second) << ANGLE_BITS) | np.asarray(angle)
    return word.astype(np.uint32)


@dataclass(frozen=True)
class TripletTable:
    """Reference database: m references, sorted by key and then by star.

    ``star``: row in the star list, which has ``stars`` rows. ``limit_mag``: magnitude at which a star is detected half
    of the time; ``brightness_error``: relative uncertainty of the brightness. ``max_rad``: largest distance of a
    neighbour.
    """

    key: Keys
    star: Rows
    stars: int
    classes: TripletClasses
    limit_mag: float
    brightness_error: float
    max_rad: float

    def __len__(self) -> int:
        return len(self.key)

    def look_up(self, keys: Keys) -> tuple[NDArray[np.intp], Rows]:
        """Find the references with each of n keys. Returns one pair (index into ``keys``, star row) per matching
        reference."""
        low, high = np.searchsorted(self.key, keys, "left"), np.searchsorted(self.key, keys, "right")
        key_index, entry = expanded(low, high)
        return key_index, self.star[entry]


CERTAIN, MAYBE, EXCHANGED = 0, 1, 2
"""Kinds of constellation. CERTAIN: both neighbours are always detected. MAYBE: a neighbour can be missed or blended.
EXCHANGED: occurs only if a position error changes the order of the neighbours."""


@dataclass(frozen=True)
class Constellations:
    """Compact form of the database: m constellations of a star and two neighbours, not yet expanded to all classes
    within their errors.

    ``kind``: CERTAIN, MAYBE or EXCHANGED. ``first``, ``second``: classes of the two distances. ``angle_low`` to
    ``angle_high``: range of angle classes. Each constellation expands to about a dozen references (Liebe 1992:
    3 × 3 distance classes, each with one or two angle classes).
    """

    kind: NDArray[np.uint8]
    star: Rows
    first: Rows
    second: Rows
    angle_low: Rows
    angle_high: Rows
    stars: int
    classes: TripletClasses
    limit_mag: float
    brightness_error: float
    max_rad: float

    def __len__(self) -> int:
        return len(self.star)

    def table(self) -> TripletTable:
        """Return the table of references, without duplicate (key, star) pairs."""
        index, key = _spread(self.first, self.second, self.angle_low, self.angle_high)
        pairs = np.unique((key.astype(np.int64) << 32) | self.star[index])
        key, star = (pairs >> 32).astype(np.uint32), (pairs & 0xFFFFFFFF).astype(np.int32)
        return TripletTable(key, star, self.stars, self.classes, self.limit_mag, self.brightness_error, self.max_rad)


def certain_mag(limit_mag: float, brightness_error: float) -> float:
    """Return the magnitude up to which stars are always detected (1 + ``brightness_error`` times the
    brightness at the limit; 125 % in Liebe 1992)."""
    return float(limit_mag - 2.5 * np.log10(1 + brightness_error))


def faintest_mag(limit_mag: float, brightness_error: float) -> float:
    """Return the magnitude beyond which stars are never detected (1 − ``brightness_error`` times the brightness at the
    limit; 75 % in Liebe 1992). A complete triplet table needs a star list to this magnitude."""
    return float(limit_mag - 2.5 * np.log10(1 - brightness_error))


def features(star: Array, first: Array, second: Array) -> tuple[Array, Array, Array]:
    """Compute the two distances and the angle, each (n,) rad, from (n, 3) unit vectors of the star and its nearest
    and second nearest neighbour."""

    def arc(to: Array) -> Array:
        return np.asarray(2 * np.arcsin(np.minimum(1.0, np.linalg.norm(star - to, axis=-1) / 2)))

    def tangent(to: Array) -> Array:
        return np.asarray(to - np.sum(star * to, axis=-1, keepdims=True) * star)

    p, q = tangent(first), tangent(second)
    angle = np.arctan2(np.linalg.norm(cross(p, q), axis=-1), np.sum(p * q, axis=-1))
    return arc(first), arc(second), np.asarray(angle)


def build_triplets(
    icrs: NDArray[np.floating],
    v_mag: NDArray[np.floating],
    classes: TripletClasses,
    limit_mag: float,
    max_rad: float,
    *,
    brightness_error: float = 0.25,
    blend_rad: float = 0.0,
) -> TripletTable:
    """Build the reference table of a star list with directions (n, 3) and magnitudes (n,). See
    :func:`find_constellations`."""
    constellations = find_constellations(
        icrs, v_mag, classes, limit_mag, max_rad, brightness_error=brightness_error, blend_rad=blend_rad
    )
    return constellations.table()


def find_constellations(
    icrs: NDArray[np.floating],
    v_mag: NDArray[np.floating],
    classes: TripletClasses,
    limit_mag: float,
    max_rad: float,
    *,
    brightness_error: float = 0.25,
    blend_rad: float = 0.0,
) -> Constellations:
    """Find every constellation that can be measured in a star list with directions (n, 3) and magnitudes (n,).
    Duplicates (equal kind, star and classes) are removed.

    Stars without a magnitude (NaN) are treated as certain. ``blend_rad``: distance below which a companion merges with
    the brighter star. The fainter star can then be missed; Liebe 1992 treats double stars in the same way. ``max_rad``:
    largest distance of a neighbour, limited by what one frame can show.
    """
    unit = np.asarray(icrs, float)
    unit = unit / np.linalg.norm(unit, axis=1, keepdims=True)
    mag = np.asarray(v_mag, float)
    rows = np.flatnonzero(~(mag > faintest_mag(limit_mag, brightness_error)))
    table = np.empty((0, 6), np.int64)
    if len(rows) >= 3:
        certain = ~(mag[rows] > certain_mag(limit_mag, brightness_error)) & ~_companions(
            unit[rows], mag[rows], blend_rad
        )
        kind, owner, first, second = _constellations(unit[rows], certain, classes.uncertainty_rad, max_rad)
        measured = features(unit[rows][owner], unit[rows][first], unit[rows][second])
        table = np.unique(np.column_stack([kind, rows[owner], *_classes(*measured, classes)]), axis=0)
        # A constellation that is one class beyond the last class expands into the last class. Constellations that are
        # farther out do not.
        table = table[table[:, 3] <= MAX_DISTANCE + 1]
    star, first_class, second_class, low, high = (column.astype(np.int32) for column in table.T[1:])
    return Constellations(
        table[:, 0].astype(np.uint8),
        star,
        first_class,
        second_class,
        low,
        high,
        len(unit),
        classes,
        limit_mag,
        brightness_error,
        max_rad,
    )


def _companions(unit: Array, mag: Array, blend_rad: float) -> NDArray[np.bool_]:
    """Return the (n,) mask of stars with a brighter star within ``blend_rad``. If two stars are equally bright, the
    later star is marked."""
    fainter = np.zeros(len(unit), bool)
    if blend_rad > 0:
        pairs = cKDTree(unit).query_pairs(2 * np.sin(blend_rad / 2), output_type="ndarray")
        a, b = pairs[:, 0], pairs[:, 1]
        fainter[np.where(mag[a] > mag[b], a, b)] = True
    return fainter


def _constellations(
    unit: Array, certain: NDArray[np.bool_], uncertainty_rad: float, max_rad: float
) -> tuple[NDArray[np.integer], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return (kind, star, first neighbour, second neighbour) of every constellation that can be measured.

    The first neighbour is any star up to the first certain neighbour, and the second is any star up to the second
    certain neighbour. Liebe 1992 lists twelve such constellations for six neighbours. Neighbours that a position error
    could move into this range are included (Figs. 12, 13). Pairs that an error could swap appear in both orders.
    """
    count = min(NEIGHBOURS, len(unit) - 1)
    chord, near = cKDTree(unit).query(unit, count + 1)
    chord, near = _without_self(chord, near)
    distance = 2 * np.arcsin(np.minimum(1.0, chord / 2))
    exchange_rad = EXCHANGE_UNCERTAINTIES * uncertainty_rad
    certain_count = np.cumsum(certain[near], axis=1)
    limit = [
        np.where(
            (certain_count >= k).any(axis=1), distance[_rows(distance), np.argmax(certain_count >= k, axis=1)], np.inf
        )
        for k in (1, 2)
    ]
    in_reach = distance <= max_rad
    first = in_reach & (distance <= limit[0][:, None] + exchange_rad)
    second = in_reach & (distance <= limit[1][:, None] + exchange_rad)
    ordered = distance[:, :, None] <= distance[:, None, :] + exchange_rad
    not_same = ~np.eye(distance.shape[1], dtype=bool)
    star, i, j = np.nonzero(first[:, :, None] & second[:, None, :] & ordered & not_same)
    as_listed = distance[star, i] <= distance[star, j]
    as_listed &= (distance[star, i] <= limit[0][star]) & (distance[star, j] <= limit[1][star])
    both_seen = certain[near[star, i]] & certain[near[star, j]]
    kind = np.where(as_listed, np.where(both_seen, CERTAIN, MAYBE), EXCHANGED)
    return kind, star, near[star, i], near[star, j]


def _rows(table: Array) -> NDArray[np.intp]:
    return np.arange(len(table))


def _without_self(chord: Array, near: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp]]:
    """Remove each star from its own neighbour list. The star is not always the first entry, because two stars can have
    the same position."""
    is_self = near == np.arange(len(near))[:, None]
    is_self[:, -1] |= ~is_self.any(axis=1)
    keep = ~is_self
    return chord[keep].reshape(len(near), -1), near[keep].reshape(len(near), -1)


def _classes(
    first_rad: Array, second_rad: Array, angle_rad: Array, classes: TripletClasses
) -> tuple[NDArray[np.int64], ...]:
    """Return (n,) arrays: class of the first distance, class of the second, lowest and highest class of the angle."""
    error = classes.angle_error_rad(first_rad, second_rad)
    max_angle_class = int(np.floor(np.pi / classes.angle_rad))
    low, high = (
        np.clip(np.floor(angle / classes.angle_rad), 0, max_angle_class).astype(np.int64)
        for angle in (angle_rad - error, angle_rad + error)
    )
    a, b = (np.floor(d / classes.distance_rad).astype(np.int64) for d in (first_rad, second_rad))
    return a, b, low, high


def _spread(
    first: NDArray[np.integer], second: NDArray[np.integer], low: NDArray[np.integer], high: NDArray[np.integer]
) -> tuple[NDArray[np.intp], Keys]:
    """Expand constellations to every class in which they can be measured. Returns (index of the constellation, key)."""
    count = high.astype(np.int64) - low + 1
    index = np.repeat(np.arange(len(low)), count)
    angle = np.arange(len(index)) - np.repeat(np.cumsum(count) - count, count) + low[index]
    a, b = first.astype(np.int64)[index], second.astype(np.int64)[index]
    step = np.array([-1, 0, 1])
    first_class, second_class, angle_class, constellation = np.broadcast_arrays(
        a[:, None, None] + step[:, None], b[:, None, None] + step, angle[:, None, None], index[:, None, None]
    )
    # Measured distances are always sorted, so the first class is never above the second.
    possible = (first_class >= 0) & (first_class <= second_class) & (second_class <= MAX_DISTANCE)
    return constellation[possible], pack(first_class[possible], second_class[possible], angle_class[possible])
