"""Envelope of several heads on one body: the union of the envelopes of all heads, under the same orbit and attitude
limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.moments import Moments
from gss.domain.angles import Array


@dataclass(frozen=True)
class HeadsEnvelope:
    """Union of the envelopes of several heads. ``heads``: envelope of each head. All heads have the same camera, orbit
    and limits; only their mounting differs."""

    heads: tuple[Envelope, ...]

    @property
    def shape(self) -> FieldShape:
        """Field of view of each head."""
        return self.heads[0].shape

    @property
    def dimensions(self) -> int:
        """Dimensions of one head, plus one that selects the head."""
        return self.heads[0].dimensions + 1

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Return the (n,) mask of the (n, 3) directions that are in the field of a head at some time."""
        return np.asarray(np.logical_or.reduce([head.contains(unit) for head in self.heads]))

    def time_fraction(self, unit: Array) -> Array:
        """Return the (n,) fraction of time in the field of a head, at most 1. Times at which two heads see a direction
        are counted twice."""
        return np.asarray(np.minimum(1.0, np.sum([head.time_fraction(unit) for head in self.heads], axis=0)))

    def edges(self, at_end: bool) -> list[Array]:
        """Borders of the envelopes of all heads."""
        return [line for head in self.heads for line in head.edges(at_end)]

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """Return (count, 3, 3) random cam_from_icrs within the limits, evenly distributed over the heads."""
        return _chosen([head.attitudes(rng, count) for head in self.heads], rng.integers(len(self.heads), size=count))

    def at(self, cube: Array) -> Moments:
        """See :meth:`Envelope.at`; the last coordinate selects the head."""
        number = np.minimum((cube[:, -1] * len(self.heads)).astype(int), len(self.heads) - 1)
        moments = [head.at(cube[:, :-1]) for head in self.heads]
        nadirs = [moment.nadir for moment in moments if moment.nadir is not None]
        nadir = _chosen(nadirs, number) if len(nadirs) == len(moments) else None
        cams = _chosen([moment.cam_from_icrs for moment in moments], number)
        # All heads have the same orbit and place.
        return Moments(cams, moments[0].part, nadir, moments[0].distance_m)


def _chosen(values: Sequence[Array], number: NDArray[np.intp]) -> Array:
    """Return row k of the (heads, n, …) values of head ``number[k]``."""
    return np.asarray(np.stack(values)[number, np.arange(len(number))])
