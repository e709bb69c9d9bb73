"""What a star list may not hold, found before any library reads it: references to other files, entities, aliases, open quotes.

A list comes from anybody. A VOTable may name a file or an address in place of its rows, and a reader that follows it opens what the
sender chose; entities and aliases grow a few bytes into gigabytes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any
from xml.parsers import expat

import yaml

from gss.domain.errors import BadInput

ECSV_HEADER_BYTES = 1 << 17
"""Gaia's source table, the longest list we know, describes its 152 columns in a quarter of it."""
SHOWN = 60


def check_votable(data: bytes) -> None:
    """Refuses a VOTable that points elsewhere or defines entities. LINK only names a page for people and is never opened."""
    parser = expat.ParserCreate()

    def doctype(*_: Any) -> None:
        raise BadInput(
            "the VOTable brings a document type or entities",
            expected="elements and text only",
            got="<!DOCTYPE> or <!ENTITY>",
            hint="take that line out",
        )

    def element(name: str, attributes: Mapping[str, str]) -> None:
        local = _local(name)
        if local == "fits":
            raise BadInput("the VOTable holds a FITS file", expected="rows in TABLEDATA or BINARY", got="<FITS>")
        if local != "link" and any(_local(a) == "href" for a in attributes):
            raise BadInput(
                "the VOTable points to another file or address, which is never opened",
                expected="rows in the file itself",
                got=f"href in <{name[:SHOWN]}>",
                hint="save the table with its rows inside",
            )

    parser.StartDoctypeDeclHandler = doctype
    parser.EntityDeclHandler = doctype
    parser.StartElementHandler = element
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise BadInput(
            "the star list is not a votable table", expected="a votable file", got=str(error)[:200]
        ) from None


def _local(name: str) -> str:
    """A name without its prefix; XML is strict about case, a sender need not be."""
    return name.rpartition(":")[2].lower()


def check_ecsv_header(lines: list[str]) -> None:
    """Refuses a header that is too long or repeats parts of itself by YAML's anchors and aliases."""
    size = sum(map(len, lines))
    if size > ECSV_HEADER_BYTES:
        raise BadInput(
            "the header of the star list is too long", expected=f"at most {ECSV_HEADER_BYTES} characters", got=str(size)
        )
    try:
        held = any(isinstance(t, yaml.AliasToken | yaml.AnchorToken) for t in yaml.scan("\n".join(lines)))
    except yaml.YAMLError as error:
        got = str(error).splitlines()[0][:200]
        raise BadInput("the star list is not an ecsv table", expected="a YAML header", got=got) from None
    if held:
        raise BadInput(
            "the header of the star list repeats itself by anchors or aliases",
            expected="plain values",
            got="& or * in its YAML",
        )


def check_quotes(text: str, delimiter: str) -> None:
    """Refuses a quote that is not closed on its line: the rows below would vanish in it. A quote opens only where a value begins;
    elsewhere it is a second of arc."""
    if '"' not in text:
        return
    value = rf'(?:"(?:[^"]|"")*+"|(?!"))[^{re.escape(delimiter)}]*+'
    whole = re.compile(rf"{value}(?:{re.escape(delimiter)}{value})*+")
    row = -1
    for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n"):
        if not line:
            continue
        row += 1
        if '"' in line and not whole.fullmatch(line):
            where = f"row {row}" if row else "the header"
            raise BadInput(
                f"{where}: a quote is opened and not closed on its line",
                expected="one line for each star",
                got=line[:SHOWN],
                hint='close it, or write it as """"',
            )
