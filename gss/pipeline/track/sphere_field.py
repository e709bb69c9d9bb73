"""Catalogue stars in a field of view, selected by right ascension and declination (Jacobs 1995 §4.1.2, app. B).

A straight edge of the detector is a great circle. At a star's right ascension the field has two edges, and the star is
inside if its declination is between them. The number of edges that cross right ascension zero distinguishes three
cases: none; one if a pole is inside, so that every right ascension has one edge; two if the field lies across zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import TWO_PI_RAD, Array, ra_dec_from_unit


@dataclass(frozen=True)
class SphereField:
    """Edges of a field. ``left_rad``, ``width_rad`` (4,): right ascension and extent of each edge; ``normal`` (4, 3):
    normal of its great circle. ``zero_crossings``: counted as in the document, uncertain by rounding if a corner is
    at zero; ``pole``: +1 or −1 if the north or south pole is inside, else 0."""

    left_rad: Array
    width_rad: Array
    normal: Array
    zero_crossings: int
    pole: int

    @property
    def first_ra_rad(self) -> float:
        """Return the right ascension at which an ascending search starts: the leftmost corner, or zero if a pole is inside."""
        if self.pole:
            return 0.0
        # The leftmost corner is the left end of an edge, but is neither inside another edge nor the right end of an
        # edge. The left ends of all other edges follow within 180°.
        reach = np.mod(self.left_rad[None, :] - self.left_rad[:, None], TWO_PI_RAD)
        return float(self.left_rad[int(np.argmin(np.max(np.where(reach > TWO_PI_RAD - 1e-12, 0.0, reach), axis=1)))])


def sphere_field(corners: Array) -> SphereField:
    """Build the edges from (4, 3) unit vectors of the corners in order around the field, which is less than a hemisphere."""
    c = np.asarray(corners, float)
    after = np.roll(c, -1, axis=0)
    ra, _ = ra_dec_from_unit(c)
    step = np.mod(np.roll(ra, -1) - ra + np.pi, TWO_PI_RAD) - np.pi
    left = np.where(step >= 0, ra, np.roll(ra, -1))
    width = np.abs(step)
    crossings = int(np.count_nonzero(left + width >= TWO_PI_RAD))
    normal = np.cross(c, after)
    # A pole is inside if it is on the same side of all edges. The number of crossings would show this too, but rounding
    # changes it if a corner is at right ascension zero.
    inside = (normal[:, 2] > 0).all() or (normal[:, 2] < 0).all()
    return SphereField(left, width, normal, crossings, int(np.sign(c[:, 2].sum())) if inside else 0)


def edge_dec_rad(normal: Array, ra_rad: Array) -> Array:
    """Return the declinations of a great circle at the given right ascensions (app. B)."""
    slope = -(normal[0] * np.cos(ra_rad) + normal[1] * np.sin(ra_rad))
    return np.asarray(np.arctan2(slope * np.sign(normal[2]), np.abs(normal[2])))


def stars_inside(field: SphereField, ra_rad: Array, dec_rad: Array) -> NDArray[np.intp]:
    """Return the rows of the stars inside the field, by ascending right ascension from its leftmost corner (eq. 4.4–4.7)."""
    lowest, highest = np.full(len(ra_rad), np.inf), np.full(len(ra_rad), -np.inf)
    for left, width, normal in zip(field.left_rad, field.width_rad, field.normal, strict=True):
        over = np.flatnonzero(np.mod(ra_rad - left, TWO_PI_RAD) < width)
        dec = edge_dec_rad(normal, ra_rad[over])
        lowest[over] = np.minimum(lowest[over], dec)
        highest[over] = np.maximum(highest[over], dec)
    if field.pole > 0:
        highest = np.where(np.isfinite(lowest), np.pi / 2, -np.inf)
    elif field.pole < 0:
        lowest = np.where(np.isfinite(highest), -np.pi / 2, np.inf)
    inside = np.flatnonzero((lowest <= dec_rad) & (dec_rad <= highest))
    return inside[np.argsort(np.mod(ra_rad[inside] - field.first_ra_rad, TWO_PI_RAD), kind="stable")]
