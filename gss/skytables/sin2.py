"""Pairs of catalogue stars by sin²θ, with a k-vector for search-free range look-up (Huffman 2006 §5.5.4).

With sin²θ, no arccosine is needed on board. It is twice as sensitive as cos θ at small angles (eq. 6.6). Over the
sorted table it increases nearly linearly, as the straight line of the k-vector requires. It is monotonic only up to
90°.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.skytables.kvector import KVector, Rows, k_vector
from gss.skytables.pairs import DistanceTable


@dataclass(frozen=True)
class Sin2Directory:
    """Star pairs sorted by sin²θ. ``first``, ``second``: (m,) rows of a list of ``stars`` stars; ``sin2``: (m,)
    ascending; ``index``: k-vector of ``sin2``."""

    first: Rows
    second: Rows
    sin2: Array
    index: KVector
    stars: int

    def __len__(self) -> int:
        return len(self.sin2)

    def ranges(self, low: Array, high: Array) -> tuple[Rows, Rows]:
        """Return for each of (n,) intervals of sin²θ the slice [from, to) of the pairs inside it, both ends included."""
        return self.index.ranges(self.sin2, low, high)

    def restricted(self, allowed: NDArray[np.bool_]) -> Sin2Directory:
        """Return the directory of the pairs with both stars in the (stars,) mask ``allowed``."""
        keep = np.flatnonzero(allowed[self.first] & allowed[self.second])
        return indexed(self.first[keep], self.second[keep], self.sin2[keep], self.stars)


def sin2_directory(table: DistanceTable, stars: int) -> Sin2Directory:
    """Build the directory of a distance table of ``stars`` stars, in the order of the table. Raises BadInput for
    distances beyond 90°."""
    if len(table) and float(table.distance_rad[-1]) > np.pi / 2:
        raise BadInput(
            "sin²θ does not distinguish pairs beyond 90°",
            expected="distances of at most 90°",
            got=f"{np.degrees(float(table.distance_rad[-1])):.1f}°",
        )
    sine = np.sin(table.distance_rad.astype(float))
    return indexed(table.first.astype(np.intp), table.second.astype(np.intp), sine * sine, stars)


def indexed(first: Rows, second: Rows, sin2: Array, stars: int) -> Sin2Directory:
    """Build a directory of ascending values with its k-vector."""
    return Sin2Directory(first, second, sin2, k_vector(sin2), stars)


def sin2_of(unit_a: Array, unit_b: Array) -> Array:
    """Return sin² (n,) of the angles between (n, 3) unit vectors, from the cross product, which keeps full precision."""
    across = np.cross(unit_a, unit_b)
    return np.asarray(np.einsum("ij,ij->i", across, across))


def sin2_interval(sin2: Array, tolerance_rad: Array) -> tuple[Array, Array]:
    """Return the lower and upper ends (n,) of sin² for angles within ``tolerance_rad`` (n,) of the measured angles,
    which are below 90°."""
    angle = np.arcsin(np.sqrt(np.clip(sin2, 0.0, 1.0)))
    low = np.sin(np.maximum(angle - tolerance_rad, 0.0))
    high = np.sin(np.minimum(angle + tolerance_rad, np.pi / 2))
    return low * low, high * high
