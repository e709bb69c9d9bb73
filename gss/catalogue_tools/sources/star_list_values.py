"""Values of a star list: convert columns to numbers, and mark rows with missing or impossible values."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.sources.star_list_files import RawList
from gss.catalogue_tools.sources.star_list_mapping import (
    SEXAGESIMAL,
    USUAL_UNITS,
    ListMapping,
    factor_of,
    plain_unit,
    unit_in_name,
)
from gss.domain.angles import ARCSEC_RAD, TWO_PI_RAD, Array
from gss.domain.errors import BadInput

# Sirius is the brightest star. No star camera detects stars fainter than the upper limit.
V_RANGE_MAG = (-2.0, 25.0)
B_V_RANGE_MAG = (-1.0, 8.0)
# Barnard's star moves 10.4″ per year; Proxima's parallax is 0.77″.
FASTEST_RAD_YR = 20.0 * ARCSEC_RAD
MAX_PARALLAX_RAD = 1.0 * ARCSEC_RAD
# Tolerance for positions at an end of their range.
ROUNDING_RAD = 1e-9
MAX_NUMBER = 2**31 - 1
MAX_NUMBER_LENGTH = 100
"""Maximum number of characters of a value, because the regular expression NUMBERS can backtrack on long blank text."""
# Minimum number of rows for guessing a unit.
MIN_INFORMATIVE_ROWS = 20
NUMBERS = re.compile(
    r"^\s*([+-]?)\s*(\d+(?:\.\d*)?)(?:[\s:hd°]+(\d+(?:\.\d*)?))?(?:[\s:m'′]+(\d+(?:\.\d*)?))?[\s\"″s]*$"
)


@dataclass(frozen=True)
class DroppedRow:
    """A row that was not imported. ``row``: row number, from 1 after the header. ``column``: column of the file with
    the error. ``value``: content of that column."""

    row: int
    column: str
    reason: str
    value: str


class BadRows:
    """Rows that cannot be used, with the first reason for each."""

    def __init__(self, raw: RawList, columns: dict[str, str]) -> None:
        self._raw, self._columns = raw, columns
        self._reason = np.zeros(len(raw.rows), np.int32)
        self._reasons: list[tuple[str, str]] = []

    def mark(self, which: NDArray[np.bool_], name: str, reason: str) -> None:
        """Mark the rows of a mask as bad because of a field."""
        self._reasons.append((name, reason))
        self._reason[which & (self._reason == 0)] = len(self._reasons)

    def good(self) -> NDArray[np.bool_]:
        return np.asarray(self._reason == 0)

    def count(self) -> int:
        return int(np.count_nonzero(self._reason)) + len(self._raw.broken)

    def report(self, limit: int) -> tuple[DroppedRow, ...]:
        """Return at most ``limit`` bad rows, in the order of the file."""
        dropped = [DroppedRow(row, "", reason, text) for row, reason, text in self._raw.broken]
        for i in np.flatnonzero(self._reason)[:limit]:
            name, reason = self._reasons[self._reason[i] - 1]
            column = self._columns[name]
            dropped.append(DroppedRow(int(self._raw.rows[i]), column, reason, str(self._raw.columns[column][i])[:60]))
        return tuple(sorted(dropped, key=lambda row: row.row)[:limit])


def require_numbers(raw: RawList, columns: dict[str, str]) -> None:
    """Raise BadInput for boolean or complex columns. Text can contain numbers and is checked row by row."""
    for name, column in columns.items():
        kind = raw.columns[column].dtype.kind
        if name != "name" and kind in "bc":
            raise BadInput(
                f"column {column} cannot be {name}",
                expected="numbers or text",
                got="truth values" if kind == "b" else "complex numbers",
            )


def unit_of(name: str, column: str, raw: RawList, mapping: ListMapping) -> str:
    """Return the unit of a field: from the mapping if set there, otherwise as stated in the file, otherwise from the
    column's name, otherwise the usual unit."""
    unit = mapping.units.get(name) or raw.units.get(column)
    if unit is not None:
        return plain_unit(name, unit)
    if name in ("ra", "dec") and _is_text(raw.columns[column]) and _looks_sexagesimal(raw.columns[column]):
        return SEXAGESIMAL
    return unit_in_name(name, column) or USUAL_UNITS[name]


