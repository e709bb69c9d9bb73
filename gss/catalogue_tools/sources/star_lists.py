"""Convert a user's star list to a StarTable, with a report of every row that could not be used."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.corrections.fk4 import FK5_FROM_ICRS, from_b1950
from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR, tangent_basis
from gss.catalogue_tools.sources.star_list_files import RawList, frame_word, read_columns
from gss.catalogue_tools.sources.star_list_mapping import USUAL_UNITS, ListMapping, columns_of
from gss.catalogue_tools.sources.star_list_values import (
    BadRows,
    DroppedRow,
    check_ranges,
    number_of,
    numbering_of,
    numbers_of,
    require_clear_unit,
    require_numbers,
    unit_of,
)
from gss.domain.angles import Array, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.domain.stars import FLAG_NO_PROPER_MOTION, StarTable

REPORTED_ROWS = 100
MAX_CAMERA = 40
MAX_EPOCH = 100
"""Largest number of characters of a file's epoch or frame."""


@dataclass(frozen=True)
class ImportedList:
    """Result of reading a star list.

    ``stars``: ICRS at ``epoch_jyear``, in the order of the file. ``dropped``: the first hundred dropped rows.
    ``dropped_count``: number of dropped rows. ``columns``, ``units``: column and unit of each field. ``frame``: frame
    of the file. ``notes``: remarks for the user. ``camera``: camera for which the list was made, as the file states; ""
    if it states none.
    """

    stars: StarTable
    dropped: tuple[DroppedRow, ...]
    dropped_count: int
    columns: dict[str, str]
    units: dict[str, str]
    epoch_jyear: float
    frame: str
    notes: tuple[str, ...]
    camera: str = ""


def for_known_cameras(read: ImportedList, cameras: Collection[str]) -> ImportedList:
    """Return the list. If its camera is not among ``cameras``, the camera's name is replaced by a note."""
    if not read.camera or read.camera in cameras:
        return read
    note = f"made for {read.camera}, but no profile of this camera is installed"
    return replace(read, camera="", notes=(*read.notes, note))


def require_camera(camera: str, profile_name: str) -> None:
    """Raise BadInput if a list made for one camera is used with another; "" means any camera."""
    if camera and camera != profile_name:
        raise BadInput(
            "this star list is for another camera",
            expected=camera,
            got=profile_name,
            hint="choose the camera of the list, or a list without a camera",
        )


def read_star_list(data: bytes, kind: str, mapping: ListMapping | None = None) -> ImportedList:
    """Read the stars of a file.

    Raises BadInput with row and column if the list cannot be read. Single rows that cannot be used are reported.
    """
    mapping = mapping or ListMapping()
    raw = read_columns(data, kind)
    columns = columns_of(list(raw.columns), mapping)
    if not len(raw.rows) and raw.broken:
        number, reason, text = raw.broken[0]
        raise BadInput(
            "no row of the star list can be used",
            expected="as many values in each row as columns in the header",
            got=f"row {number}: {reason}: {text}",
            hint="check for a comma at the end of the rows, or decimal commas",
        )
    if not len(raw.rows):
        raise BadInput(
            "the star list is empty", expected="a header, then one row per star", got="a header without rows"
        )
    require_numbers(raw, columns)
    notes: list[str] = []
    units = {name: unit_of(name, column, raw, mapping) for name, column in columns.items() if name in USUAL_UNITS}
    epoch, frame = _epoch(raw, mapping), _frame(raw, columns, mapping)
    bad = BadRows(raw, columns)
    values = {name: numbers_of(name, columns[name], units[name], raw, bad) for name in units}
    require_clear_unit(values, units, columns, raw, mapping)
    check_ranges(values, bad)
    numbers, names, hip_numbers = numbering_of(raw, columns, bad, notes)
    good = bad.good()
    if mapping.bad_rows == "refuse" and bad.count():
        first = bad.report(1)[0]
        raise BadInput(
            f"row {first.row}, column {first.column}: {first.reason}",
            got=first.value,
            hint="correct the row, or choose to drop rows that cannot be used",
        )
    if not good.any():
        first = bad.report(1)[0]
        raise BadInput(
            "no row of the star list can be used",
            expected="stars",
            got=f"row {first.row}, {first.column}: {first.reason}: {first.value}",
        )
    stars = _table({name: value[good] for name, value in values.items()}, numbers[good], epoch, frame, mapping)
    stars = replace(stars, hip_numbers=hip_numbers)
    if "flags" in columns:
        stars = _flagged(stars, raw.columns[columns["flags"]][good])
    if any(names):
        stars.names.update(
            {int(n): names[i] for n, i in zip(numbers[good], np.flatnonzero(good), strict=True) if names[i]}
        )
    if "pm_ra" not in values or "pm_dec" not in values:
        notes.append(f"no proper motions: the positions of J{epoch:g} are used at every epoch")
    camera = (raw.camera or "").strip()[:MAX_CAMERA]
    return ImportedList(
        stars, bad.report(REPORTED_ROWS), bad.count(), columns, units, epoch, frame, tuple(notes), camera
    )


