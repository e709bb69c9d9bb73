"""Bank images are exported as C source and as tables, and imported with the same bytes."""

import io
import json
import shutil
import subprocess
import zipfile
from contextlib import suppress
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.catalogue_tools.exports import export, export_table, import_table
from gss.catalogue_tools.formats.c_source import identifier
from gss.catalogue_tools.formats.registry import blocks_of
from gss.catalogue_tools.formats.table_files import KINDS
from gss.catalogue_tools.manifest import BuildManifest
from gss.catalogue_tools.onboard import FORMATS, c_source, decode, encode, frame_of, read_c_source, tables_for
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.registry import shipped_camera
from gss.skytables.pairs import distance_table

GOLDEN = Path(__file__).parent.parent / "golden"
COMPILER = next((c for c in ("cc", "gcc", "clang", "tcc") if shutil.which(c)), None)
IMAGES = [*FORMATS, "sections"]


@lru_cache
def image_of(format_name):
    """Return an image of stars of V ≤ 2.0 at J2026.5.

    The name "sections" gives sunsat's image with k-vector, reduced catalogue and one unknown magnitude.
    """
    stars = propagate(load_stars(2.0), 2026.5)
    pairs = distance_table(stars, float(np.radians(0.25)), float(np.radians(23)))
    if format_name != "sections":
        return encode(stars, pairs, format_name, format_name, bytes(range(8)))
    stars = replace(stars, v_mag=np.where(np.arange(len(stars)) == 5, np.nan, stars.v_mag))
    camera = shipped_camera("far_mst").camera
    encoding = tables_for("sunsat", stars, pairs, camera, index=True, reduced=frame_of(camera))
    return encode(stars, encoding.distances, "sunsat", "sunsat", tables=encoding.tables)


# --- C ---------------------------------------------------------------------------------------------------------------


def test_c_source_equals_the_golden_file():
    """The C source of CubeStar's golden image equals the stored file, and is read back to the image."""
    image = (GOLDEN / "onboard-cubestar.bin").read_bytes()
    assert c_source(image) == (GOLDEN / "onboard-cubestar.c").read_text()
    assert read_c_source((GOLDEN / "onboard-cubestar.c").read_text()) == image


@pytest.mark.parametrize("name", IMAGES)
def test_c_source_is_read_back_to_the_image(name):
    """The arrays in the source contain the bytes of the image."""
    assert read_c_source(c_source(image_of(name))) == image_of(name)


@pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")
@pytest.mark.parametrize("name", IMAGES)
def test_compiled_arrays_equal_the_image(name, tmp_path):
    """The compiled arrays, concatenated, are the image.

    The compiler gives no warning. Requires a little-endian machine.
    """
    if np.little_endian is False:
        pytest.skip("this machine is big endian, the bank is not")
    image = image_of(name)
    names = [identifier(block) for block, _ in blocks_of(image) if block.size]
    writes = "\n".join(f"  fwrite({n}, 1, sizeof {n}, stdout);" for n in names)
    source = tmp_path / "bank.c"
    source.write_text(c_source(image) + f"#include <stdio.h>\nint main(void) {{\n{writes}\n  return 0;\n}}\n")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([COMPILER, *flags, "-o", str(tmp_path / "bank"), str(source)], check=True, timeout=60)
    printed = subprocess.run([str(tmp_path / "bank")], check=True, capture_output=True, timeout=60)
    assert printed.stdout == image


@pytest.mark.parametrize("text", ["", "int main(void) { return 0; }", "const float gss_stars_x[2] = {0.0f, 1.0f};"])
def test_other_c_sources_are_rejected(text):
    """A file that is not a catalogue is rejected with an error that says so."""
    with pytest.raises(BadInput, match="not a catalogue in C source"):
        read_c_source(text)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("gss_stars_x[", "gss_stars_w[", "gss_stars_x is incomplete"),
        ("{\n  0, 1, 2,", "{\n  0, 2, 2,", "damaged"),
        ("{\n  0, 1, 2,", "{\n  0, 1,", "gss_stars_id is incomplete"),
        ("{\n  0, 1, 2,", "{\n  0, 1, 70000,", "not a number of its type"),
        ('"<i2",[],49]', '"<i2",[],48]', "gss_stars_id is incomplete"),
        ("gss-layout: [", "gss-layout: (", "layout line of the C source is damaged"),
    ],
)
def test_a_changed_c_source_is_rejected(old, new, message):
    """A number that is changed, missing or too large, a renamed array and a damaged layout line are detected."""
    text = c_source(image_of("cubestar"))
    assert old in text
    with pytest.raises(CorruptData, match=message):
        read_c_source(text.replace(old, new, 1))


# --- tables ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", IMAGES)
def test_tables_are_read_back_to_the_same_image(name, kind):
    """FITS, CSV, ECSV and Parquet files give the same image bytes. Repeated exports give the same file, except for
    FITS.
    """
    data = export_table(image_of(name), kind)
    assert import_table(data, kind) == image_of(name)
    if kind != "fits":
        assert data == export_table(image_of(name), kind)


def test_fits_tables_are_readable_with_astropy():
    """Astropy reads the bank's stars with columns and units, in single precision."""
    image = image_of("far-mst")
    with fits.open(io.BytesIO(export_table(image, "fits"))) as hdus:
        hdus.verify("exception")
        assert hdus[0].header["FORMAT"] == "far-mst"
        stars, pairs = hdus["STARS"].data, hdus["PAIRS"].data
        assert np.array_equal(np.column_stack([stars["x"], stars["y"], stars["z"]]), decode(image).icrs)
        assert np.array_equal(pairs["second"], decode(image).distances.second)


