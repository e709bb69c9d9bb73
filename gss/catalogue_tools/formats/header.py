"""Header of every bank image, 64 bytes. All numbers are little endian, as on CubeStar's Cortex-M3 and Sunsat's
transputer.

offset type meaning
     0  4s   magic "GSSB"
     4  u8   version: 1, or 2 if sections follow the star list and the pairs
     5  u8   format: its number in the registry
     6  u16  length of the header, 64
     8  u32  number of stars, n
    12  u32  number of pairs, m
    16  f64  epoch of the positions, Julian year
    24  f32  smallest distance in the table, rad
    28  f32  largest distance in the table, rad
    32  16s  name of the camera profile, UTF-8, padded with zeros
    48  8s   first 8 bytes of the SHA-256 of the camera profile (see manifest.profile_sha256)
    56  u32  CRC-32 of the body
    60  u32  CRC-32 of the 60 bytes before

The layout is chosen, because no document specifies a header.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from gss.domain.errors import BadInput, CorruptData

MAGIC = b"GSSB"
HEADER_VERSION = 1
SECTIONS_VERSION = 2
HEADER = struct.Struct("<4sBBHIIdff16s8sI")
HEADER_BYTES = HEADER.size + 4
NAME_BYTES = 16


@dataclass(frozen=True)
class BankHeader:
    """Fields of the header. ``version`` 2: sections follow the pairs."""

    format_name: str
    stars: int
    pairs: int
    epoch_jyear: float
    min_rad: float
    max_rad: float
    profile_name: str
    profile_hash: bytes
    body_crc32: int
    version: int = HEADER_VERSION


def pack_header(header: BankHeader, number: int) -> bytes:
    """Encode the header. ``number``: number of the format."""
    name = header.profile_name.encode()
    if len(name) > NAME_BYTES:
        raise BadInput("camera profile name is too long for the bank header", expected="16 bytes", got=name.decode())
    content = HEADER.pack(
        MAGIC,
        header.version,
        number,
        HEADER_BYTES,
        header.stars,
        header.pairs,
        header.epoch_jyear,
        header.min_rad,
        header.max_rad,
        name,
        header.profile_hash[:8],
        header.body_crc32,
    )
    return content + struct.pack("<I", zlib.crc32(content))


def unpack_header(image: bytes, names: dict[int, str]) -> BankHeader:
    """Decode and check the header of a bank image. The body is not checked. ``names``: names of the formats by
    number."""
    if len(image) < HEADER_BYTES:
        raise CorruptData("not a bank image", expected=f"at least {HEADER_BYTES} bytes", got=f"{len(image)} bytes")
    magic, version, number, length, stars, pairs, epoch, low, high, name, profile_hash, crc = HEADER.unpack_from(image)
    if magic != MAGIC:
        raise CorruptData("not a bank image", expected=f"magic {MAGIC!r}", got=repr(magic))
    (header_crc,) = struct.unpack_from("<I", image, HEADER.size)
    computed_crc = zlib.crc32(image[: HEADER.size])
    if header_crc != computed_crc:
        raise CorruptData(
            "the header of the bank image is damaged", expected=f"CRC-32 {computed_crc:08x}", got=f"{header_crc:08x}"
        )
    if version not in (HEADER_VERSION, SECTIONS_VERSION) or length != HEADER_BYTES or number not in names:
        raise CorruptData(
            "unknown kind of bank image",
            expected=f"header version 1 or 2 of {HEADER_BYTES} bytes, format {sorted(names)}",
            got=f"version {version} of {length} bytes, format {number}",
        )
    profile_name = name.rstrip(b"\0").decode("utf-8", "replace")
    return BankHeader(names[number], stars, pairs, epoch, low, high, profile_name, profile_hash, crc, version)
