"""The byte tables of docs/catalogue-formats.md agree with the format definitions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gss.catalogue_tools.formats.blocks import BlockField, Rows
from gss.catalogue_tools.formats.header import HEADER_BYTES
from gss.catalogue_tools.formats.layout import BankFormat
from gss.catalogue_tools.formats.registry import BY_NAME
from gss.catalogue_tools.formats.sections import SECTIONS


def test_the_page_has_the_byte_tables_of_the_code(root: Path) -> None:
    """docs/catalogue-formats.md has the offsets, types and fields of every format and section."""
    page = (root / "docs" / "catalogue-formats.md").read_text()
    for name, fmt in BY_NAME.items():
        assert format_table(fmt) in page, name
        assert f"| {name} | {fmt.number} |" in page
    for tag in SECTIONS:
        assert section_table(tag) in page, tag


def format_table(fmt: BankFormat) -> str:
    """Return the Markdown table of a format: offset in the image, type, field, unit and meaning, for n stars and m
    pairs.
    """
    lines = _rows(fmt.stars, "n", _Offset(HEADER_BYTES, 0, 0))
    if fmt.pairs:
        lines += _rows(fmt.pairs, "m", _Offset(HEADER_BYTES, fmt.stars.row_bytes, 0))
    return "\n".join(["| offset | type | field | unit | meaning |", "|---|---|---|---|---|", *lines])


def section_table(tag: str) -> str:
    """Return the Markdown table of the fields of a section, in order."""
    lines = [f"| {_type(f.type)} | {f.name} | {f.unit} | {f.meaning} |" for f in SECTIONS[tag].fields]
    return "\n".join(["| type | field | unit | meaning |", "|---|---|---|---|", *lines])


class _Offset:
    """Offset a + b·n + c·m in text form."""

    def __init__(self, fixed: int, per_star: int, per_pair: int) -> None:
        self.fixed, self.per_star, self.per_pair = fixed, per_star, per_pair

    def __str__(self) -> str:
        parts = [str(self.fixed)]
        parts += [f"{k}n" for k in (self.per_star,) if k]
        parts += [f"{k}m" for k in (self.per_pair,) if k]
        return " + ".join(parts)


def _rows(rows: Rows, count: str, offset: _Offset) -> list[str]:
    """Return the table lines of a block of rows."""
    if rows.bits:
        return [_packed(rows, count, offset)]
    lines, inside = [], 0
    for f in rows.fields:
        size = np.dtype(f.type).itemsize
        if rows.records:
            position = f"{offset} + {rows.row_bytes}i" + (f" + {inside}" if inside else "")
            lines.append(_line(position, _type(f.type), f))
            inside += size
        else:
            lines.append(_line(str(offset), f"{_type(f.type)}[{count}]", f))
            offset = _Offset(
                offset.fixed, offset.per_star + size * (count == "n"), offset.per_pair + size * (count == "m")
            )
    return lines


def _packed(rows: Rows, count: str, offset: _Offset) -> str:
    """Return the table line of an entry with packed bits."""
    low, parts = 0, []
    for f, width in zip(rows.fields, rows.bits, strict=True):
        unit = f" ({f.unit})" if f.unit else ""
        bits = f"bits {low} to {low + width - 1}" if width > 1 else f"bit {low}"
        parts.append(f"{bits}: {f.name}{unit}, {f.meaning}")
        low += width
    return f"| {offset} + {rows.row_bytes}i | u8[{rows.row_bytes}] | entry | | {'; '.join(parts)} |"


def _line(position: str, kind: str, f: BlockField) -> str:
    return f"| {position} | {kind} | {f.name} | {f.unit} | {f.meaning} |"


def _type(name: str) -> str:
    """Return the type of a number in the notation of the page, for example u16."""
    letters = {"i": "i", "u": "u", "f": "f"}
    parts = [w.lstrip("<") for w in name.split()]
    return " ".join(w if w == "or" else letters[w[0]] + str(8 * int(w[1:])) for w in parts)
