"""Variable stars to flag in a catalogue, and the magnitude of periodic variables on a date.

Jacobs 1995 Table A-1 lists the relevant variables with range and period. The table does not state the time of a maximum
or minimum, so a magnitude cannot be computed from it. For seven of its stars, the elements of the GCVS 5.1 are used
(Samus et al. 2017, Astron. Rep. 61, 80). For β Lyrae, whose period grows by 19 s a year, the elements of Ak et al. 2007
are used as quoted by Rucinski et al. 2019 (arXiv:1906.04831). Magnitudes are computed only for periodic stars; all
other variables are only flagged.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.corrections.corrections import DAYS_PER_YEAR, J2000_JYEAR
from gss.domain.stars import FLAG_VARIABLE, StarTable

J2000_JD = 2451545.0


@dataclass(frozen=True)
class TabledVariable:
    """A row of Jacobs 1995 Table A-1, identified manually in Hipparcos (the table mixes equinoxes 1950 and 2000 and
    has some misprints). ``period_d`` None: irregular."""

    hip: int
    kind: str
    bright_mag: float
    faint_mag: float
    period_d: float | None


@dataclass(frozen=True)
class Elements:
    """Light-curve elements of a periodic star.

    ``shape``: "eclipse" (constant outside the eclipses; ``width``: fraction of the period), "lyrae" (never constant) or
    "pulse" (``width``: fraction of the period that the rise takes). ``epoch_jd``: heliocentric Julian date of the
    minimum for eclipses, of the maximum for pulses. ``second_mag``: V in the second minimum.
    """

    hip: int
    name: str
    shape: str
    bright_mag: float
    faint_mag: float
    epoch_jd: float
    period_d: float
    width: float = 0.0
    second_mag: float | None = None


def _rows(kind: str, *rows: tuple[int, float, float, float | None]) -> tuple[TabledVariable, ...]:
    return tuple(TabledVariable(hip, kind, bright, faint, period) for hip, bright, faint, period in rows)


# The rows "05 29 −00 20" (δ Ori), "16 48 −37 58" (μ¹ Sco), "19 50 +00 53" (η Aql), "16 53 −30 30" (RR Sco),
# "18 18 −18 53" (Y Sgr) and "23 01 +27 49" (β Peg) apply to equinox 1950; "18 56 −62 15" is a second row for
# κ Pav (−67 15). η Carinae has no Hipparcos entry to V 8.
TABLE_A1 = (
    *_rows("Algol", (14576, 2.12, 3.4, 2.867), (18724, 3.3, 3.8, 3.9), (25930, 2.4, 2.6, 5.7), (38957, 4.7, 5.2, 1.45)),
    *_rows("Algol", (73473, 4.92, 5.9, 2.37)),
    *_rows("Beta Lyrae", (35412, 4.7, 5.5, 4.39), (74950, 5.4, 6.0, 2.16), (82514, 3.0, 3.3, 1.44)),
    *_rows("Beta Lyrae", (84573, 4.6, 5.3, 2.05), (92420, 3.34, 4.34, 12.93)),
    *_rows("Delta Cephei", (110991, 3.48, 4.37, 5.366), (30827, 5.0, 5.82, 3.7), (34088, 3.66, 4.16, 10.15)),
    *_rows("Delta Cephei", (47854, 3.28, 4.18, 35.53), (89968, 5.4, 6.1, 5.77), (93015, 3.91, 4.78, 9.09)),
    *_rows("Delta Cephei", (97804, 3.48, 4.39, 7.17), (98085, 5.28, 6.4, 8.38)),
    *_rows("Delta Scuti", (91726, 4.6, 4.79, 0.19)),
    *_rows("long period", (10826, 2.0, 10.1, 331.0), (13502, 4.7, 14.3, 403.97), (48036, 4.4, 11.3, 312.43)),
    *_rows("long period", (82912, 5.0, 12.2, 279.45), (97629, 3.3, 14.2, 406.93)),
    *_rows("RV Tauri", (92202, 4.45, 8.2, 140.05)),
    *_rows("semiregular", (21479, 4.8, 6.6, 338.0), (29655, 3.2, 3.9, 232.9), (34922, 2.6, 6.2, 140.42)),
    *_rows("semiregular", (27989, 0.4, 1.3, 2110.0), (80763, 0.88, 1.8, 1733.0), (84345, 3.0, 4.0, 2170.0)),
    *_rows("semiregular", (113881, 2.4, 2.8, 36.0)),
)
PERIODIC = (
    Elements(14576, "Algol", "eclipse", 2.12, 3.39, 2445641.5135, 2.8673043, 0.14),
    Elements(18724, "λ Tau", "eclipse", 3.37, 3.91, 2421506.8506, 3.9529478, 0.15, 3.54),
    Elements(92420, "β Lyr", "lyrae", 3.25, 4.36, 2458347.0119, 12.94379, second_mag=3.85),
    Elements(110991, "δ Cep", "pulse", 3.48, 4.37, 2455479.905, 5.366208, 0.25),
    Elements(97804, "η Aql", "pulse", 3.48, 4.33, 2450323.31, 7.176915, 0.32),
    Elements(34088, "ζ Gem", "pulse", 3.62, 4.18, 2443805.927, 10.15073, 0.50),
    Elements(10826, "Mira", "pulse", 2.0, 10.1, 2444839.0, 331.96, 0.38),
)


def magnitude_at(star: Elements, jyear: float) -> float:
    """Return the V magnitude of a periodic star at a Julian year. The light time to the Sun (8 min) is ignored. The
    periods change slowly, and the cycles of Mira differ by weeks, so the result is approximate."""
    days = (jyear - J2000_JYEAR) * DAYS_PER_YEAR + (J2000_JD - star.epoch_jd)
    phase = float(days / star.period_d % 1.0)
    depth = star.faint_mag - star.bright_mag
    if star.shape == "pulse":
        fall = 1 - star.width
        angle = phase / fall if phase < fall else 1 + (phase - fall) / star.width
        return star.bright_mag + depth * (1 - float(np.cos(np.pi * angle))) / 2
    second = 0.0 if star.second_mag is None else star.second_mag - star.bright_mag
    if star.shape == "lyrae":
        cos = float(np.cos(2 * np.pi * phase))
        return star.bright_mag + (depth if cos > 0 else second) * cos * cos
    return star.bright_mag + depth * _dip(phase, star.width) + second * _dip(phase - 0.5, star.width)


def flagged(stars: StarTable) -> StarTable:
    """Return the stars with the variables of Table A-1 flagged, in addition to the flags of Hipparcos. Stars without
    Hipparcos numbers are not flagged."""
    listed = np.isin(stars.hip, [row.hip for row in TABLE_A1]) & stars.hip_numbers
    return replace(stars, flags=np.where(listed, stars.flags | FLAG_VARIABLE, stars.flags).astype(np.uint16))


def at_date(stars: StarTable, jyear: float) -> StarTable:
    """Return the stars with the magnitudes of periodic variables at the date. The order of the rows is unchanged. Stars
    without Hipparcos numbers are unchanged."""
    v_mag = np.array(stars.v_mag, float)
    for star in PERIODIC:
        v_mag[(stars.hip == star.hip) & stars.hip_numbers] = magnitude_at(star, jyear)
    return replace(stars, v_mag=v_mag)


def _dip(phase: float, width: float) -> float:
    """Return the relative depth of an eclipse: 1 in the middle, 0 beyond half the width, a raised cosine in between."""
    away = abs((phase + 0.5) % 1.0 - 0.5)
    return float(1 + np.cos(2 * np.pi * away / width)) / 2 if away < width / 2 else 0.0
