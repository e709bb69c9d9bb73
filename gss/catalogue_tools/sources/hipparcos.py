"""Hipparcos stars, and their positions at other epochs. Provenance: docs/star-table.md.

Simulation and matching use the stars to V 8 (``load_stars``). More sensitive cameras use the whole catalogue
(``load_hipparcos``).
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ARCSEC_RAD, Array, unit_from_ra_dec
from gss.domain.errors import BadInput, CorruptData
from gss.domain.stars import StarTable

MAS_RAD = ARCSEC_RAD / 1000.0
FAINTEST_V_MAG = 8.0
EPOCH_RANGE_JYEAR = (1800.0, 2200.0)
UNKNOWN_COLOUR = -32768
HIP2_STARS = 117_955
# The main table adds 17 stars that hip2 lacks.
ALL_STARS = 117_972
MAIN_STARS = 41_411
FAINTEST_HIPPARCOS_V_MAG = 14.6
# Expected properties of a valid star table: the epoch J1991.25, and the brightest stars of the sky in the first rows.
TABLE_EPOCH_JYEAR = 1991.25
BRIGHTEST_HIP = (32349, 30438, 69673, 71683, 91262)


def load_stars(v_max: float = FAINTEST_V_MAG) -> StarTable:
    """Return the stars with V ≤ ``v_max``, brightest first, at J1991.25 in ICRS. The arrays are shared and read-only.

    Raises BadInput if ``v_max`` is fainter than the table or brighter than every star.
    """
    if not v_max <= FAINTEST_V_MAG:
        raise BadInput(
            "the star table does not reach this magnitude limit", expected=f"V ≤ {FAINTEST_V_MAG:g}", got=f"{v_max:g}"
        )
    stars = _all_stars()
    count = int(np.searchsorted(stars.v_mag, v_max, side="right"))
    if not count:
        raise BadInput("no star is brighter than this limit", expected=f"V ≥ {stars.v_mag[0]:g}", got=f"{v_max:g}")
    return stars.take(slice(0, count))  # type: ignore[arg-type]  # a slice keeps views of the read-only arrays


def load_hipparcos(v_max: float = FAINTEST_HIPPARCOS_V_MAG) -> StarTable:
    """Return the whole Hipparcos catalogue with V ≤ ``v_max``, brightest first, at J1991.25 in ICRS: 117 972 stars,
    complete to about V 7.5.

    Beyond V 8 the magnitudes are derived from Hipparcos photometry. The arrays are shared and read-only. Raises
    BadInput if ``v_max`` is fainter than the catalogue.
    """
    if not v_max <= FAINTEST_HIPPARCOS_V_MAG:
        raise BadInput(
            "Hipparcos does not reach this magnitude limit",
            expected=f"V ≤ {FAINTEST_HIPPARCOS_V_MAG:g}",
            got=f"{v_max:g}",
        )
    if v_max <= FAINTEST_V_MAG:
        return load_stars(v_max)
    stars = _everything()
    return stars.take(slice(0, int(np.searchsorted(stars.v_mag, v_max, side="right"))))  # type: ignore[arg-type]  # a view


def propagate(stars: StarTable, epoch_jyear: float) -> StarTable:
    """Return the same stars at another Julian year, in uniform straight-line motion with no radial velocity.

    The computation uses vectors, so the poles need no special treatment. Proper motion and parallax change consistently
    (ESA 1997 vol. 1 §1.5.5, without the radial terms, because hip2 has no radial velocities). Raises BadInput if the
    epoch is out of range.
    """
    low, high = EPOCH_RANGE_JYEAR
    if not low <= epoch_jyear <= high:
        raise BadInput("epoch is out of range", expected=f"Julian year {low:g} to {high:g}", got=f"{epoch_jyear:g}")
    moved = stars.icrs + stars.proper_motion_rad_yr * (epoch_jyear - stars.epoch_jyear)
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    unit = moved / length
    motion = stars.proper_motion_rad_yr
    tangent = (motion - unit * np.sum(unit * motion, axis=1, keepdims=True)) / length
    return replace(
        stars,
        icrs=unit,
        proper_motion_rad_yr=tangent,
        parallax_rad=stars.parallax_rad / length[:, 0],
        epoch_jyear=float(epoch_jyear),
    )


def joined(first: StarTable, second: StarTable) -> StarTable:
    """Return the rows of both tables. If the names of a star differ, the name in the first table is used. Raises
    BadInput if the epochs differ."""
    if first.epoch_jyear != second.epoch_jyear:
        raise BadInput(
            "tables of two epochs cannot be joined", expected=f"J{first.epoch_jyear:g}", got=f"J{second.epoch_jyear:g}"
        )
    return StarTable(
        hip=np.concatenate([first.hip, second.hip]),
        icrs=np.concatenate([first.icrs, second.icrs]),
        v_mag=np.concatenate([first.v_mag, second.v_mag]),
        b_v=np.concatenate([first.b_v, second.b_v]),
        proper_motion_rad_yr=np.concatenate([first.proper_motion_rad_yr, second.proper_motion_rad_yr]),
        parallax_rad=np.concatenate([first.parallax_rad, second.parallax_rad]),
        flags=np.concatenate([first.flags, second.flags]),
        epoch_jyear=first.epoch_jyear,
        names={**second.names, **first.names} if second.names else first.names,
    )


def photometry() -> dict[str, Array]:
    """Return Hp and V−I of the rows of ``load_stars()``, to check V; NaN if hip2 lacks the star."""
    columns = _columns()
    return {"hp_mag": columns["hp_mag"].astype(float), "v_i": columns["v_i"].astype(float)}


def tangent_basis(ra_rad: Array, dec_rad: Array) -> tuple[Array, Array]:
    """Return (n, 3) unit vectors to the east and to the north at each position."""
    zero = np.zeros_like(ra_rad)
    east = np.stack([-np.sin(ra_rad), np.cos(ra_rad), zero], axis=-1)
    sin_dec = np.sin(dec_rad)
    north = np.stack([-sin_dec * np.cos(ra_rad), -sin_dec * np.sin(ra_rad), np.cos(dec_rad)], axis=-1)
    return east, north


@lru_cache(maxsize=2)
def _columns(name: str = "stars.npz") -> dict[str, NDArray[np.generic]]:
    with (files(__package__) / "data" / name).open("rb") as file, np.load(file) as archive:
        return {name: archive[name] for name in archive.files}


@lru_cache(maxsize=1)
def other_names() -> dict[int, tuple[str, ...]]:
    """Return the names that stars have beside the name in the star table, by Hipparcos number: Bayer, Flamsteed and
    variable-star designations."""
    lines = _columns()["other_names"].tobytes().decode().split("\n")
    return {int(hip): tuple(names) for hip, *names in (line.split("\t") for line in lines)}


@lru_cache(maxsize=1)
def _all_stars() -> StarTable:
    c = _columns()
    names = (line.split("\t", 1) for line in c["names"].tobytes().decode().split("\n"))
    stars = _table(c, {int(hip): name for hip, name in names})
    _check(stars, FAINTEST_V_MAG)
    return stars


@lru_cache(maxsize=1)
def _everything() -> StarTable:
    stars = _read_only(joined(_all_stars(), _table(_columns("stars_faint.npz"), {})))
    _check(stars, FAINTEST_HIPPARCOS_V_MAG)
    if len(stars) != ALL_STARS:
        raise CorruptData("the star tables are incomplete", expected=f"{ALL_STARS} stars", got=str(len(stars)))
    return stars


def _table(c: dict[str, NDArray[np.generic]], names: dict[int, str]) -> StarTable:
    ra, dec = c["ra_rad"].astype(float), c["dec_rad"].astype(float)
    east, north = tangent_basis(ra, dec)
    motion = c["pm_ra_cos_dec_mas_yr"].astype(float)[:, None] * east + c["pm_dec_mas_yr"].astype(float)[:, None] * north
    colour = c["b_v"].astype(float)
    return _read_only(
        StarTable(
            hip=c["hip"].astype(np.int32),
            icrs=unit_from_ra_dec(ra, dec),
            v_mag=c["v_mag"].astype(float) / 100,
            b_v=np.where(colour == UNKNOWN_COLOUR, np.nan, colour / 1000),
            proper_motion_rad_yr=motion * MAS_RAD,
            parallax_rad=c["parallax_mas"].astype(float) * MAS_RAD,
            flags=c["flags"].astype(np.uint16),
            epoch_jyear=float(c["epoch_jyear"].astype(float)),
            names=names,
        )
    )


def _read_only(stars: StarTable) -> StarTable:
    for array in vars(stars).values():
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return stars


def _check(stars: StarTable, faintest_v_mag: float) -> None:
    """Raise CorruptData if the star table is damaged or is not the expected table."""
    facts = {
        "epoch": (TABLE_EPOCH_JYEAR, stars.epoch_jyear),
        "brightest stars": (BRIGHTEST_HIP, tuple(int(h) for h in stars.hip[: len(BRIGHTEST_HIP)])),
        "order": (True, bool(np.all(np.diff(stars.v_mag) >= 0) and stars.v_mag[-1] <= faintest_v_mag)),
        "stars to V 8": (MAIN_STARS, int(np.searchsorted(stars.v_mag, FAINTEST_V_MAG, side="right"))),
        "stars of each number": (1, int(np.bincount(stars.hip).max())),
        "positions": (True, bool(np.isfinite(stars.icrs).all())),
    }
    for name, (expected, got) in facts.items():
        if expected != got:
            raise CorruptData(f"the star table failed a check: {name}", expected=str(expected), got=str(got))
