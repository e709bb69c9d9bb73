"""Compiled search for the stars near a direction, with the sky cells of :mod:`gss.skytables.cells`."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

from gss.pipeline.loops import loop

ROUNDING_RAD = 1e-6
"""Larger than the rounding errors of the arccosine, which are largest at small angles."""


@loop
def room_near(cells, z, cosine):
    """Return an upper bound of the number of stars that :func:`stars_near` lists."""
    middle, cos_extent, sin_extent, first, _, widest_rad = cells
    sine, room = math.sqrt(max(1 - cosine * cosine, 0.0)), 0
    begin, end = _cells_at_height(z, cosine, widest_rad, len(middle))
    for c in range(begin, end):
        near = middle[c, 0] * z[0] + middle[c, 1] * z[1] + middle[c, 2] * z[2]
        if not _too_far(near, cosine, sine, cos_extent[c], sin_extent[c]):
            room += first[c + 1] - first[c]
    return room


@loop
def _cells_at_height(z, cosine, widest_rad, count):
    """Return the range of the cells that can contain stars whose angle from ``z`` has a cosine above ``cosine``, as far as the
    third component of their centres shows."""
    reach_rad = math.acos(min(max(cosine, -1.0), 1.0)) + widest_rad + ROUNDING_RAD
    from_pole_rad = math.acos(min(max(z[2], -1.0), 1.0))
    top, bottom = math.cos(max(from_pole_rad - reach_rad, 0.0)), math.cos(min(from_pole_rad + reach_rad, math.pi))
    # The third component of centre c is 1 - (2 c + 1) / count.
    begin = math.ceil((count * (1 - top) - 1) / 2)
    end = math.floor((count * (1 - bottom) - 1) / 2) + 1
    return max(begin, 0), min(end, count)


@loop
def _too_far(near, cosine, sine, cos_extent, sin_extent):
    """True if no star of a cell is within reach. Never True if reach and extent together exceed half a circle."""
    return cos_extent > -cosine and near < cosine * cos_extent - sine * sin_extent - 1e-12


@loop
def stars_near(icrs, cells, z, cosine, below, out):
    """Write the rows below ``below`` of the stars whose angle from ``z`` has a cosine above ``cosine``. Return the
    number of rows written."""
    middle, cos_extent, sin_extent, first, star, widest_rad = cells
    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
    count = 0
    begin, end = _cells_at_height(z, cosine, widest_rad, len(middle))
    for c in range(begin, end):
        near = middle[c, 0] * z[0] + middle[c, 1] * z[1] + middle[c, 2] * z[2]
        if _too_far(near, cosine, sine, cos_extent[c], sin_extent[c]):
            continue
        for k in range(first[c], first[c + 1]):
            s = star[k]
            if s >= below:
                break
            if icrs[s, 0] * z[0] + icrs[s, 1] * z[1] + icrs[s, 2] * z[2] > cosine:
                out[count] = s
                count += 1
    return count
