"""The real sky: Hipparcos stars to V 8, and where they are at another epoch. Provenance: docs/star-table.md."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ARCSEC_RAD, Array, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable

MAS_RAD = ARCSEC_RAD / 1000.0
FAINTEST_V_MAG = 8.0
EPOCH_RANGE_JYEAR = (1800.0, 2200.0)
UNKNOWN_COLOUR = -32768
HIP2_STARS = 117_955
# V = Hp − g(V−I), fifth order, highest power first; robust fit to the joined table (rms 0.013 mag).
HP_MINUS_V_OF_V_I = (-0.00868878, 0.06427474, -0.14456331, -0.00350839, 0.25028408, -0.00038726)


def load_stars(v_max: float = FAINTEST_V_MAG) -> StarTable:
    """The stars with V ≤ ``v_max``, brightest first, at J1991.25 in ICRS. The arrays are shared and read-only."""
    if not v_max <= FAINTEST_V_MAG:
        raise BadInput("the star table is not that deep", expected=f"V ≤ {FAINTEST_V_MAG:g}", got=f"{v_max:g}")
    stars = _all_stars()
    count = int(np.searchsorted(stars.v_mag, v_max, side="right"))
    if not count:
        raise BadInput("no star is that bright", expected=f"V ≥ {stars.v_mag[0]:g}", got=f"{v_max:g}")
    return stars.take(slice(0, count))  # type: ignore[arg-type]  # a slice keeps views of the read-only arrays


def propagate(stars: StarTable, epoch_jyear: float) -> StarTable:
    """The same stars at another Julian year, in uniform straight-line motion with no radial velocity.

    Works on vectors, so that a pole is a place like any other; proper motion and parallax change consistently
    (ESA 1997 vol. 1 §1.5.5 without the radial terms, which hip2 does not give).
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


def v_from_hp(hp_mag: Array, v_i: Array) -> Array:
    """Johnson V of stars that have only Hipparcos's own magnitude and colour: V = Hp − g(V−I)."""
    return np.asarray(np.asarray(hp_mag) - np.polyval(HP_MINUS_V_OF_V_I, np.asarray(v_i)))


def photometry() -> dict[str, Array]:
    """Hp and V−I of the rows of ``load_stars()``; NaN where hip2 lacks the star. For checks of V."""
    columns = _columns()
    return {"hp_mag": columns["hp_mag"].astype(float), "v_i": columns["v_i"].astype(float)}


def tangent_basis(ra_rad: Array, dec_rad: Array) -> tuple[Array, Array]:
    """(n, 3) unit vectors to the east and to the north at each place."""
    zero = np.zeros_like(ra_rad)
    east = np.stack([-np.sin(ra_rad), np.cos(ra_rad), zero], axis=-1)
    sin_dec = np.sin(dec_rad)
    north = np.stack([-sin_dec * np.cos(ra_rad), -sin_dec * np.sin(ra_rad), np.cos(dec_rad)], axis=-1)
    return east, north


@lru_cache(maxsize=1)
def _columns() -> dict[str, NDArray[np.generic]]:
    with (files(__package__) / "data" / "stars.npz").open("rb") as file, np.load(file) as archive:
        return {name: archive[name] for name in archive.files}


@lru_cache(maxsize=1)
def _all_stars() -> StarTable:
    c = _columns()
    ra, dec = c["ra_rad"].astype(float), c["dec_rad"].astype(float)
    east, north = tangent_basis(ra, dec)
    motion = c["pm_ra_cos_dec_mas_yr"].astype(float)[:, None] * east + c["pm_dec_mas_yr"].astype(float)[:, None] * north
    colour = c["b_v"].astype(float)
    names = (line.split("\t", 1) for line in c["names"].tobytes().decode().split("\n"))
    stars = StarTable(
        hip=c["hip"].astype(np.int32),
        icrs=unit_from_ra_dec(ra, dec),
        v_mag=c["v_mag"].astype(float) / 100,
        b_v=np.where(colour == UNKNOWN_COLOUR, np.nan, colour / 1000),
        proper_motion_rad_yr=motion * MAS_RAD,
        parallax_rad=c["parallax_mas"].astype(float) * MAS_RAD,
        flags=c["flags"].astype(np.uint16),
        epoch_jyear=float(c["epoch_jyear"].astype(float)),
        names={int(hip): name for hip, name in names},
    )
    for array in vars(stars).values():
        if isinstance(array, np.ndarray):
            array.setflags(write=False)
    return stars