def _is_text(values: NDArray[Any]) -> bool:
    return values.dtype.kind not in "iufb"


def _looks_sexagesimal(values: NDArray[Any]) -> bool:
    first = next((str(v).strip() for v in values if str(v).strip()), "")
    return bool(re.match(r"^[+-]?\d+[\s:hd°]+\d+", first[:MAX_NUMBER_LENGTH]))


def numbers_of(name: str, column: str, unit: str, raw: RawList, bad: BadRows) -> Array:
    """Convert a field to radians, radians per year or magnitudes. Empty values become NaN. Rows with values that are
    not numbers are marked as bad."""
    values = raw.columns[column]
    if unit == SEXAGESIMAL:
        degrees = np.array([_degrees(str(v), 15.0 if name == "ra" else 1.0) for v in values])
        bad.mark(np.isnan(degrees), name, "not hours or degrees, minutes and seconds")
        return np.asarray(np.radians(degrees))
    if not _is_text(values):
        return values.astype(np.float64) * factor_of(name, unit)
    try:
        return values.astype(np.float64) * factor_of(name, unit)
    except (ValueError, TypeError):
        numbers = np.array([number_of(v) for v in values])
        empty = np.array(
            [not str(v).strip() or str(v).strip().lower() in ("nan", "null", "none", "--") for v in values]
        )
        bad.mark(np.isnan(numbers) & ~empty, name, "not a number")
        return np.asarray(numbers * factor_of(name, unit))


def number_of(value: object) -> float:
    """Parse the number in a text; NaN if there is none."""
    text = str(value)
    try:
        return float(text) if len(text) <= MAX_NUMBER_LENGTH else np.nan
    except ValueError:
        return np.nan


def _degrees(text: str, scale: float) -> float:
    match = NUMBERS.match(text) if len(text) <= MAX_NUMBER_LENGTH else None
    if not match:
        return np.nan
    degrees_or_hours, minutes, seconds = (float(part or 0) for part in match.groups()[1:])
    if minutes >= 60 or seconds >= 60:
        return np.nan
    return (-1 if match[1] == "-" else 1) * scale * (degrees_or_hours + minutes / 60 + seconds / 3600)


def require_clear_unit(
    values: dict[str, Array], units: dict[str, str], columns: dict[str, str], raw: RawList, mapping: ListMapping
) -> None:
    """Raise BadInput if right ascensions without a stated unit look like hours or radians. Read as degrees, they would
    place all stars in a small part of the sky."""
    if units["ra"] != "deg" or "ra" in mapping.units or columns["ra"] in raw.units or unit_in_name("ra", columns["ra"]):
        return
    ra, dec = np.degrees(values["ra"]), np.degrees(values["dec"])
    if np.count_nonzero(np.isfinite(ra)) < MIN_INFORMATIVE_ROWS:
        return
    low, high, dec_end = float(np.nanmin(ra)), float(np.nanmax(ra)), float(np.nanmax(np.abs(dec)))
    # Only ranges that look like a full circle in hours or radians are rejected. A small field in degrees is accepted.
    if 20 < high <= 24 and 0 <= low < 4:
        guess = "hourangle"
    elif 5 < high <= TWO_PI_RAD + 1e-6 and 0 <= low < 1.3 and dec_end <= np.pi / 2 + 1e-6:
        guess = "rad"
    else:
        return
    raise BadInput(
        f"the unit of column {columns['ra']} is not clear",
        expected=f"right ascensions up to 360 if they are degrees; is the unit {guess}?",
        got=f"values from {low:g} to {high:g}, declinations up to {dec_end:g}",
        hint=f'state it: units = {{"ra": "{guess}", …}}, or "deg" if they are',
    )


