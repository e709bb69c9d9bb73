"""Small files that need minutes or gigabytes in a simple reader, by file name. Loaded by ``tests/conftest.py``."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np
from astropy.io import fits

HEAD = "id,ra_deg,dec_deg,v_mag\n"
ROWS = "".join(f"{k},{k * 12},{k},3\n" for k in range(1, 25))
POWER = "10**9999999 m"
MANY = 60_000
BLANKS = 40_000
GZIP_HEAD = b"\x1f\x8b\x08\0\0\0\0\0\0\x03"


def votable(fields: str, row: str, attributes: str = "") -> bytes:
    """Return a VOTable with these fields and rows."""
    return (
        f'<?xml version="1.0"?><VOTABLE version="1.4"><RESOURCE><TABLE {attributes}>{fields}<DATA><TABLEDATA>{row}'
        "</TABLEDATA></DATA></TABLE></RESOURCE></VOTABLE>"
    ).encode()


def fields(unit: str = "deg", more: str = "") -> str:
    """Return the fields of position and magnitude."""
    plain = "".join(f'<FIELD name="{n}" datatype="double"/>' for n in ("dec", "v"))
    return f'<FIELD name="ra" datatype="double" unit="{unit}"/>{plain}{more}'


def table(**cards: object) -> bytes:
    """Return a FITS table of stars with changed header values, which need not fit the data."""
    columns = [fits.Column(n, "D", array=np.arange(1.0, 25.0)) for n in ("ra", "dec", "v")]
    hdu = fits.BinTableHDU.from_columns(columns)
    hdu.header.update(cards)
    return fits.PrimaryHDU().header.tostring().encode() + hdu.header.tostring().encode() + bytes(2880)


def gzip_zeros(size: int) -> bytes:
    """Return ``size`` zero bytes, compressed. A compressed piece is repeated, which its full flush permits."""
    piece = bytes(1 << 20)
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = packer.compress(piece) + packer.flush(zlib.Z_FULL_FLUSH)
    count, rest = divmod(size, len(piece))
    check = 0
    for _ in range(count):
        check = zlib.crc32(piece, check)
    check = zlib.crc32(piece[:rest], check)
    end = packer.compress(piece[:rest]) + packer.flush()
    return GZIP_HEAD + block * count + end + struct.pack("<II", check, size % (1 << 32))


def tiled(bitpix: int, *sides: int, rows: int = 0) -> bytes:
    """Return a FITS image of zeros, compressed as one tile, or as tiles of ``rows`` rows that share the same bytes."""
    tile = [sides[0], rows or sides[1], *sides[2:]]
    data = gzip_zeros(int(np.prod(tile)) * abs(bitpix) // 8)
    count = sides[1] // tile[1]
    hdu = fits.BinTableHDU.from_columns(
        [fits.Column("COMPRESSED_DATA", "1PB()", array=np.array([np.zeros(1, np.uint8)], object))]
    )
    header = hdu.header
    header["TFORM1"], header["PCOUNT"], header["NAXIS2"] = f"1PB({len(data)})", len(data), count
    header.update({"ZIMAGE": True, "ZBITPIX": bitpix, "ZNAXIS": len(sides), "ZCMPTYPE": "GZIP_1", "ZQUANTIZ": "NONE"})
    for k, side in enumerate(sides):
        header.update({f"ZNAXIS{k + 1}": side, f"ZTILE{k + 1}": tile[k]})
    body = struct.pack(">ii", len(data), 0) * count + data
    return fits.PrimaryHDU().header.tostring().encode() + header.tostring().encode() + body + bytes(-len(body) % 2880)


def zip_bomb() -> bytes:
    """Return a ZIP with one table of 300 MiB, more than a table may have."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("stars.csv", "w", force_zip64=True) as member:
            for _ in range(300):
                member.write(bytes(1 << 20))
        archive.writestr("layout.json", "[]")
    return file.getvalue()


