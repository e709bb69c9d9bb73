"""Checks of a star list before a library reads it: references to other files, entities, aliases, open quotes, and size.

The sender of a list is not trusted. A VOTable can contain a reference to a file or an address instead of rows. A reader
that follows the reference opens a target that the sender has chosen. Entities, aliases, fixed-length text, powers in
units and nested headers expand a few bytes to gigabytes of memory or minutes of time. The time of each check is
proportional to the size of the file.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any
from xml.parsers import expat

import numpy as np
import yaml

from gss.domain.errors import BadInput

ECSV_HEADER_BYTES = 1 << 17
"""Maximum size of a header. The longest known header is that of Gaia's source table, which describes 152 columns in a
quarter of this size."""
DEEPEST_HEADER = 20
MAX_COLUMNS = 1000
"""Maximum number of columns. FITS permits 999."""
MAX_ROWS = 5_000_000
MAX_LINE_LENGTH = 1 << 16
MAX_NAME_LENGTH = 200
MAX_UNIT_LENGTH = 64
MAX_TEXT_LENGTH = 1024
"""Largest number of characters of a fixed-length value."""
MAX_TABLE_BYTES = 1 << 29
"""Limit on the size of the columns in memory."""
DEEPEST_VOTABLE = 32
WIDTHS = {"char": 1, "unicodeChar": 4, "floatComplex": 8, "doubleComplex": 16}
SHOWN = 60


def check_unit(unit: str) -> None:
    """Raise BadInput for a unit that is too long or contains a number with more than four digits before the decimal
    point. Without this check, the parser would compute numbers such as 10**9999999."""
    if len(unit) > MAX_UNIT_LENGTH or re.search(r"(?<![.\d])\d{5}", unit):
        raise BadInput(
            "a unit of the star list is too long",
            expected=f"at most {MAX_UNIT_LENGTH} characters, and numbers of at most 4 digits",
            got=unit[:SHOWN],
            hint="write the unit as deg, mas/yr or mag",
        )


def require_columns(count: int) -> None:
    """Raise BadInput for too many columns."""
    if count > MAX_COLUMNS:
        raise BadInput(
            "the star list has too many columns",
            expected=f"at most {MAX_COLUMNS}",
            got=str(count),
            hint="keep position, magnitude and names only",
        )


def check_column_names(names: Sequence[str]) -> None:
    """Raise BadInput for too many columns, a name that is too long or a repeated name."""
    require_columns(len(names))
    if long := next((name for name in names if len(name) > MAX_NAME_LENGTH), None):
        raise BadInput(
            "a column of the star list has too long a name",
            expected=f"at most {MAX_NAME_LENGTH} characters",
            got=f"{len(long)} characters: {long[:SHOWN]}",
        )
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise BadInput(
            "two columns of the star list have the same name", expected="each name once", got=", ".join(twice)
        )


def check_table_size(rows: int, row_bytes: int) -> None:
    """Raise BadInput for a table that is too large according to its header."""
    if not 0 <= rows <= MAX_ROWS:
        raise BadInput("the star list is too long", expected=f"at most {MAX_ROWS} rows", got=str(rows))
    if rows * row_bytes > MAX_TABLE_BYTES:
        raise BadInput(
            "the star list is too large when it is unpacked",
            expected=f"at most {MAX_TABLE_BYTES >> 20} MiB",
            got=f"{rows} rows of {row_bytes} bytes",
            hint="keep position, magnitude and names only",
        )


def check_lines(data: bytes) -> None:
    """Raise BadInput for a line that is too long to be a row of a table."""
    ends = np.flatnonzero(np.frombuffer(data, np.uint8) == ord("\n"))
    lengths = np.diff(ends, prepend=-1, append=len(data))
    if lengths.max() > MAX_LINE_LENGTH:
        raise BadInput(
            f"line {int(lengths.argmax()) + 1} of the star list is too long",
            expected=f"at most {MAX_LINE_LENGTH} bytes",
            got=f"{int(lengths.max())} bytes",
        )


class _VotableSize:
    """Counter of the memory that a reader allocates for a VOTable."""

    def __init__(self) -> None:
        self._depth = self._fields = self._rows = self._row_bytes = 0

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        """Count an element. Raises BadInput if the element alone is too large."""
        self._depth += 1
        if self._depth > DEEPEST_VOTABLE:
            raise BadInput("the VOTable is nested too deeply", expected=f"{DEEPEST_VOTABLE} levels", got="more")
        check_unit(attributes.get("unit", ""))
        if name == "tr":
            self._rows += 1
        elif name == "table":
            self._fields = self._row_bytes = self._rows = 0
            check_table_size(_count("nrows", attributes.get("nrows", "0")), 0)
        elif name in ("field", "param"):
            self._value(name, attributes)

    def end(self, name: str) -> None:
        """Check the size of a completed table."""
        self._depth -= 1
        if name == "table":
            check_table_size(self._rows, self._row_bytes)

    def _value(self, name: str, attributes: Mapping[str, str]) -> None:
        size = _elements(attributes.get("arraysize", ""))
        if size > MAX_TEXT_LENGTH:
            raise BadInput(
                f"a {name.upper()} of the VOTable is too large",
                expected=f'arraysize up to {MAX_TEXT_LENGTH}, or "*"',
                got=attributes["arraysize"][:SHOWN],
            )
        if name == "field":
            self._fields += 1
            self._row_bytes += size * WIDTHS.get(attributes.get("datatype", ""), 8)
            require_columns(self._fields)


def check_votable(data: bytes) -> None:
    """Raise BadInput for a VOTable with external references or entities.

    LINK is permitted, because it names a page for users and is never opened.
    """
    parser = expat.ParserCreate()

    def doctype(*_: Any) -> None:
        raise BadInput(
            "the VOTable contains a document type or entities",
            expected="elements and text only",
            got="<!DOCTYPE> or <!ENTITY>",
            hint="remove that line",
        )

    size = _VotableSize()

    def element(name: str, attributes: Mapping[str, str]) -> None:
        local = _local(name)
        size.start(local, attributes)
        if local == "fits":
            raise BadInput("the VOTable contains a FITS file", expected="rows in TABLEDATA or BINARY", got="<FITS>")
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
    parser.EndElementHandler = lambda name: size.end(_local(name))
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise BadInput(
            "the star list is not a votable table", expected="a votable file", got=str(error)[:200]
        ) from None


def _count(quantity: str, text: str) -> int:
    """Parse a whole number from a VOTable attribute; the length is limited because int() is slow for many digits."""
    if not re.fullmatch(r"\s{0,9}\d{1,18}\s{0,9}", text, re.ASCII):
        raise BadInput(f"{quantity} of the VOTable is not a number", expected="a whole number", got=text[:SHOWN])
    return int(text)


def _elements(arraysize: str) -> int:
    """Return the number of elements of fixed size: 12 for "3x4", "3x4*" and "3x4x*"."""
    parts = [part for part in arraysize.strip().rstrip("*").split("x", 9) if part.strip()]
    return math.prod(_count("arraysize", part) for part in parts)


def _local(name: str) -> str:
    """Return the name without its prefix, in lower case. XML is case-sensitive, but many files use the wrong case."""
    return name.rpartition(":")[2].lower()


def check_ecsv_header(lines: list[str]) -> None:
    """Raise BadInput for a header that is too long, nested too deeply, or uses YAML anchors and aliases."""
    size = sum(map(len, lines))
    if size > ECSV_HEADER_BYTES:
        raise BadInput(
            "the header of the star list is too long", expected=f"at most {ECSV_HEADER_BYTES} characters", got=str(size)
        )
    try:
        repeated = _has_aliases("\n".join(lines))
    except yaml.YAMLError as error:
        got = str(error).splitlines()[0][:200]
        raise BadInput("the star list is not an ecsv table", expected="a YAML header", got=got) from None
    if repeated:
        raise BadInput(
            "the header of the star list uses anchors or aliases",
            expected="plain values",
            got="& or * in its YAML",
        )


OPENING = (
    yaml.FlowSequenceStartToken,
    yaml.FlowMappingStartToken,
    yaml.BlockSequenceStartToken,
    yaml.BlockMappingStartToken,
)
CLOSING = (yaml.FlowSequenceEndToken, yaml.FlowMappingEndToken, yaml.BlockEndToken)


def _has_aliases(header: str) -> bool:
    """True if the header has anchors or aliases.

    Raises BadInput if the header is nested too deeply, because the scanner's time grows with the square of the depth.
    """
    depth = 0
    for token in yaml.scan(header):
        if isinstance(token, yaml.AliasToken | yaml.AnchorToken):
            return True
        depth += isinstance(token, OPENING) - isinstance(token, CLOSING)
        if depth > DEEPEST_HEADER:
            raise BadInput(
                "the header of the star list is nested too deeply",
                expected=f"at most {DEEPEST_HEADER} levels",
                got="more",
            )
    return False


def check_quotes(text: str, delimiter: str) -> None:
    """Raise BadInput for a quote that is not closed on its line. Otherwise the reader would include the following rows
    in the value.

    A quote opens a value only at the beginning of the value. At other positions it is an arcsecond sign.
    """
    if '"' not in text:
        return
    value = rf'(?:"(?:[^"]|"")*+"|(?!"))[^{re.escape(delimiter)}]*+'
    row_pattern = re.compile(rf"{value}(?:{re.escape(delimiter)}{value})*+")
    row = -1
    for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n"):
        if not line:
            continue
        row += 1
        if '"' in line and not row_pattern.fullmatch(line):
            where = f"row {row}" if row else "the header"
            raise BadInput(
                f"{where}: a quote is opened and not closed on its line",
                expected="one line for each star",
                got=line[:SHOWN],
                hint='close it, or write it as """"',
            )
