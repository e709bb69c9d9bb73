"""Search for the field with the fewest stars. Random fields are tested first, then fields around the poorest random
fields."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.field import FieldShape, widened
from gss.catalogue_tools.envelope.occultation import OccultedEnvelope
from gss.catalogue_tools.selection.counting import stars_per_field
from gss.domain.angles import Array

FIRST, KEPT, CHILDREN, ROUNDS = 4096, 24, 24, 8
START_SCALE, SHRINK = 0.06, 0.6
# Margin of an enlarged field on each side, as a fraction of the half diagonal. Among fields with the same number of
# stars, the field with the fewest stars in its enlarged field is preferred, because a poorer field is probably near.
COLLAR = 0.15
BLIND = 1e6


@dataclass(frozen=True)
class Poorest:
    """The poorest field that was found. ``cam_from_icrs``: (3, 3) attitude. ``stars``: its number of stars.
    ``searched``: number of fields that were tested."""

    cam_from_icrs: Array
    stars: int
    searched: int


def search_poorest(unit: Array, envelope: Envelope, shape: FieldShape, seed: int = 0) -> Poorest:
    """Search the fields of an envelope for the field with the fewest of (n, 3) ICRS stars.

    Fields blinded by Earth, Sun or Moon are excluded. The search is not exhaustive, so a poorer field can exist.
    """
    rng = np.random.default_rng(seed)
    collar = FieldShape(widened(shape.camera, COLLAR * shape.half_diagonal_rad))
    cube = rng.random((FIRST, envelope.dimensions))
    scale, searched = START_SCALE, 0
    best, best_stars = np.eye(3), len(unit) + 1
    for _ in range(ROUNDS):
        stars, score, attitudes = _scores(unit, envelope, shape, collar, cube)
        searched += len(cube)
        order = np.argsort(score, kind="stable")[:KEPT]
        if stars[order[0]] < best_stars:
            best, best_stars = attitudes[order[0]], int(stars[order[0]])
        if best_stars == 0:
            break
        near = np.repeat(cube[order], CHILDREN, axis=0)
        step = rng.normal(size=near.shape) * scale
        step[::CHILDREN] = 0
        cube, scale = np.clip(near + step, 0, 1 - 1e-12), scale * SHRINK
    return Poorest(best, best_stars, searched)


def _scores(
    unit: Array, envelope: Envelope, shape: FieldShape, collar: FieldShape, cube: Array
) -> tuple[Array, Array, Array]:
    """Return the (n,) number of stars, the (n,) score to minimise, and (n, 3, 3) attitudes."""
    moments = envelope.at(cube)
    shadow = envelope.shadow(moments) if isinstance(envelope, OccultedEnvelope) else None
    stars = stars_per_field(unit, moments.cam_from_icrs, shape, shadow=shadow).astype(float)
    around = stars_per_field(unit, moments.cam_from_icrs, collar, shadow=shadow)
    if isinstance(envelope, OccultedEnvelope):
        stars[~envelope.usable(moments)] = BLIND
    return stars, stars + 0.01 * around, moments.cam_from_icrs