def test_parquet_tables_are_readable_with_pyarrow():
    """PyArrow reads packed pairs as three integers."""
    with zipfile.ZipFile(io.BytesIO(export_table(image_of("sunsat-5"), "parquet"))) as archive:
        table = pq.read_table(io.BytesIO(archive.read("pairs.parquet")))
    distances = decode(image_of("sunsat-5")).distances
    assert np.array_equal(table["first"], distances.first)
    assert table["steps"].to_numpy() * 50e-6 == pytest.approx(distances.distance_rad)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("data", [b"", b"PK\x05\x06" + bytes(18), b"SIMPLE  =", b"row,hip\n1,2\n", bytes(3000)])
def test_other_files_are_rejected(kind, data):
    """A file of another type is rejected, and the error states the expected type."""
    with pytest.raises(BadInput):
        import_table(data, kind)


def test_unknown_kinds_are_rejected():
    """An unknown kind is rejected with an error that lists the valid ones."""
    for call in (lambda: export_table(image_of("aim"), "xls"), lambda: import_table(b"", "xls")):
        with pytest.raises(BadInput, match=r"fits \| csv \| ecsv \| parquet"):
            call()


def with_changed_file(data, name, change):
    """Return the ZIP archive with the content of one file changed, or without the file."""
    archive = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(archive, "w") as new:
        for member in old.namelist():
            content = change(old.read(member)) if member == name else old.read(member)
            if content is not None:
                new.writestr(member, content)
    return archive.getvalue()


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("stars.csv", lambda b: b.replace(b"\n0,", b"\n1,", 1), "damaged"),
        ("stars.csv", lambda b: b[: len(b) // 2], "is incomplete|cannot be read|damaged"),
        ("stars.csv", lambda b: b.replace(b"id,x", b"id,w"), "no x"),
        ("stars.csv", lambda b: b"", "cannot be read|is incomplete"),
        ("pairs.csv", lambda b: None, "a table is missing"),
        ("stars.csv", lambda b: b.replace(b"\n0,", b"\n99999,", 1), "does not fit its type|damaged"),
        ("layout.json", lambda b: b[:-2], "layout of the table file is damaged"),
        ("layout.json", lambda b: json.dumps(json.loads(b) * 2).encode(), "does not contain one complete image"),
        ("layout.json", lambda b: b"[" * 100_000, "layout of the table file is damaged"),
        ("layout.json", lambda b: b.replace(b'"bits": []', b'"bits": ["x"]', 1), "layout of the table file is damaged"),
        ("layout.json", lambda b: b.replace(b'"bits": []', b'"bits": [3]', 1), "damaged|is incomplete|does not fit"),
        ("layout.json", lambda b: b.replace(b'"rows": ', b'"rows": -', 1), "layout of the table file is damaged"),
        ("bytes_header.csv", lambda b: b.replace(b"\n0\n", b"\nnan\n"), "does not fit its type"),
        ("bytes_header.csv", lambda b: b.replace(b"\n0\n", b"\n256\n", 1), "does not fit its type"),
        ("bytes_header.csv", lambda b: b.replace(b"\n0\n", b"\n0.5\n", 1), "does not fit its type"),
    ],
)
def test_a_changed_table_is_rejected(name, change, message):
    """A changed cell, column, row or file is detected."""
    with pytest.raises(CorruptData, match=message):
        import_table(with_changed_file(export_table(image_of("cubestar"), "csv"), name, change), "csv")


@pytest.mark.parametrize("kind", ["csv", "parquet", "fits"])
@settings(deadline=None)
@given(st.data())
def test_a_changed_byte_of_a_file_is_detected_or_harmless(kind, data):
    """A byte changed anywhere in the file gives the same image or an error, never a different image."""
    image = image_of("sunsat")
    broken = bytearray(export_table(image, kind))
    broken[data.draw(st.integers(0, len(broken) - 1))] ^= data.draw(st.integers(1, 255))
    with suppress(BadInput, CorruptData):
        assert import_table(bytes(broken), kind) == image


def test_the_readable_star_list_is_exported_to_parquet():
    """The Parquet star list has the same columns as the CSV list: row, Hipparcos number, degrees and magnitude."""
    names = [f.name for f in fields(BuildManifest) if f.type == "str"]
    empty = {n: {} for n in ("parameters", "envelope", "counts", "bytes_by_part", "quality", "quantisation")}
    manifest = BuildManifest(**dict.fromkeys(names, "x"), **empty, epoch_jyear=2026.5, hip=())
    stars = load_stars(2.0)
    table = pq.read_table(io.BytesIO(export(decode(image_of("aim"), stars.hip), manifest, "parquet")))
    assert table.column_names == ["row", "hip", "ra_deg", "dec_deg", "v_mag"]
    assert table["hip"].to_pylist() == stars.hip.tolist()


def test_any_name_can_be_written_to_a_fits_card():
    """Accents are removed, and characters without an ASCII form and line breaks become question marks.

    Long names are not truncated.
    """
    names = [f.name for f in fields(BuildManifest) if f.type == "str"]
    empty = {n: {} for n in ("parameters", "envelope", "counts", "bytes_by_part", "quality", "quantisation")}
    given_name = "Nächte 2026 – Straße\n星" + "x" * 90
    texts = dict.fromkeys(names, "x") | {"name": given_name}
    manifest = BuildManifest(**texts, **empty, epoch_jyear=2026.5, hip=())
    with fits.open(io.BytesIO(export(decode(image_of("cubestar")), manifest, "fits"))) as hdus:
        hdus.verify("exception")
        assert hdus[0].header["NAME"] == "Nachte 2026 - Strasse??" + "x" * 90
    assert manifest.name == given_name
