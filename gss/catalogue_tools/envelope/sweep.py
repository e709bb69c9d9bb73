"""Sequence of fields of view across the envelope for the map: once around the orbit, or from the first to the last
day."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.envelope.attitude import SUN_LAWS
from gss.catalogue_tools.envelope.blocks import BlockEnvelope
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope, PatchEnvelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.several_heads import HeadsEnvelope
from gss.domain.angles import Array

STEPS = 48
# Number of points per side. The map draws great circles between the points, which is exact for a lens without
# distortion.
PER_SIDE = 4
MIDDLE = 0.5
# Indices of the argument of latitude and of the fraction of validity in an envelope's coordinates.
LATITUDE_AXIS, PART_AXIS = 2, 0


@dataclass(frozen=True)
class Sweep:
    """Sequence of fields. ``over``: orbit, validity, or "" if the field does not move. ``fields``: (n, k, 3) closed
    ICRS outlines. ``boresights``: (n, 3) ICRS directions.

    Attitude and inclination are in the middle of their limits. For a sweep over an orbit, the date is also in the
    middle.
    """

    over: str
    fields: Array
    boresights: Array


def sweep(base: Envelope, shape: FieldShape, steps: int = STEPS) -> Sweep:
    """Compute one field for each of ``steps`` moments. The whole sky has no field, an inertial camera has one.

    ``base``: the envelope before occultation; if it has several heads, the first is shown. ``shape``: field of view
    without the margin.
    """
    if isinstance(base, HeadsEnvelope):
        return sweep(base.heads[0], shape, steps)
    over, axis = _moves(base)
    count = steps if over else int(axis is not None)
    cube = np.full((count, base.dimensions), MIDDLE)
    if over and axis is not None:
        # An orbit is periodic, so its end point is omitted. A validity includes both ends.
        cube[:, axis] = np.linspace(0.0, 1.0, count, endpoint=over == "validity")
    cam_from_icrs = base.at(cube).cam_from_icrs if count else np.empty((0, 3, 3))
    return Sweep(over, outlines(shape, cam_from_icrs), cam_from_icrs[:, 2])


def outlines(shape: FieldShape, cam_from_icrs: Array) -> Array:
    """Return (n, 4·PER_SIDE + 1, 3) closed ICRS outlines of the fields of (n, 3, 3) attitudes."""
    edge = shape.edge(np.linspace(0.0, 4.0, 4 * PER_SIDE + 1))
    return np.asarray(edge @ cam_from_icrs)


def _moves(base: Envelope) -> tuple[str, int | None]:
    """Return the name of the interval over which the field moves, and the index of that coordinate in the envelope;
    None if there is no field to show."""
    if isinstance(base, BandEnvelope | BlockEnvelope):
        return "orbit", LATITUDE_AXIS
    if isinstance(base, PatchEnvelope):
        return ("validity" if base.limits.pointing in SUN_LAWS else ""), PART_AXIS
    return "", None