def parquet_bomb() -> bytes:
    """Return a ZIP with a table of 60 million equal values, more than a table may have."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file, buffer = io.BytesIO(), io.BytesIO()
    piece = pa.table({"hip": np.zeros(1_000_000, np.int64)})
    with pq.ParquetWriter(buffer, piece.schema, write_statistics=False) as writer:
        for _ in range(60):
            writer.write_table(piece)
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("stars.parquet", buffer.getvalue())
        block = {"table": "stars", "name": "hip", "type": "<u4", "shape": [], "bits": [], "rows": 1}
        archive.writestr("layout.json", str([block]).replace("'", '"'))
    return file.getvalue()


STAR_LISTS: dict[str, Callable[[], bytes]] = {
    "unit.vot": lambda: votable(fields(POWER), "<TR><TD>1</TD><TD>2</TD><TD>3</TD></TR>"),
    "unit.fits": lambda: table(TUNIT1=POWER),
    "unit.ecsv": lambda: (
        f"# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: ra, unit: '{POWER}', datatype: float64}}\n"
        "# - {name: dec, datatype: float64}\n# - {name: v, datatype: float64}\nra dec v\n1 2 3\n"
    ).encode(),
    "blanks.csv": lambda: f"# a = b{' ' * BLANKS}x\n{HEAD}{ROWS}".encode(),
    "line.csv": lambda: f"# a = b{' ' * 600_000}x\n{HEAD}{ROWS}".encode(),
    "brackets.csv": lambda: f"{'[' * 60_000},ra_deg,dec_deg,v_mag\n{ROWS}".encode(),
    "value.csv": lambda: f"id,ra,dec,v\n1,1 2 3{' ' * BLANKS}x,2 3 4,3\n".encode(),
    "epoch.csv": lambda: f"# epoch = B{' ' * BLANKS}x\n{HEAD}{ROWS}".encode(),
    "columns.csv": lambda: (",".join(f"c{k}" for k in range(MANY)) + "\n" + ",".join("1" * MANY) + "\n").encode(),
    "columns.vot": lambda: votable("".join(f'<FIELD name="c{k}" datatype="int"/>' for k in range(MANY)), ""),
    "chars.vot": lambda: votable(
        fields(more='<FIELD name="n" datatype="char" arraysize="10000000"/>'),
        "<TR><TD>1</TD><TD>2</TD><TD>3</TD><TD/></TR>" * 470,
    ),
    "wide.vot": lambda: votable(
        fields(more="".join(f'<FIELD name="n{k}" datatype="unicodeChar" arraysize="1000"/>' for k in range(300))),
        ("<TR>" + "<TD/>" * 303 + "</TR>") * 3000,
    ),
    "rows.vot": lambda: votable(fields(), "<TR><TD>1</TD><TD>2</TD><TD>3</TD></TR>", 'nrows="100000000000"'),
    "deep.vot": lambda: b"<VOTABLE>" + b"<RESOURCE>" * MANY + b"</RESOURCE>" * MANY + b"</VOTABLE>",
    "rows.fits": lambda: table(NAXIS1=0, NAXIS2=10**12),
    "columns.fits": lambda: table(TFIELDS=10**9),
    "nested.ecsv": lambda: (
        "# %ECSV 1.0\n# ---\n# meta:\n" + f"#  {'[' * 1000}\n" * 100 + "ra dec v\n1 2 3\n"
    ).encode(),
    "nested-line.ecsv": lambda: f"# %ECSV 1.0\n# ---\n# meta: {'[' * 100_000}\nra dec v\n1 2 3\n".encode(),
}
"""Star lists whose reading took minutes or longer, or filled the memory."""
FRAMES: dict[str, Callable[[], bytes]] = {
    "tiles.fits": lambda: tiled(-64, 8000, 8000),
    "cube.fits": lambda: tiled(-64, 8000, 8000, 2, rows=1),
    "planes.fits": lambda: tiled(16, 8000, 8000, 8),
}
TABLES: dict[str, Callable[[], bytes]] = {
    "bomb.tables.csv.zip": zip_bomb,
    "bomb.tables.parquet.zip": parquet_bomb,
    "rows.tables.fits": lambda: table(NAXIS1=0, NAXIS2=10**12),
}


@cache
def content(name: str) -> bytes:
    """Return the file with this name."""
    return {**STAR_LISTS, **FRAMES, **TABLES}[name]()