def read_with_mapping(data: bytes, kind: str, mapping: JsonObject) -> ImportedList:
    """Run :func:`read_star_list` with a column mapping given as plain values. This module imports no database, because
    the child processes that read files start with it."""
    return read_star_list(data, kind, ListMapping(**mapping))


def _epoch(raw: RawList, mapping: ListMapping) -> float:
    """Return the Julian year of the positions. Raises BadInput if it is missing, or if the file and the caller state
    different years."""
    stated = None
    if raw.epoch is not None:
        match = re.search(r"(B?)\s{0,8}(\d{4}(?:\.\d*)?)", raw.epoch[:MAX_EPOCH])
        if not match or len(raw.epoch) > MAX_EPOCH:
            got = raw.epoch[:MAX_EPOCH]
            raise BadInput("the star list's epoch is not a year", expected="a Julian year, for example 2016.0", got=got)
        stated = float(match[2])
        if match[1]:  # a Besselian year (Lieske 1979)
            stated = 2000.0 + (2415020.31352 + (stated - 1900.0) * 365.242198781 - 2451545.0) / 365.25
    mapped = mapping.epoch_jyear
    if stated is None and mapped is None:
        raise BadInput(
            "the star list does not state its epoch",
            expected="the year of the positions",
            hint="state it: option --list-epoch 2000 in the shell, field Epoch on the page",
        )
    if stated is not None and mapped is not None and not abs(stated - mapped) < 0.01:
        raise BadInput(
            "the star list has another epoch", expected=f"J{stated:g} (stated in the file)", got=f"J{mapped:g}"
        )
    epoch = stated if stated is not None else mapped
    assert epoch is not None  # noqa: S101  # checked above: one of the two is set
    low, high = EPOCH_RANGE_JYEAR
    if not low <= epoch <= high:
        raise BadInput(
            "the star list's epoch is out of range", expected=f"Julian year {low:g} to {high:g}", got=f"{epoch:g}"
        )
    return epoch


def _frame(raw: RawList, columns: dict[str, str], mapping: ListMapping) -> str:
    stated = None
    if raw.frame is not None:
        stated = frame_word(raw.frame)
        if stated is None and mapping.frame is None:
            raise BadInput(
                "the star list's frame is unknown",
                expected="ICRS | FK5 | FK4",
                got=raw.frame[:MAX_EPOCH],
                hint="state it: option --list-frame in the shell, field Axes on the page",
            )
    if stated is None:
        name = columns["ra"].lower()
        stated = next(
            (word for sign, word in (("icrs", "icrs"), ("1950", "b1950"), ("2000", "fk5")) if sign in name), None
        )
    if stated is not None and mapping.frame is not None and stated != mapping.frame:
        raise BadInput(
            "the star list is in another frame", expected=f"{stated} (stated in the file)", got=mapping.frame
        )
    frame = stated or mapping.frame
    if frame is None:
        raise BadInput(
            "the star list does not state its frame",
            expected="icrs | fk5 | b1950",
            hint="state it: option --list-frame in the shell, field Axes on the page",
        )
    return frame


def _table(
    values: dict[str, Array], numbers: NDArray[np.int32], epoch: float, frame: str, mapping: ListMapping
) -> StarTable:
    n = len(numbers)
    unknown, zero = np.full(n, np.nan), np.zeros(n)
    ra, dec = values["ra"], np.clip(values["dec"], -np.pi / 2, np.pi / 2)
    pm_ra, pm_dec = values.get("pm_ra", unknown), values.get("pm_dec", unknown)
    no_motion = ~(np.isfinite(pm_ra) & np.isfinite(pm_dec))
    pm_ra = np.where(no_motion, 0.0, pm_ra) * (1.0 if mapping.pm_ra_has_cos_dec else np.cos(dec))
    east, north = tangent_basis(ra, dec)
    unit, motion = unit_from_ra_dec(ra, dec), pm_ra[:, None] * east + np.where(no_motion, 0.0, pm_dec)[:, None] * north
    if frame == "b1950":
        moved = from_b1950(unit, motion, epoch, True)
        # A star without a stated proper motion is at rest in ICRS and not in FK4, which rotates.
        unit, motion = moved[0], np.where(no_motion[:, None], 0.0, moved[1])
    elif frame == "fk5":
        unit, motion = unit @ FK5_FROM_ICRS, motion @ FK5_FROM_ICRS
    parallax = values.get("parallax", zero)
    return StarTable(
        hip=numbers,
        icrs=unit,
        v_mag=values["v"],
        b_v=values.get("b_v", unknown),
        proper_motion_rad_yr=motion,
        parallax_rad=np.where(np.isfinite(parallax), parallax, 0.0),
        flags=np.where(no_motion, FLAG_NO_PROPER_MOTION, 0).astype(np.uint16),
        epoch_jyear=epoch,
        names={},
    )


def _flagged(stars: StarTable, flags: NDArray[Any]) -> StarTable:
    stated = np.nan_to_num(np.array([number_of(v) for v in flags])).astype(np.int64) & 0xFFFF
    return replace(stars, flags=(stars.flags | stated).astype(np.uint16))
