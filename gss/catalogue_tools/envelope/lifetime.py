"""Time for which a catalogue remains useful after the end of its validity. It ends when the drift has moved too large a
part of the fields out of the envelope.

The node drift and the margin give the number of days between two uploads (Moniteq 1983 §2.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np

from gss.catalogue_tools.envelope.attitude import SUN_LAWS, base_from_icrs
from gss.catalogue_tools.envelope.envelope import BandEnvelope, Envelope, PatchEnvelope
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.views import cams_within
from gss.catalogue_tools.selection.counting import fields_per_star
from gss.domain.angles import Array
from gss.domain.errors import BadInput

NSIDE = 32
CURVE_POINTS = 25
SUN_ATTITUDES = 1000


@dataclass(frozen=True)
class Lifetime:
    """Lifetime of an envelope. ``days``: time from the end of validity until the fraction of the visible sky inside the
    envelope falls below ``threshold``; infinite if it never falls below. ``until``: date of this time. ``days_curve``,
    ``share_curve``: (k,) days and (k,) fractions."""

    threshold: float
    days: float
    until: datetime | None
    days_curve: Array
    share_curve: Array


def lifetime(
    envelope: Envelope,
    rate_rad_day: float,
    valid_to: datetime | None = None,
    threshold: float = 0.95,
    longest_days: float = 366.0,
) -> Lifetime:
    """Compute when an envelope has drifted out of use.

    ``rate_rad_day``: rate of the node for laws that turn with the orbit, rate of the Sun for laws that follow the Sun.
    Envelopes of other laws do not expire. Occultation by Earth, Sun and Moon is ignored. Raises BadInput if an argument
    is out of range.
    """
    if not 0 < threshold <= 1:
        raise BadInput("threshold is out of range", expected="above 0, at most 1", got=f"{threshold:g}")
    if not (np.isfinite(rate_rad_day) and 0 < longest_days < 1e5):
        raise BadInput(
            "drift and days must be numbers", expected="finite, days above 0", got=f"{rate_rad_day}, {longest_days}"
        )
    base = getattr(envelope, "base", getattr(envelope, "band", envelope))
    drifting = isinstance(base, BandEnvelope) or (isinstance(base, PatchEnvelope) and base.limits.pointing in SUN_LAWS)
    if not drifting or rate_rad_day == 0:
        return Lifetime(threshold, float("inf"), None, np.array([0.0, longest_days]), np.ones(2))
    grid = centres(NSIDE)
    # For laws that follow the Sun, the sampled map is accurate enough and many times faster.
    in_base = base.contains(grid) if isinstance(base, BandEnvelope) else base.time_fraction(grid) > 0

    def share(days: float) -> float:
        visible = _seen_after(base, rate_rad_day * days, grid)
        return float(visible[in_base].sum() / max(float(visible.sum()), 1e-300))

    # After a full rotation of the node, the fraction is 1 again. Therefore the first time below the threshold is used.
    longest = min(longest_days, 2 * np.pi / abs(rate_rad_day))
    days_curve = np.linspace(0, longest, CURVE_POINTS)
    share_curve = np.array([share(float(d)) for d in days_curve])
    below = np.flatnonzero(share_curve < threshold)
    if not len(below):
        return Lifetime(threshold, float("inf"), None, days_curve, share_curve)
    last = float(days_curve[below[0]])
    first = float(days_curve[max(below[0] - 1, 0)])
    while last - first > 0.01:
        middle = (first + last) / 2
        first, last = (middle, last) if share(middle) >= threshold else (first, middle)
    until = None if valid_to is None else valid_to + timedelta(days=first)
    return Lifetime(threshold, first, until, days_curve, share_curve)


def _seen_after(base: Envelope, angle_rad: float, grid: Array) -> Array:
    """Return the (n,) fraction of time in the field, with node or Sun advanced by the angle from the end of
    validity."""
    if isinstance(base, BandEnvelope):
        raan = np.array([base.orbit.raan_end_rad + angle_rad])
        return base.share_in_planes(grid, raan, np.array([np.mean(base.orbit.inclination_rad)]))
    if isinstance(base, PatchEnvelope):
        sun = base.sun_longitude_rad[1] + angle_rad
        cams = cams_within(base.limits, SUN_ATTITUDES, 0) @ base_from_icrs(base.limits, np.array([sun]))
        return np.asarray(fields_per_star(grid, cams, base.shape) / SUN_ATTITUDES)
    return np.zeros(len(grid))
