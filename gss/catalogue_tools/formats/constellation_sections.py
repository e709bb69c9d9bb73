"""Liebe's triplet database in sections: its classes, and the constellations by type of uncertainty (Liebe 1992)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gss.catalogue_tools.formats.blocks import Block, Columns, to_columns
from gss.domain.errors import BadInput, CorruptData
from gss.skytables.triplets import MAX_ANGLE, MAX_DISTANCE, Constellations, TripletClasses

CONSTELLATION_KINDS = {"TCER": 0, "TMAY": 1, "TEXC": 2}
NAMES = ("certain", "maybe", "exchanged")
CLASSES = ("distance_rad", "angle_rad", "uncertainty_rad", "limit_mag", "brightness_error", "max_rad")
COLUMNS = (("star", "<u2"), ("first", "<u2"), ("second", "<u2"), ("angle_low", "<u1"), ("angle_high", "<u1"))


def class_blocks() -> tuple[Block, ...]:
    """Block of the classes: one record of f64."""
    return (Block("triplet_classes", np.dtype([(name, "<f8") for name in CLASSES]), 1),)


def class_columns(constellations: Constellations) -> Columns:
    """Return the columns of the classes."""
    numbers = {name: getattr(constellations.classes, name) for name in CLASSES[:3]}
    numbers |= {name: getattr(constellations, name) for name in CLASSES[3:]}
    return {name: np.array([value], float) for name, value in numbers.items()}


def constellation_blocks(kind: int, count: int) -> tuple[Block, ...]:
    """Blocks of the constellations of one kind: five columns."""
    return tuple(Block(f"triplets_{NAMES[kind]}", np.dtype(t), count, name) for name, t in COLUMNS)


def constellation_columns(constellations: Constellations, kind: int) -> Columns:
    """Return the columns of the constellations of one kind."""
    which = np.flatnonzero(constellations.kind == kind)
    return {name: getattr(constellations, name)[which] for name, _ in COLUMNS}


def read_constellations(content: Mapping[str, bytes], stars: int) -> Constellations:
    """Return the constellations of all kinds. A kind that the bank does not contain is empty. Raises CorruptData if a
    section is not valid."""
    if "TCLS" not in content:
        raise CorruptData("triplets without their classes", expected="section TCLS", got=", ".join(content))
    classes = {k: float(v[0]) for k, v in to_columns(class_blocks(), content["TCLS"]).items()}
    parts: list[Columns] = []
    kinds = []
    for tag, kind in CONSTELLATION_KINDS.items():
        data = content.get(tag, b"")
        columns = to_columns(constellation_blocks(kind, len(data) // 8), data)
        parts.append(columns)
        kinds.append(np.full(len(columns["star"]), kind, np.uint8))
    joined = {name: np.concatenate([p[name] for p in parts]).astype(np.int32) for name, _ in COLUMNS}
    _check(joined, stars)
    try:
        triplet_classes = TripletClasses(*(classes[name] for name in CLASSES[:3]))
    except BadInput as error:
        raise CorruptData(
            "the classes of the triplets are inconsistent", expected=error.expected, got=error.got
        ) from None
    return Constellations(
        np.concatenate(kinds),
        joined["star"],
        joined["first"],
        joined["second"],
        joined["angle_low"],
        joined["angle_high"],
        stars,
        triplet_classes,
        classes["limit_mag"],
        classes["brightness_error"],
        classes["max_rad"],
    )


def _check(columns: Columns, stars: int) -> None:
    if not len(columns["star"]):
        return
    if columns["star"].max() >= stars:
        raise CorruptData("a triplet refers to a star that is not in the list", expected=f"below {stars}")
    fits = (columns["angle_low"] <= columns["angle_high"]) & (columns["angle_high"] <= MAX_ANGLE)
    fits &= np.maximum(columns["first"], columns["second"]) <= MAX_DISTANCE + 1
    if not fits.all():
        raise CorruptData(
            "the classes of a triplet are out of range", expected="at most 12 bits and 6 bits, angles in order"
        )
