"""Liebe's triplet database of a star list, and its binary format on the sensor (the "triplet table").

All numbers are little endian. A table belongs to one bank image, and its star numbers are rows of that image's star
list.

Header, offset type meaning
     0  4s   magic "GSST"
     4  u8   version of this header, 1
     5  u8   0
     6  u16  length of the header, 64
     8  u32  number of stars in the star list
    12  u32  number of references, m
    16  f64  width of a class of distances, rad
    24  f64  width of a class of angles, rad
    32  f64  uncertainty of one star's position, rad
    40  f32  magnitude at which a star is detected half of the time
    44  f32  relative uncertainty of brightness
    48  f32  largest distance of a neighbour, rad
    52  u32  CRC-32 of the body of the bank image it belongs to; 0: not specified
    56  u32  CRC-32 of the body
    60  u32  CRC-32 of the 60 bytes before

Body: u32 key[m] ascending, u16 star[m]: 6 bytes per reference. A key is first << 18 | second << 6 | angle, the class
numbers of the nearest distance, the second nearest, and the angle between them (Liebe 1992, Figs. 6 to 11).
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np

from gss.domain.errors import BadInput, CorruptData
from gss.domain.stars import StarTable
from gss.skytables.triplets import TripletClasses, TripletTable, build_triplets, faintest_mag

MAGIC = b"GSST"
HEADER_VERSION = 1
HEADER = struct.Struct("<4sBBHIIdddfffII")
HEADER_BYTES = HEADER.size + 4
REFERENCE_BYTES = 6
MAX_STARS = 1 << 16


@dataclass(frozen=True)
class TripletFigures:
    """Figures of a table: number of stars that can be detected, number of references, references per star, bytes, and
    the mean number of stars that share a key, averaged over the references."""

    stars: int
    references: int
    per_star: float
    size_bytes: int
    stars_per_key: float


def triplets_of(
    stars: StarTable,
    classes: TripletClasses,
    limit_mag: float,
    max_rad: float,
    *,
    brightness_error: float = 0.25,
    blend_rad: float = 0.0,
) -> TripletTable:
    """Build the triplet table of a star list. Raises BadInput if the list ends before ``limit_mag``. The table is complete
    only if the list reaches :func:`faintest_mag` (Liebe 1992 uses a list of 1539 stars to detect 1100)."""
    need = faintest_mag(limit_mag, brightness_error)
    if not len(stars) or float(stars.v_mag.max()) < limit_mag:
        raise BadInput(
            "the star list ends before the detection limit",
            expected=f"stars to V {need:.2f}",
            got=f"V {float(stars.v_mag.max()):.2f}" if len(stars) else "no stars",
            hint="use a fainter magnitude limit for the selection",
        )
    return build_triplets(
        stars.icrs, stars.v_mag, classes, limit_mag, max_rad, brightness_error=brightness_error, blend_rad=blend_rad
    )


def figures(table: TripletTable) -> TripletFigures:
    """Compute size and selectivity of a table."""
    stars = len(np.unique(table.star))
    _, count = np.unique(table.key, return_counts=True)
    share = float(np.sum(count.astype(float) ** 2) / len(table)) if len(table) else float("nan")
    size = HEADER_BYTES + REFERENCE_BYTES * len(table)
    return TripletFigures(stars, len(table), len(table) / max(stars, 1), size, share)


def encode_triplets(table: TripletTable, bank_crc32: int = 0) -> bytes:
    """Encode a table. ``bank_crc32``: CRC-32 of the body of the bank image that contains the star list of the table."""
    if table.stars > MAX_STARS:
        raise BadInput("too many stars for the triplet table", expected=f"at most {MAX_STARS}", got=str(table.stars))
    body = table.key.astype("<u4").tobytes() + table.star.astype("<u2").tobytes()
    header = HEADER.pack(
        MAGIC,
        HEADER_VERSION,
        0,
        HEADER_BYTES,
        table.stars,
        len(table),
        table.classes.distance_rad,
        table.classes.angle_rad,
        table.classes.uncertainty_rad,
        table.limit_mag,
        table.brightness_error,
        table.max_rad,
        bank_crc32,
        zlib.crc32(body),
    )
    return header + struct.pack("<I", zlib.crc32(header)) + body


def decode_triplets(image: bytes) -> TripletTable:
    """Decode and check a table. Raises CorruptData if it is not valid. Trailing bytes are ignored, because flash is
    larger than its content."""
    fields = _header(image)
    _, _, _, _, stars, count, distance, angle, uncertainty, limit_mag, error, max_rad, _, crc = fields
    total = HEADER_BYTES + REFERENCE_BYTES * count
    if len(image) < total:
        raise CorruptData("the triplet table is truncated", expected=f"{total} bytes", got=f"{len(image)} bytes")
    body = memoryview(image)[HEADER_BYTES:total]
    if zlib.crc32(body) != crc:
        raise CorruptData(
            "the body of the triplet table is damaged", expected=f"CRC-32 {zlib.crc32(body):08x}", got=f"{crc:08x}"
        )
    key = np.frombuffer(body, "<u4", count).astype(np.uint32)
    star = np.frombuffer(body, "<u2", count, 4 * count).astype(np.int32)
    if np.any(key[1:] < key[:-1]):
        raise CorruptData("the triplet table is not sorted", expected="ascending keys")
    if len(star) and int(star.max()) >= stars:
        raise CorruptData(
            "a triplet refers to a star that is not in the list", expected=f"below {stars}", got=f"{star.max()}"
        )
    try:
        classes = TripletClasses(distance, angle, uncertainty)
    except BadInput as error_:
        raise CorruptData(
            "the classes of the triplet table are inconsistent", expected=error_.expected, got=error_.got
        ) from None
    return TripletTable(key, star, stars, classes, limit_mag, error, max_rad)


def bank_crc32_of(image: bytes) -> int:
    """Return the CRC-32 of the body of the bank image that a table belongs to; 0 if not specified."""
    return int(_header(image)[12])


def _header(image: bytes) -> tuple[bytes, int, int, int, int, int, float, float, float, float, float, float, int, int]:
    if len(image) < HEADER_BYTES:
        raise CorruptData("not a triplet table", expected=f"at least {HEADER_BYTES} bytes", got=f"{len(image)} bytes")
    fields = HEADER.unpack_from(image)
    if fields[0] != MAGIC:
        raise CorruptData("not a triplet table", expected=f"magic {MAGIC!r}", got=repr(fields[0]))
    (crc,) = struct.unpack_from("<I", image, HEADER.size)
    if crc != zlib.crc32(image[: HEADER.size]):
        raise CorruptData("the header of the triplet table is damaged", expected="its CRC-32", got=f"{crc:08x}")
    if fields[1] != HEADER_VERSION or fields[3] != HEADER_BYTES:
        raise CorruptData(
            "unknown kind of triplet table", expected=f"version {HEADER_VERSION}", got=f"version {fields[1]}"
        )
    return fields
