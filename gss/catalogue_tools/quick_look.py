"""The envelope for a page that answers while parameters change: exact where that is quick, sampled where it is not.

Membership of a patch is sampled with fields that crowd at the ends of the limits, where the edge of an envelope comes from: of
Hipparcos to V 6 it misses none in the documents' cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.envelope import Envelope, Moments, PatchEnvelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.occultation import QUICK, OccultedEnvelope
from gss.catalogue_tools.plan import Plan
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array

MEMBER_FIELDS = 3000
MAP_FIELDS = 400
COARSE_NSIDE, FINE_NSIDE = 16, 32


@dataclass(frozen=True)
class QuickLook:
    """As much of an envelope as a choice of stars and a map need."""

    plan: Plan

    @cached_property
    def envelope(self) -> Envelope:
        """The plan's, looked at less closely where something hides the sky."""
        whole = self.plan.envelope
        return replace(whole, effort=QUICK) if isinstance(whole, OccultedEnvelope) else whole

    @property
    def base(self) -> Envelope:
        """What is seen before anything hides it."""
        return self.plan.base

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Which (n, 3) ICRS directions are ever in the field. What hides a patch's sky for good is left to the build: it is the
        map that shows it, and a patch that turns to the Sun loses whole fields before it loses a star."""
        u = np.asarray(unit, float)
        if isinstance(self.base, PatchEnvelope):
            return self.base.witnessed(u, MEMBER_FIELDS)
        return self.envelope.contains(u)

    def time_fraction(self, unit: Array) -> Array:
        """(n,) share of time in the field."""
        if self._occulted:
            return self.envelope.time_fraction(unit)
        return self._base_fraction(np.asarray(unit, float))

    def edges(self, at_end: bool) -> list[Array]:
        """The border, exact."""
        return self.plan.envelope.edges(at_end)

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """(count, 3, 3) random cam_from_icrs within the limits."""
        return self.plan.envelope.attitudes(rng, count)

    def at(self, cube: Array) -> Moments:
        """As the envelope's."""
        return self.plan.envelope.at(cube)

    @property
    def shape(self) -> FieldShape:
        """The field, margin and all."""
        return self.plan.envelope.shape

    @property
    def dimensions(self) -> int:
        """As the envelope's."""
        return self.plan.envelope.dimensions

    @property
    def nside(self) -> int:
        """Fineness of the map: what hides the sky is sampled, and is drawn more coarsely."""
        return COARSE_NSIDE if self._occulted else FINE_NSIDE

    @property
    def _occulted(self) -> bool:
        return self.plan.envelope is not self.base

    def _base_fraction(self, unit: Array) -> Array:
        if not isinstance(self.base, PatchEnvelope):
            return self.base.time_fraction(unit)
        even = fields_per_star(unit, self.base.crowded(MAP_FIELDS, 1.0), self.base.shape) / MAP_FIELDS
        rare = (even == 0) & self.base.witnessed(unit, MAP_FIELDS)
        return np.asarray(np.where(rare, 0.5 / MAP_FIELDS, even))