def check_ranges(values: dict[str, Array], bad: BadRows) -> None:
    """Mark rows without position or magnitude, or with impossible values. An impossible colour becomes NaN."""
    for name in ("ra", "dec", "v"):
        bad.mark(~np.isfinite(values[name]), name, "empty")
    ra, dec, v_mag = values["ra"], values["dec"], values["v"]
    with np.errstate(invalid="ignore"):
        bad.mark((ra < -np.pi - ROUNDING_RAD) | (ra > 2 * np.pi + ROUNDING_RAD), "ra", "right ascension out of range")
        bad.mark(np.abs(dec) > np.pi / 2 + ROUNDING_RAD, "dec", "declination beyond a pole")
        bad.mark((v_mag < V_RANGE_MAG[0]) | (v_mag > V_RANGE_MAG[1]), "v", "no star has this magnitude")
        for name, limit, reason in (
            ("pm_ra", FASTEST_RAD_YR, "no star moves so fast"),
            ("pm_dec", FASTEST_RAD_YR, "no star moves so fast"),
            ("parallax", MAX_PARALLAX_RAD, "no star is so near"),
        ):
            if name in values:
                bad.mark(np.abs(values[name]) > limit, name, reason)
        if "b_v" in values:
            colour = values["b_v"]
            values["b_v"] = np.where((colour > B_V_RANGE_MAG[0]) & (colour < B_V_RANGE_MAG[1]), colour, np.nan)


def numbering_of(
    raw: RawList, columns: dict[str, str], bad: BadRows, notes: list[str]
) -> tuple[NDArray[np.int32], list[str], bool]:
    """Return the numbers of the stars, their names ("" for none), and True if the numbers are Hipparcos numbers.

    Numbers that fit in 32 bits are used. If the column contains text or longer numbers, its values become names and the
    stars are numbered by row.
    """
    count = len(raw.rows)
    names = [_text(v) for v in raw.columns[columns["name"]]] if "name" in columns else [""] * count
    serial = np.arange(1, count + 1, dtype=np.int32)
    if "id" not in columns:
        notes.append("no column with star numbers: stars are numbered by row")
        return serial, [name or f"row {n}" for n, name in enumerate(names, 1)], False
    column = raw.columns[columns["id"]]
    numbers = np.array([number_of(v) for v in column]) if _is_text(column) else column.astype(float)
    is_star_number = np.isfinite(numbers) & (numbers == np.floor(numbers)) & (numbers >= 1)
    if not is_star_number.any() or np.nanmax(numbers) > MAX_NUMBER:
        notes.append(
            f"{columns['id']} is not a number of at most ten digits: stars are numbered by row and named by this column"
        )
        texts = [_text(v) for v in column]
        names = [name or text for name, text in zip(names, texts, strict=True)]
        bad.mark(_repeated(np.array(texts, np.str_), bad.good()), "id", "named twice")
        return serial, names, False
    bad.mark(~is_star_number, "id", "not a star number")
    bad.mark(_repeated(numbers, bad.good()), "id", "numbered twice")
    whole_numbers = np.where(is_star_number, numbers, 0).astype(np.int32)
    hip_numbers = columns["id"].lower().startswith("hip")
    if not hip_numbers:
        # A star of another list gets a name with its number. Otherwise the number would be displayed as a Hipparcos or
        # Gaia number.
        names = [
            name or f"{columns['id']} {number}" for name, number in zip(names, whole_numbers.tolist(), strict=True)
        ]
    return whole_numbers, names, hip_numbers


def _text(value: object) -> str:
    return "" if value != value else str(value).strip()


def _repeated(values: NDArray[Any], among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of repeated values in the good rows; the first of equal values is not marked."""
    rows = np.flatnonzero(among)
    _, first = np.unique(values[rows], return_index=True)
    again = np.zeros(len(values), bool)
    again[np.delete(rows, first)] = True
    return again
