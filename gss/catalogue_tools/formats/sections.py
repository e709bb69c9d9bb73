"""Sections after the pairs in an image of header version 2, each with its tag and length (chosen).

The star list and the pairs are followed by zero bytes up to a multiple of four from the start of the image, then

offset type meaning
     0  4s   magic "GSSX"
     4  u32  bytes from here to the end of the image
     8       sections, one after the other: 4s tag, u32 bytes of content, content, zero bytes to a multiple of four

The sections are part of the body covered by the CRC-32 in the header. A reader of version 1 rejects such an image.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.formats.blocks import Block, BlockField, padding, raw, to_bytes, u32
from gss.catalogue_tools.formats.constellation_sections import (
    CONSTELLATION_KINDS,
    class_blocks,
    class_columns,
    constellation_blocks,
    constellation_columns,
    read_constellations,
)
from gss.catalogue_tools.formats.section_contents import (
    k_blocks,
    link_blocks,
    read_k,
    read_links,
    read_reduced,
    reduced_blocks,
    write_k,
    write_links,
    write_reduced,
)
from gss.domain.errors import BadInput, CorruptData
from gss.skytables.bank import BankTables
from gss.skytables.pairs import DistanceTable

MAGIC = b"GSSX"
HEAD_BYTES = 8
Sections = dict[str, bytes]


def _write_kind(kind: int) -> Callable[[BankTables, int, int], bytes | None]:
    def write(tables: BankTables, stars: int, pairs: int) -> bytes | None:
        constellations = tables.constellations
        if constellations is None:
            return None
        if constellations.stars != stars:
            raise BadInput(
                "the triplets belong to another star list", expected=f"{stars} stars", got=str(constellations.stars)
            )
        columns = constellation_columns(constellations, kind)
        return to_bytes(constellation_blocks(kind, len(columns["star"])), columns)

    return write


def _write_classes(tables: BankTables, stars: int, pairs: int) -> bytes | None:
    return None if tables.constellations is None else to_bytes(class_blocks(), class_columns(tables.constellations))


@dataclass(frozen=True)
class SectionType:
    """Definition of one type of section. ``write``: function from (tables, stars, pairs) to the content, None if the
    section is absent. ``blocks``: function from (bytes of content, stars, pairs) to the blocks."""

    tag: str
    title: str
    write: Callable[[BankTables, int, int], bytes | None]
    blocks: Callable[[int, int, int], tuple[Block, ...]]
    fields: tuple[BlockField, ...]


def _kind_section(tag: str, title: str, kind: int) -> SectionType:
    fields = (
        BlockField("star", "<u2", "", "row of the star"),
        BlockField("first", "<u2", "", "class of the distance to the nearest neighbour"),
        BlockField("second", "<u2", "", "class of the distance to the second nearest neighbour"),
        BlockField("angle_low", "<u1", "", "lowest class of the angle between them"),
        BlockField("angle_high", "<u1", "", "highest class of that angle"),
    )
    return SectionType(tag, title, _write_kind(kind), lambda size, n, m: constellation_blocks(kind, size // 8), fields)


SECTIONS: dict[str, SectionType] = {
    s.tag: s
    for s in (
        SectionType(
            "KVEC",
            "k-vector of the pairs",
            write_k,
            k_blocks,
            (
                BlockField("start", "<f8", "", "value of the line at entry 0 (rad, or sin² in far-mst)"),
                BlockField("step", "<f8", "", "increase of the line per entry"),
                BlockField("k", "<u2 or <u4", "", "m counts: pairs not above the line; u32 from 65 536 pairs"),
            ),
        ),
        SectionType(
            "REDU",
            "reduced catalogue and its frame (Huffman 2006 §5.5.4)",
            write_reduced,
            reduced_blocks,
            (
                BlockField("width_rad", "<f4", "rad", "width of the frame"),
                BlockField("height_rad", "<f4", "rad", "height of the frame"),
                BlockField("step_rad", "<f4", "rad", "angle between pointings"),
                BlockField("brightest", "<u4", "", "number of brightest stars per frame"),
                BlockField("kept_bits", "<u1", "", "⌈n/8⌉ bytes, one bit per star, lowest bit first"),
            ),
        ),
        SectionType(
            "TCLS",
            "classes of the triplets (Liebe 1992)",
            _write_classes,
            lambda size, n, m: class_blocks(),
            (
                BlockField("distance_rad", "<f8", "rad", "width of a class of distances"),
                BlockField("angle_rad", "<f8", "rad", "width of a class of angles"),
                BlockField("uncertainty_rad", "<f8", "rad", "largest error of one star's position"),
                BlockField("limit_mag", "<f8", "mag", "magnitude at which a star is detected half of the time"),
                BlockField("brightness_error", "<f8", "", "relative uncertainty of brightness"),
                BlockField("max_rad", "<f8", "rad", "largest distance of a neighbour"),
            ),
        ),
        _kind_section("TCER", "triplets of stars that are always detected", 0),
        _kind_section("TMAY", "triplets with a neighbour that can be missed or blended", 1),
        _kind_section("TEXC", "triplets that arise only from a position error", 2),
        SectionType(
            "LINK",
            "linked list of neighbours (Moniteq 1983 §6.1)",
            write_links,
            link_blocks,
            (
                BlockField("count", "<u2", "", "n counts of neighbours"),
                BlockField("pointer", "<u2", "", "n positions of the first neighbour"),
                BlockField("neighbour", "<u2", "", "rows of the neighbours, ascending for each star"),
            ),
        ),
    )
}


# --- the sequence of sections ---


def write_sections(tables: BankTables, stars: int, pairs: int, core_bytes: int) -> bytes:
    """Encode all data after the pairs; empty without sections. ``core_bytes``: length of header, star list and
    pairs."""
    content: Sections = {}
    for tag, section in SECTIONS.items():
        payload = section.write(tables, stars, pairs)
        if payload is not None:
            content[tag] = payload
    if not content:
        return b""
    row = b"".join(
        tag.encode() + u32.pack(len(data)) + data + bytes(padding(len(data))) for tag, data in content.items()
    )
    return bytes(padding(core_bytes)) + MAGIC + u32.pack(HEAD_BYTES + len(row)) + row


def sections_end(image: bytes | memoryview, core_bytes: int) -> int:
    """Return the end offset of an image with sections, as the image states it. Raises CorruptData if the data are
    shorter. The content is not checked."""
    at = core_bytes + padding(core_bytes)
    if len(image) < at + HEAD_BYTES:
        raise CorruptData(
            "the bank image is truncated", expected=f"{at + HEAD_BYTES} bytes or more", got=f"{len(image)} bytes"
        )
    if bytes(image[at : at + 4]) != MAGIC:
        raise CorruptData("the sections of the bank image are damaged", expected=f"magic {MAGIC!r}")
    (size,) = u32.unpack_from(image, at + 4)
    if len(image) < at + size:
        raise CorruptData("the bank image is truncated", expected=f"{at + size} bytes", got=f"{len(image)} bytes")
    return int(at + size)


def walk(image: bytes | memoryview, core_bytes: int) -> Iterator[tuple[str, int, int]]:
    """Yield (tag, offset of the content, size of the content in bytes) of each section. The CRC must be verified before
    the call."""
    at, end = core_bytes + padding(core_bytes) + HEAD_BYTES, sections_end(image, core_bytes)
    last = -1
    while at < end:
        tag = bytes(image[at : at + 4]).decode("latin-1")
        order = list(SECTIONS).index(tag) if tag in SECTIONS else -1
        size = int(u32.unpack_from(image, at + 4)[0]) if at + HEAD_BYTES <= end else end
        # Sections must be in the order of the registry, without repetition.
        if order <= last or at + HEAD_BYTES + size + padding(size) > end:
            raise CorruptData("unknown or misplaced section", expected=", ".join(SECTIONS), got=repr(tag))
        last = order
        yield tag, at + HEAD_BYTES, size
        at += HEAD_BYTES + size + padding(size)


def read_sections(
    image: bytes | memoryview,
    core_bytes: int,
    core_tables: BankTables,
    distances: DistanceTable,
    stars: int,
    pairs: int,
) -> BankTables:
    """Return ``core_tables`` with the tables of the sections added. Raises CorruptData if a section is not valid."""
    content: Sections = {}
    for tag, at, size in walk(image, core_bytes):
        data = bytes(image[at : at + size])
        if size != sum(b.size for b in SECTIONS[tag].blocks(size, stars, pairs)):
            raise CorruptData("a section has the wrong length", expected=f"{tag} of whole rows", got=f"{size} bytes")
        content[tag] = data
    tables = core_tables
    if "KVEC" in content:
        tables = read_k(content["KVEC"], tables, stars, pairs)
        _check_index(tables, distances)
    if "REDU" in content:
        tables = read_reduced(content["REDU"], tables, stars, pairs)
    if "LINK" in content:
        tables = read_links(content["LINK"], tables, stars, pairs)
    if any(tag in content for tag in ("TCLS", *CONSTELLATION_KINDS)):
        tables = replace(tables, constellations=read_constellations(content, stars))
    return tables


def _check_index(tables: BankTables, distances: DistanceTable) -> None:
    index, values = tables.index, distances.distance_rad if tables.sin2 is None else tables.sin2
    assert index is not None  # noqa: S101 - just read
    line = index.start + index.step * np.arange(len(values))
    if not np.array_equal(index.k, np.searchsorted(values.astype(float), line, side="right")):
        raise CorruptData("the k-vector does not fit the pairs", expected="the counts of pairs below its line")


def section_blocks(image: bytes | memoryview, core_bytes: int, stars: int, pairs: int) -> list[Block]:
    """Return the blocks of all data after the pairs."""
    gap = padding(core_bytes)
    blocks = [raw(gap + HEAD_BYTES, "sections_head")]
    for tag, _, size in walk(image, core_bytes):
        blocks.append(raw(HEAD_BYTES, f"{tag.lower()}_head"))
        blocks += SECTIONS[tag].blocks(size, stars, pairs)
        if padding(size):
            blocks.append(raw(padding(size), f"{tag.lower()}_end"))
    return blocks
