"""FAR-MST's reduced catalogue: merge doubles, then keep the brightest stars of every field (Huffman 2006 §5.5.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.catalogue_tools.envelope.field import CircularField, FieldShape
from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.callbacks import no_progress
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable

BLOCK = 2048
# Largest number of (field, star) pairs in memory, at about 200 bytes each.
MAX_CONCURRENT = 1_000_000


@dataclass(frozen=True)
class Reduced:
    """A reduced catalogue.

    ``kept``: (n,) mask of the kept stars. ``per_field``: (m,) number of kept stars in each of the ``pointings``, for
    the report. These numbers show gaps, such as those in the document's catalogue, which the size of a catalogue does
    not show.
    """

    kept: NDArray[np.bool_]
    per_field: NDArray[np.int64]
    pointings: int


def survey_attitudes(step_rad: float, roll_rad: float = 0.0) -> Array:
    """Return (m, 3, 3) cam_from_icrs of pointings that are ``step_rad`` apart in declination and at most ``step_rad``
    apart along each parallel.

    These are the document's 1° steps, thinned towards the poles to give a uniform density over the sky.
    """
    if not 0 < step_rad <= np.pi / 4:
        raise BadInput("the sky step is out of range", expected="0° to 45°", got=f"{np.degrees(step_rad):g}°")
    rings = int(np.ceil(np.pi / step_rad))
    ring_dec = -np.pi / 2 + (np.arange(rings) + 0.5) * np.pi / rings
    count = np.maximum(1, np.ceil(2 * np.pi * np.cos(ring_dec) / step_rad).astype(int))
    dec, per_ring = np.repeat(ring_dec, count), np.repeat(count, count)
    place = np.arange(len(dec)) - np.repeat(np.cumsum(count) - count, count)
    return _attitudes(2 * np.pi * place / per_ring, dec, roll_rad)


def _attitudes(ra_rad: Array, dec_rad: Array, roll_rad: float) -> Array:
    """Return (m, 3, 3) rotations: :func:`gss.domain.frames.cam_from_icrs`, vectorised."""
    boresight = unit_from_ra_dec(ra_rad, dec_rad)
    east = np.column_stack([-np.sin(ra_rad), np.cos(ra_rad), np.zeros(len(ra_rad))])
    north = np.cross(boresight, east)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([-c * east - s * north, s * east - c * north, boresight], axis=1)


def square_field(side_rad: float) -> FieldShape:
    """Return a square field with that full angle; the document does not specify the shape of its field of view."""
    return FieldShape(Camera.from_fov(1000, 1000, side_rad))


def reduce_catalogue(
    stars: StarTable,
    shape: FieldShape | CircularField,
    attitudes: Array,
    brightest: int = 8,
    report: Callable[[float], None] = no_progress,
) -> Reduced:
    """Keep the stars that are among the ``brightest`` of some field, and count the kept stars per field.

    ``report`` is called with the fraction of the fields done after each block. It can raise an exception to cancel.
    """
    order = np.argsort(stars.v_mag, kind="stable")
    unit = stars.icrs[order]
    selected = np.zeros(len(stars), bool)
    # The search starts with the brightest stars of the sky. For fields that have too few of these, fainter stars are
    # searched too.
    pending, depth = attitudes, _depth(shape, brightest)
    while len(pending):
        short = []
        for field, star, n in _blocks(unit[:depth], shape, pending):
            rank = np.arange(len(field)) - np.searchsorted(field, field)
            selected[order[star[rank < brightest]]] = True
            short.append(np.bincount(field, minlength=n) < brightest)
            report(1 - (len(pending) - sum(map(len, short))) / len(attitudes))
        if depth >= len(unit):
            break
        pending, depth = pending[np.concatenate(short)], 3 * depth
    counts = []
    for field, _, n in _blocks(stars.icrs[selected], shape, attitudes):
        counts.append(np.bincount(field, minlength=n))
        report(1.0)
    return Reduced(selected, np.concatenate(counts), len(attitudes))


def looks(stars: int, shape: FieldShape | CircularField, fields: int, brightest: int) -> float:
    """Estimate how many times :func:`reduce_catalogue` tests a star against a field, with ``stars`` uniform over the
    sky."""
    return fields * min(2.0 * brightest / _share(shape), float(stars)) * _reach_share(shape)


def _depth(shape: FieldShape | CircularField, brightest: int) -> int:
    """Return the number of stars over the whole sky that gives 2 × ``brightest`` stars per average field."""
    return int(2 * brightest / _share(shape)) + 1


def _share(shape: FieldShape | CircularField) -> float:
    """Fraction of the sky in one field."""
    return float(
        (1 - np.cos(shape.radius_rad)) / 2 if isinstance(shape, CircularField) else shape.area_sr / (4 * np.pi)
    )


def _reach(shape: FieldShape | CircularField) -> float:
    return float(min(shape.half_diagonal_rad if isinstance(shape, FieldShape) else shape.radius_rad, np.pi))


def _reach_share(shape: FieldShape | CircularField) -> float:
    """Fraction of the sky in the circle around a field."""
    return float((1 - np.cos(_reach(shape))) / 2)


def _blocks(
    unit: Array, shape: FieldShape | CircularField, attitudes: Array
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], int]]:
    """Yield, for each block of attitudes, the ascending field numbers, the rows of ``unit`` inside each field, also
    ascending, and the number of fields."""
    tree = cKDTree(unit)
    reach = 2 * np.sin(_reach(shape) / 2)
    size = int(np.clip(MAX_CONCURRENT / max(len(unit) * _reach_share(shape), 1), 1, BLOCK))
    for start in range(0, len(attitudes), size):
        block = attitudes[start : start + size]
        near = cKDTree(block[:, 2]).sparse_distance_matrix(tree, reach * (1 + 1e-9), output_type="ndarray")
        field, star = near["i"].astype(np.intp), near["j"].astype(np.intp)
        inside = shape.inside(np.einsum("nij,nj->ni", block[field], unit[star]))
        field, star = field[inside], star[inside]
        sort = np.lexsort((star, field))
        yield field[sort], star[sort], len(block)
