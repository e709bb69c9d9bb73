"""Fast version of an envelope for interactive previews. The exact test is used if it is fast; otherwise membership is
sampled.

Membership of a patch is sampled with fields concentrated at the ends of the limits, which determine the edge of the
envelope. In the documents' examples the sample contains every Hipparcos star to V 6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.envelope import Envelope, PatchEnvelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.moments import Moments
from gss.catalogue_tools.envelope.occultation import QUICK, OccultedEnvelope
from gss.catalogue_tools.envelope.several_heads import HeadsEnvelope
from gss.catalogue_tools.plan import BuildPlan
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array

MEMBER_FIELDS = 3000
MAP_FIELDS = 400
COARSE_NSIDE, FINE_NSIDE = 16, 32


@dataclass(frozen=True)
class QuickLook:
    """The subset of the envelope interface that the star selection and the map need."""

    plan: BuildPlan

    @cached_property
    def envelope(self) -> Envelope:
        """The plan's envelope, with fewer samples if anything hides the sky."""
        envelope = self.plan.envelope
        return replace(envelope, effort=QUICK) if isinstance(envelope, OccultedEnvelope) else envelope

    @property
    def base(self) -> Envelope:
        """The envelope before occultation."""
        return self.plan.base

    def contains(self, unit: Array) -> NDArray[np.bool_]:
        """Return the (n,) mask of the (n, 3) ICRS directions that are in the field at some time.

        For a patch, permanent occultation is not applied here, but only in the build. The map shows the occultation.
        Besides, in a patch that follows the Sun, whole fields are lost before a star is lost.
        """
        u = np.asarray(unit, float)
        patches = _patches(self.base)
        if patches:
            return np.asarray(np.logical_or.reduce([patch.witnessed(u, MEMBER_FIELDS) for patch in patches]))
        return self.envelope.contains(u)

    def time_fraction(self, unit: Array) -> Array:
        """Return the (n,) fraction of time in the field."""
        if self._occulted:
            return self.envelope.time_fraction(unit)
        return self._base_fraction(np.asarray(unit, float))

    def edges(self, at_end: bool) -> list[Array]:
        """Border of the envelope, exact."""
        return self.plan.envelope.edges(at_end)

    def attitudes(self, rng: np.random.Generator, count: int) -> Array:
        """Return (count, 3, 3) random cam_from_icrs within the limits."""
        return self.plan.envelope.attitudes(rng, count)

    def at(self, cube: Array) -> Moments:
        """Same as :meth:`Envelope.at`."""
        return self.plan.envelope.at(cube)

    @property
    def shape(self) -> FieldShape:
        """Field of view, including the margin."""
        return self.plan.envelope.shape

    @property
    def dimensions(self) -> int:
        """Same as :attr:`Envelope.dimensions`."""
        return self.plan.envelope.dimensions

    @property
    def nside(self) -> int:
        """HEALPix resolution of the map. It is coarser with occultation, because occultation is sampled."""
        return COARSE_NSIDE if self._occulted else FINE_NSIDE

    @property
    def _occulted(self) -> bool:
        return self.plan.envelope is not self.base

    def _base_fraction(self, unit: Array) -> Array:
        patches = _patches(self.base)
        if not patches:
            return self.base.time_fraction(unit)
        return np.asarray(np.minimum(1.0, np.sum([_patch_fraction(patch, unit) for patch in patches], axis=0)))


def _patches(base: Envelope) -> list[PatchEnvelope]:
    """Return the patch of each head; an empty list if the envelope is of another type."""
    heads = base.heads if isinstance(base, HeadsEnvelope) else (base,)
    return [head for head in heads if isinstance(head, PatchEnvelope)]


def _patch_fraction(patch: PatchEnvelope, unit: Array) -> Array:
    sampled = fields_per_star(unit, patch.crowded(MAP_FIELDS, 1.0), patch.shape) / MAP_FIELDS
    missed = (sampled == 0) & patch.witnessed(unit, MAP_FIELDS)
    return np.asarray(np.where(missed, 0.5 / MAP_FIELDS, sampled))
