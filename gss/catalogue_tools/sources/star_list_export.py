"""Write a star table as a file for other programs and for ``read_star_list``, in degrees, milliarcseconds per year,
magnitudes and ICRS."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.sources.hipparcos import MAS_RAD, tangent_basis
from gss.catalogue_tools.sources.star_list_mapping import KINDS
from gss.domain.angles import ra_dec_from_unit
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable

UNITS = {
    "ra_deg": "deg",
    "dec_deg": "deg",
    "v_mag": "mag",
    "b_v": "mag",
    "pm_ra_mas_yr": "mas / yr",
    "pm_dec_mas_yr": "mas / yr",
    "parallax_mas": "mas",
}
LETTERS = [
    "alp",
    "bet",
    "gam",
    "del",
    "eps",
    "zet",
    "eta",
    "the",
    "iot",
    "kap",
    "lam",
    "mu",
    "nu",
    "xi",
    "omi",
    "pi",
    "rho",
    "sig",
    "sig",
    "tau",
    "ups",
    "phi",
    "chi",
    "psi",
    "ome",
]
ASCII = {0x3B1 + i: letters for i, letters in enumerate(LETTERS)} | {ord(c): str(i) for i, c in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}


def write_star_list(stars: StarTable, kind: str) -> bytes:
    """Return a file with the rows of a table, in ICRS at its epoch. The motion in right ascension includes cos δ.

    After reading the file back, positions agree to 0.001 µas and all other numbers are exact. Names in FITS have their
    Greek letters spelled out. Raises BadInput for an unknown kind or an empty table.
    """
    writers = {"csv": _csv, "ecsv": _ecsv, "fits": _fits, "votable": _votable}
    if kind not in writers:
        raise BadInput("unknown kind of star list", expected=" | ".join(KINDS), got=str(kind))
    if not len(stars):
        raise BadInput("the star table is empty", expected="a table with rows", got="an empty one")
    return writers[kind](stars)


def columns(stars: StarTable) -> dict[str, NDArray[Any]]:
    """Return the columns to write, by name."""
    ra, dec = ra_dec_from_unit(stars.icrs)
    east, north = tangent_basis(ra, dec)
    motion = stars.proper_motion_rad_yr / MAS_RAD
    return {
        "hip" if stars.hip_numbers else "id": stars.hip.astype(np.int32),
        "ra_deg": np.degrees(ra),
        "dec_deg": np.degrees(dec),
        "v_mag": stars.v_mag.astype(float),
        "b_v": stars.b_v.astype(float),
        "pm_ra_mas_yr": np.sum(motion * east, axis=1),
        "pm_dec_mas_yr": np.sum(motion * north, axis=1),
        "parallax_mas": stars.parallax_rad / MAS_RAD,
        "gss_flags": stars.flags.astype(np.int32),
        "name": np.array([stars.names.get(int(n), "") for n in stars.hip], dtype=np.str_),
    }


def _facts(stars: StarTable) -> dict[str, object]:
    return {"epoch_jyear": float(stars.epoch_jyear), "frame": "icrs"}


def _csv(stars: StarTable) -> bytes:
    table = columns(stars)
    text = io.StringIO()
    for name, value in _facts(stars).items():
        text.write(f"# {name} = {value}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    lists = [
        ["" if value != value else repr(value) for value in column.tolist()]
        if column.dtype.kind == "f"
        else column.tolist()
        for column in table.values()
    ]
    writer.writerows(zip(*lists, strict=True))
    return text.getvalue().encode()


def _table(stars: StarTable) -> Any:
    from astropy.table import Table  # imported here because it takes a second

    return Table(columns(stars), units=UNITS)


def _ecsv(stars: StarTable) -> bytes:
    table = _table(stars)
    table.meta = _facts(stars)
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue().encode()


def _fits(stars: StarTable) -> bytes:
    from astropy.io import fits

    table = _table(stars)
    # FITS is ASCII, so Greek letters become the three-letter abbreviations used by catalogues.
    table["name"] = [str(name).translate(ASCII).encode("ascii", "replace").decode() for name in table["name"]]
    hdu = fits.table_to_hdu(table)
    hdu.name = "STARS"
    hdu.header["EPOCHJY"] = (float(stars.epoch_jyear), "Julian year of the positions")
    hdu.header["RADESYS"] = "ICRS"
    file = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), hdu]).writeto(file)
    return file.getvalue()


def _votable(stars: StarTable) -> bytes:
    from astropy.io.votable import from_table, tree, writeto

    votable = from_table(_table(stars))
    votable.resources[0].coordinate_systems.append(
        tree.CooSys(ID="icrs", system="ICRS", epoch=f"J{stars.epoch_jyear!r}")
    )
    file = io.BytesIO()
    writeto(votable, file, tabledata_format="binary2")
    return file.getvalue()
