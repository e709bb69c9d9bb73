"""Export a catalogue to CSV, ECSV, Parquet and FITS tables, with angles in degrees as usual in these formats.

These exports are for users and other programs. They do not preserve the number widths of the device. For a lossless
conversion of the image to tables and back, see :func:`export_table` and :func:`import_table`; for C source,
:mod:`gss.catalogue_tools.formats.c_source`.
"""

from __future__ import annotations

import io
import unicodedata
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.table_files import export_table, import_table
from gss.catalogue_tools.manifest import BuildManifest
from gss.domain.angles import ra_dec_from_unit
from gss.domain.errors import BadInput
from gss.skytables.bank import OnboardCatalogue

__all__ = ["export", "export_table", "import_table"]

UNITS = {"ra": "deg", "dec": "deg", "v": "mag", "distance": "deg"}
LATIN = str.maketrans({"ß": "ss", "æ": "ae", "Æ": "AE", "ø": "o", "Ø": "O", "ł": "l", "Ł": "L", "–": "-", "—": "-"})


def export(catalogue: OnboardCatalogue, manifest: BuildManifest, kind: str) -> bytes:
    """Return the file of one kind. csv, ecsv and parquet contain the star list; fits contains the star list and the
    distance table."""
    writers = {"csv": _csv, "ecsv": _ecsv, "parquet": _parquet, "fits": _fits}
    if kind not in writers:
        raise BadInput("unknown kind of export", expected=" | ".join(writers), got=kind)
    return writers[kind](catalogue, manifest)


def _stars(catalogue: OnboardCatalogue) -> dict[str, NDArray[Any]]:
    ra, dec = ra_dec_from_unit(catalogue.icrs.astype(float))
    return {
        "row": np.arange(len(catalogue), dtype=np.int32),
        "hip": catalogue.hip.astype(np.int32),
        "ra": np.degrees(ra),
        "dec": np.degrees(dec),
        "v": catalogue.v_mag.astype(float),
    }


def _pairs(catalogue: OnboardCatalogue) -> dict[str, NDArray[Any]]:
    d = catalogue.distances
    return {"first": d.first, "second": d.second, "distance": np.degrees(d.distance_rad.astype(float))}


def _facts(manifest: BuildManifest) -> dict[str, object]:
    return {
        "NAME": manifest.name,
        "PROFILE": manifest.profile_name,
        "RADESYS": manifest.frame,
        "EPOCH": manifest.epoch_jyear,
        "VALIDFR": manifest.valid_from,
        "VALIDTO": manifest.valid_to,
        "TOOL": manifest.tool,
        "IMGSHA": manifest.image_sha256,
    }


def _csv(catalogue: OnboardCatalogue, manifest: BuildManifest) -> bytes:
    columns = _stars(catalogue)
    head = ",".join(f"{name}_{UNITS[name]}" if name in UNITS else name for name in columns)
    rows = (
        f"{row},{hip},{ra:.7f},{dec:.7f},{'' if np.isnan(v) else f'{v:.3f}'}"
        for row, hip, ra, dec, v in zip(*columns.values(), strict=True)
    )
    return ("\n".join([head, *rows]) + "\n").encode()


def _ecsv(catalogue: OnboardCatalogue, manifest: BuildManifest) -> bytes:
    from astropy.table import Table  # imported here because it takes a second

    columns = _stars(catalogue)
    table = Table(columns, meta=_facts(manifest), units={name: UNITS[name] for name in columns if name in UNITS})
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue().encode()


def _parquet(catalogue: OnboardCatalogue, manifest: BuildManifest) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {f"{n}_{UNITS[n]}" if n in UNITS else n: v for n, v in _stars(catalogue).items()}
    table = pa.table(columns).replace_schema_metadata({k: str(v) for k, v in _facts(manifest).items()})
    file = io.BytesIO()
    pq.write_table(table, file)
    return file.getvalue()


def _card(value: Any) -> Any:
    """Convert a value to printable ASCII for a FITS header: accents are removed, ß becomes ss, other characters
    become "?"."""
    if not isinstance(value, str):
        return value
    plain = unicodedata.normalize("NFKD", value.translate(LATIN))
    ascii_text = "".join(c for c in plain if not unicodedata.combining(c))
    return "".join(c if " " <= c <= "~" else "?" for c in ascii_text)


def _fits(catalogue: OnboardCatalogue, manifest: BuildManifest) -> bytes:
    from astropy.io import fits

    codes = {"i": "J", "f": "D"}

    def table(name: str, columns: dict[str, NDArray[Any]]) -> Any:
        fits_columns = [
            fits.Column(name=column, format=codes[values.dtype.kind], array=values, unit=UNITS.get(column))
            for column, values in columns.items()
        ]
        return fits.BinTableHDU.from_columns(fits_columns, name=name)

    primary = fits.PrimaryHDU()
    primary.header.update({name: _card(value) for name, value in _facts(manifest).items()})
    file = io.BytesIO()
    fits.HDUList([primary, table("STARS", _stars(catalogue)), table("DISTANCES", _pairs(catalogue))]).writeto(
        file, checksum=False
    )
    return file.getvalue()
