"""Registry of the on-board formats, with encoding and decoding of bank images.

A bank image is the header, the star list, the pairs and, in header version 2, sections. Star numbers are row numbers
from 0; the manifest has the Hipparcos numbers of the rows.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gss.catalogue_tools.formats import aim, cubestar, far_mst, oersted, sunsat, sunsat_5
from gss.catalogue_tools.formats.blocks import Block, padding, raw, to_bytes, to_columns
from gss.catalogue_tools.formats.checks import check_content, check_pairs, check_stars
from gss.catalogue_tools.formats.header import HEADER_BYTES, SECTIONS_VERSION, BankHeader, pack_header, unpack_header
from gss.catalogue_tools.formats.layout import BankFormat
from gss.catalogue_tools.formats.own_tables import completed
from gss.catalogue_tools.formats.sections import read_sections, section_blocks, sections_end, walk, write_sections
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput, CorruptData
from gss.domain.stars import Ids, StarTable
from gss.skytables.bank import NO_TABLES, BankTables, OnboardCatalogue
from gss.skytables.pairs import DistanceTable

BY_NAME: dict[str, BankFormat] = {m.FORMAT.name: m.FORMAT for m in (cubestar, sunsat, sunsat_5, far_mst, oersted, aim)}
FORMATS = {name: f.number for name, f in BY_NAME.items()}
NAMES = {number: name for name, number in FORMATS.items()}
C_SUFFIX = "-c"
C_FORMATS = tuple(name + C_SUFFIX for name in FORMATS)
# Typical size of the triplet sections in bytes per star, to estimate the size of a whole-sky image before it is built.
# Measured for stars to V 4.5.
TYPICAL_TRIPLET_BYTES_PER_STAR = 53


@dataclass(frozen=True)
class QuantisationError:
    """Largest errors of position, distance and magnitude due to the on-board number widths; NaN if the format has no
    magnitude, 0 if it has no distances."""

    position_rad: float
    distance_rad: float
    v_mag: float


def check_format(format_name: str) -> str:
    """Return the name. Raises BadInput if it is not a known format."""
    if format_name not in BY_NAME:
        raise BadInput("unknown on-board format", expected=" | ".join(BY_NAME), got=format_name)
    return format_name


def format_of(format_name: str) -> BankFormat:
    """Return the format of that name."""
    return BY_NAME[check_format(format_name)]


def base_format(name: str) -> str:
    """Return the binary format of a C source format: cubestar for "cubestar-c". Other names are returned unchanged."""
    return check_format(name.removesuffix(C_SUFFIX))


def core_bytes(format_name: str, stars: int, pairs: int) -> int:
    """Return the length of header, star list and pairs in bytes."""
    fmt = format_of(format_name)
    return HEADER_BYTES + stars * fmt.stars.row_bytes + pairs * fmt.pair_bytes


def image_bytes(format_name: str, stars: int, pairs: int) -> int:
    """Estimate the length of a bank image before it is made.

    The estimate is exact for formats without sections and for the links of whole-sky lists. For triplets a typical size
    is used, because the number of triplets depends on the sky.
    """
    size = core_bytes(format_name, stars, pairs)
    extra = 0
    for tag in format_of(format_name).sections:
        extra += {
            "KVEC": 24 + pairs * (2 if pairs < 1 << 16 else 4),
            "TCLS": 8 + 48,
            "TCER": 8 + TYPICAL_TRIPLET_BYTES_PER_STAR * stars,
            "LINK": 8 + 4 * stars + 4 * max(0, 3 * stars - 6),
        }.get(tag, 8)
    return size + (padding(size) + 8 + extra + padding(extra) if extra else 0)


def encode(
    stars: StarTable,
    distances: DistanceTable,
    format_name: str,
    profile_name: str,
    profile_hash: bytes = bytes(8),
    tables: BankTables | None = None,
) -> bytes:
    """Encode a star list and the distance table over its rows as a bank image. Raises BadInput if they do not fit the
    format.

    ``tables``: further tables (see :func:`own_tables.tables_for`). Missing tables that the format requires are
    computed. A format without a distance table omits the distances.
    """
    fmt = format_of(format_name)
    check_stars(fmt, stars)
    if fmt.pairs is None:
        none = np.empty(0, np.int32)
        distances = DistanceTable(none, none, np.empty(0), distances.min_rad, distances.max_rad)
    check_pairs(fmt, len(stars), distances)
    star_columns, pair_columns = fmt.write(stars, distances)
    blocks = fmt.blocks(len(stars), len(distances))
    star_blocks = [b for b in blocks if b.table == "stars"]
    pair_blocks = [b for b in blocks if b.table == "pairs"]
    core = to_bytes(star_blocks, star_columns) + to_bytes(pair_blocks, pair_columns)
    stored = to_columns(pair_blocks, core[sum(b.size for b in star_blocks) :])
    have = completed(fmt, stars, stored, distances, tables or NO_TABLES)
    body = core + write_sections(have, len(stars), len(distances), HEADER_BYTES + len(core))
    header = BankHeader(
        format_name,
        len(stars),
        len(distances),
        stars.epoch_jyear,
        distances.min_rad,
        distances.max_rad,
        profile_name,
        profile_hash,
        zlib.crc32(body),
        SECTIONS_VERSION if len(body) > len(core) else 1,
    )
    return pack_header(header, fmt.number) + body


def read_header(image: bytes) -> BankHeader:
    """Return the header of a bank image after verifying its checksum. The body is not checked."""
    return unpack_header(image, NAMES)


def image_end(image: bytes, header: BankHeader | None = None) -> int:
    """Return the length of the bank image, which can be less than ``len(image)``, because flash is larger than its
    content."""
    h = header or read_header(image)
    total = core_bytes(h.format_name, h.stars, h.pairs)
    if len(image) < total:
        raise CorruptData("the bank image is truncated", expected=f"{total} bytes", got=f"{len(image)} bytes")
    return sections_end(image, total) if h.version == SECTIONS_VERSION else total


def decode(image: bytes, hip: Ids | None = None) -> OnboardCatalogue:
    """Decode a bank image at the device's number widths. Raises CorruptData if it is not valid.

    ``hip``: (n,) Hipparcos numbers by row, from the manifest; None: use the row numbers. Trailing bytes are ignored,
    because a flash bank is larger than its image.
    """
    header = read_header(image)
    image_data = memoryview(image)[: _checked_end(image, header)]
    fmt, n = format_of(header.format_name), header.stars
    if hip is not None and len(hip) != n:
        raise BadInput(
            "the list of Hipparcos numbers is for another image",
            expected=f"{n} numbers",
            got=f"{len(hip)}",
            hint="use the manifest that was written together with this image",
        )
    star_end, core = core_bytes(header.format_name, n, 0), core_bytes(header.format_name, n, header.pairs)
    star_columns = to_columns(fmt.stars.blocks(n), image_data[HEADER_BYTES:star_end])
    pair_columns = to_columns(fmt.pairs.blocks(header.pairs), image_data[star_end:core]) if fmt.pairs else {}
    content = fmt.read(star_columns, pair_columns, header)
    check_content(content.icrs, content.distances, n)
    tables = content.tables
    if header.version == SECTIONS_VERSION:
        tables = read_sections(image_data, core, tables, content.distances, n, header.pairs)
    _check_sections(fmt, header, image_data, core)
    rows = np.arange(n, dtype=np.int32) if hip is None else np.asarray(hip, np.int32)
    return OnboardCatalogue(rows, content.icrs, content.v_mag, content.distances, tables)


def _checked_end(image: bytes, header: BankHeader) -> int:
    total = image_end(image, header)
    crc = zlib.crc32(memoryview(image)[HEADER_BYTES:total])
    if crc != header.body_crc32:
        raise CorruptData(
            "the body of the bank image is damaged", expected=f"CRC-32 {header.body_crc32:08x}", got=f"{crc:08x}"
        )
    return total


def blocks_of(image: bytes) -> list[tuple[Block, bytes]]:
    """Verify the checksums and return every block of an image with its bytes, header first. The concatenated bytes are
    the image."""
    header = read_header(image)
    total, n, m = _checked_end(image, header), header.stars, header.pairs
    core = core_bytes(header.format_name, n, m)
    blocks = [raw(HEADER_BYTES, "header"), *format_of(header.format_name).blocks(n, m)]
    if header.version == SECTIONS_VERSION:
        blocks += section_blocks(memoryview(image)[:total], core, n, m)
    return list(_cut(image, blocks))


def _cut(image: bytes, blocks: list[Block]) -> Iterator[tuple[Block, bytes]]:
    at = 0
    for block in blocks:
        yield block, bytes(image[at : at + block.size])
        at += block.size


def part_bytes(image: bytes) -> dict[str, int]:
    """Return the number of bytes of header, stars, distances, and of each section by its tag. ``sections`` is the
    overhead of the sections."""
    header = read_header(image)
    fmt, total = format_of(header.format_name), image_end(image, header)
    parts = {
        "header": HEADER_BYTES,
        "stars": header.stars * fmt.stars.row_bytes,
        "distances": header.pairs * fmt.pair_bytes,
    }
    if header.version == SECTIONS_VERSION:
        core = core_bytes(header.format_name, header.stars, header.pairs)
        parts |= {tag: size for tag, _, size in walk(image[:total], core)}
        parts["sections"] = total - sum(parts.values())
    return parts


def stars_of(catalogue: OnboardCatalogue, epoch_jyear: float) -> StarTable:
    """Convert a decoded catalogue to a star table for encoding. Values that the bank does not store are zero or NaN."""
    n, flags = len(catalogue), catalogue.tables.flags
    return StarTable(
        hip=catalogue.hip,
        icrs=catalogue.icrs.astype(float),
        v_mag=catalogue.v_mag.astype(float),
        b_v=np.full(n, np.nan),
        proper_motion_rad_yr=np.zeros((n, 3)),
        parallax_rad=np.zeros(n),
        flags=np.zeros(n, np.uint16) if flags is None else flags.astype(np.uint16),
        epoch_jyear=epoch_jyear,
    )


def encoded_again(image: bytes) -> bytes:
    """Decode an image and encode its content again. The result has the same bytes."""
    header, decoded = read_header(image), decode(image)
    stars = stars_of(decoded, header.epoch_jyear)
    tables = replace(decoded.tables, flags=None)
    return encode(stars, decoded.distances, header.format_name, header.profile_name, header.profile_hash, tables)


def quantisation_error(stars: StarTable, distances: DistanceTable, image: bytes) -> QuantisationError:
    """Return the largest differences between the input and the content of a bank image.

    ``distances``: distances of the pairs in the image; ignored if the format has no pairs. Raises BadInput if the
    number of pairs differs.
    """
    stored = decode(image)
    position = separation_rad(stored.icrs.astype(float), stars.icrs)
    magnitude = np.abs(stored.v_mag - stars.v_mag)
    distance = np.zeros(1)
    if len(stored.distances):
        if len(stored.distances) != len(distances):
            raise BadInput(
                "the distance table belongs to another image",
                expected=str(len(stored.distances)),
                got=str(len(distances)),
            )
        distance = np.abs(stored.distances.distance_rad.astype(float) - distances.distance_rad)
    return QuantisationError(
        float(position.max()),
        float(distance.max()),
        float("nan") if np.isnan(magnitude).all() else float(np.nanmax(magnitude)),
    )


def _check_sections(fmt: BankFormat, header: BankHeader, image: memoryview, core: int) -> None:
    """Raise CorruptData if a required section is missing.

    A k-vector can be missing, because a list with fewer than two different pairs has none. The optional kinds of
    triplets can also be missing.
    """
    have = {tag for tag, _, _ in walk(image, core)} if header.version == SECTIONS_VERSION else set()
    missing = [tag for tag in fmt.sections if tag not in have and tag not in ("KVEC", "TMAY", "TEXC")]
    if missing:
        raise CorruptData(
            f"the {fmt.name} image lacks required sections", expected=", ".join(fmt.sections), got="fewer"
        )
