"""Malicious or damaged star lists are rejected with a message before a library reads them."""

from __future__ import annotations

import builtins
import io
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from gss.catalogue_tools.sources.star_list_guards import ECSV_HEADER_BYTES
from gss.catalogue_tools.sources.star_list_mapping import ListMapping
from gss.catalogue_tools.sources.star_lists import read_star_list
from gss.domain.errors import BadInput

MAPPING = ListMapping(epoch_jyear=2000.0, frame="icrs")
FIELDS = "".join(f'<FIELD name="{n}" datatype="unsignedByte"/>' for n in ("ra", "dec", "v"))
GOOD = "".join(f"{i},{i * 12},{i},3,star {i}\n" for i in range(1, 30))
HEAD = "id,ra,dec,v,name\n"


def votable(data: str, prologue: str = "") -> bytes:
    """Return a VOTable with this data element and prologue."""
    return (
        f'<?xml version="1.0"?>{prologue}<VOTABLE version="1.3"><RESOURCE><TABLE>{FIELDS}<DATA>{data}</DATA>'
        "</TABLE></RESOURCE></VOTABLE>"
    ).encode()


@pytest.mark.parametrize("scheme", ["file", "http"])
@pytest.mark.parametrize(
    "element",
    [
        '<BINARY><STREAM href="{0}"/></BINARY>',
        '<BINARY2><STREAM HREF="{0}"/></BINARY2>',
        '<FITS><STREAM href="{0}"/></FITS>',
        '<v:BINARY xmlns:v="u" xmlns:x="w"><v:STREAM x:Href="{0}"/></v:BINARY>',
        '<fits extnum="1"/>',
    ],
)
def test_references_in_a_votable_are_not_opened(
    element: str, scheme: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No file or address referenced in a VOTable is opened, and the message does not contain its content."""
    secret = tmp_path / "secret.txt"
    secret.write_text("swordfish" * 10)
    address = secret.as_uri() if scheme == "file" else "http://127.0.0.1:9/s.bin"
    opened: list[str] = []
    original_open = builtins.open

    def recording_open(file: object, *arguments: object, **keywords: object) -> object:
        opened.append(str(file))
        return original_open(file, *arguments, **keywords)  # type: ignore[call-overload]

    monkeypatch.setattr(builtins, "open", recording_open)
    monkeypatch.setattr("urllib.request.urlopen", lambda *a, **k: opened.append("an address"))
    with pytest.raises(BadInput) as error:
        read_star_list(votable(element.format(address)), "votable", MAPPING)
    assert not [name for name in opened if "secret" in name or name == "an address"]
    assert "swordfish" not in str(error.value)
    assert "VOTable" in error.value.message


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize(
    "prologue",
    [
        '<!DOCTYPE x [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;">]>',
        '<!DOCTYPE x [<!ENTITY xx SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE x SYSTEM "http://127.0.0.1:9/x.dtd">',
        '<!DOCTYPE x [<!ENTITY % p SYSTEM "file:///etc/hostname"> %p;]>',
    ],
)
def test_entities_and_document_types_are_rejected(prologue: str, encoding: str) -> None:
    """Internal and external entities and document types are rejected in every supported encoding."""
    data = votable("<TABLEDATA><TR><TD>1</TD><TD>2</TD><TD>3</TD></TR></TABLEDATA>", prologue).decode().encode(encoding)
    with pytest.raises(BadInput, match="document type or entities"):
        read_star_list(data, "votable", MAPPING)


def test_a_votable_with_a_link_element_is_read() -> None:
    """A list with LINK elements, which archives write and readers ignore, is accepted."""
    rows = "<TABLEDATA><TR><TD>1</TD><TD>2</TD><TD>3</TD></TR></TABLEDATA>"
    data = votable(rows).replace(b"</TABLE>", b'<LINK href="http://example.org/"/></TABLE>', 1)
    data = data.replace(b"<DATA>", b'<LINK href="http://example.org/about"/><DATA>', 1).replace(
        b'<LINK href="http://example.org/"/></TABLE>', b"</TABLE>"
    )
    assert len(read_star_list(data, "votable", MAPPING).stars) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + GOOD.replace("star 5\n", '"open\n'), "row 5: a quote is opened"),
        (HEAD + GOOD.replace("star 7\n", '"a\nb"\n'), "row 7: a quote is opened"),
        (HEAD + GOOD.replace("star 29\n", '"open'), "row 29: a quote is opened"),
        (HEAD.replace("name", '"name') + GOOD, "the header: a quote is opened"),
        ((HEAD + GOOD.replace("star 5\n", '"open\n')).replace("\n", "\r\n"), "row 5: a quote is opened"),
        ("id,ra,dec,v\n" + "".join(f"{i},{i},2,3,\n" for i in range(1, 5)), "row 1: 5 values, the header names 4"),
    ],
)
def test_an_open_quote_is_rejected_with_its_row(text: str, message: str) -> None:
    """A quote that is not closed on its line, and a row with too many values, are rejected with the row number."""
    with pytest.raises(BadInput, match=message):
        read_star_list(text.encode(), "csv", MAPPING)


def test_valid_quotes_are_read() -> None:
    """Quoted commas, doubled quotes and arcsecond marks are read."""
    rows = '1,12,1°2\'3",3,"a, b"\n2,24,2°2\'3",3,"say ""x"""\n3,36,3°2\'3",3,\n'
    result = read_star_list((HEAD + rows).encode(), "csv", MAPPING)
    assert (len(result.stars), result.dropped_count) == (3, 0)
    assert result.stars.names[1] == "a, b"


def ecsv(meta: str) -> bytes:
    """Return an ECSV file of one star with these header lines."""
    columns = "".join(f"# - {{name: {n}, datatype: float64}}\n" for n in ("ra", "dec", "v"))
    return f"# %ECSV 1.0\n# ---\n{meta}# datatype:\n{columns}# schema: astropy-2.0\nra dec v\n1 2 3\n".encode()


@pytest.mark.parametrize(
    ("meta", "message"),
    [
        ("# a: &a [x,x]\n# meta: {frame: *a, epoch: 2000}\n", "anchors or aliases"),
        ("# meta: {frame: [icrs, fk5], epoch: 2000}\n", "frame of the star list is not one value"),
        ("# meta: {frame: icrs, epoch: {a: 1}}\n", "epoch of the star list is not one value"),
        ("# meta: {note: " + "x" * ECSV_HEADER_BYTES + "}\n", "too long"),
    ],
)
def test_an_ecsv_header_may_contain_plain_values_only(meta: str, message: str) -> None:
    """Headers with anchors or aliases, with collections as frame or epoch, or that are too long, are rejected. Plain
    values are read.
    """
    assert len(read_star_list(ecsv("# meta: {frame: icrs, epoch: 2000}\n"), "ecsv").stars) == 1
    with pytest.raises(BadInput, match=message):
        read_star_list(ecsv(meta), "ecsv")


@pytest.mark.parametrize("column", ["id", "ra", "v"])
@pytest.mark.parametrize("dtype", [complex, bool])
def test_values_of_a_star_must_be_real_numbers(column: str, dtype: type) -> None:
    """Complex numbers and booleans as positions, magnitudes or identifiers are rejected."""
    columns = {name: np.arange(1.0, 30) for name in ("id", "ra", "dec", "v")}
    file = io.BytesIO()
    Table(columns | {column: (np.arange(29) % 3).astype(dtype)}).write(file, format="fits")
    with pytest.raises(BadInput, match=f"column {column} cannot be"):
        read_star_list(file.getvalue(), "fits", MAPPING)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"pm_ra_has_cos_dec": "no"}, "pm_ra_has_cos_dec"),
        ({"epoch_jyear": "2000"}, "epoch_jyear"),
        ({"epoch_jyear": True}, "epoch_jyear"),
        ({"columns": {"ra": ["ra"]}}, "columns"),
        ({"columns": 5}, "columns"),
        ({"units": {"ra": None}}, "units"),
        ({"frame": ["icrs"]}, "frame"),
        ({"bad_rows": []}, "bad_rows"),
    ],
)
def test_values_of_a_mapping_must_have_the_declared_types(values: dict[str, object], message: str) -> None:
    """Values of another type are rejected instead of converted."""
    with pytest.raises(BadInput, match=message):
        ListMapping(**values)  # type: ignore[arg-type]


def test_a_column_has_one_meaning() -> None:
    """A column used as both right ascension and declination is rejected. The identifier may also be the name."""
    mapping = ListMapping(columns={"ra": "dec"}, epoch_jyear=2000.0, frame="icrs")
    with pytest.raises(BadInput, match="'dec' is used twice"):
        read_star_list((HEAD + GOOD).encode(), "csv", mapping)
    named = ListMapping(columns={"name": "id"}, epoch_jyear=2000.0, frame="icrs")
    assert len(read_star_list((HEAD + GOOD).encode(), "csv", named).stars) == 29
