"""Bank images: a star list and its distance table in the bytes a sensor keeps in flash, both ways.

A bank image is one header of 64 bytes and the body that the document of the system prescribes. Everything is little
endian: CubeStar's Cortex-M3 and Sunsat's transputer both are.

Header, offset type meaning
     0  4s   magic "GSSB"
     4  u8   version of this header, 1
     5  u8   format: 1 cubestar, 2 sunsat
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

Body, cubestar (Erlank 2013 §5.3.2: four constant arrays and three constant arrays): i16 id[n], f32 x[n], y[n], z[n]
(ICRS unit vector); i16 first[m], i16 second[m], f32 distance_rad[m]. 14 bytes per star, 8 per pair.
Body, sunsat (Jacobs 1995 app. D.1, G.4): n records f32 RA, f32 Dec (rad, ICRS), f32 magnitude V; m records u16 first,
u16 second, f32 distance in rad. 12 bytes per star, 8 per pair.
The numbers of stars are row numbers from 0; the Hipparcos numbers of the rows are in the manifest.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ra_dec_from_unit, separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput, CorruptData
from gss.domain.stars import DistanceTable, Ids, OnboardCatalogue, StarTable

MAGIC = b"GSSB"
HEADER_VERSION = 1
HEADER = struct.Struct("<4sBBHIIdff16s8sI")
HEADER_BYTES = HEADER.size + 4
FORMATS = {"cubestar": 1, "sunsat": 2}
STAR_BYTES = {"cubestar": 14, "sunsat": 12}
PAIR_BYTES = 8
# Row numbers are i16 in the one and u16 in the other.
MOST_STARS = {"cubestar": 1 << 15, "sunsat": 1 << 16}
SUNSAT_STAR = np.dtype([("ra", "<f4"), ("dec", "<f4"), ("v", "<f4")])
SUNSAT_PAIR = np.dtype([("first", "<u2"), ("second", "<u2"), ("distance", "<f4")])
NORM_TOLERANCE = 1e-5


@dataclass(frozen=True)
class BankHeader:
    """What the header of a bank image says."""

    format_name: str
    stars: int
    pairs: int
    epoch_jyear: float
    min_rad: float
    max_rad: float
    profile_name: str
    profile_hash: bytes
    body_crc32: int


@dataclass(frozen=True)
class QuantisationError:
    """What the on-board number widths cost: worst position, distance and magnitude; NaN where the format has no magnitude."""

    position_rad: float
    distance_rad: float
    v_mag: float


def image_bytes(format_name: str, stars: int, pairs: int) -> int:
    """Length of a bank image."""
    return HEADER_BYTES + stars * STAR_BYTES[check_format(format_name)] + pairs * PAIR_BYTES


def check_format(format_name: str) -> str:
    """The name, if it is a known format."""
    if format_name not in FORMATS:
        raise BadInput("unknown on-board format", expected=" | ".join(FORMATS), got=format_name)
    return format_name


def encode(
    stars: StarTable, distances: DistanceTable, format_name: str, profile_name: str, profile_hash: bytes = bytes(8)
) -> bytes:
    """The bank image of a star list and the distance table over its rows."""
    most = MOST_STARS[check_format(format_name)]
    if len(stars) > most:
        raise BadInput(
            f"too many stars for the {format_name} format",
            expected=f"at most {most}",
            got=str(len(stars)),
            hint="a brighter magnitude limit or a smaller envelope",
        )
    name = profile_name.encode()
    if len(name) > 16:
        raise BadInput("camera profile name is too long for the bank header", expected="16 bytes", got=profile_name)
    body = _cubestar_body(stars, distances) if format_name == "cubestar" else _sunsat_body(stars, distances)
    header = HEADER.pack(
        MAGIC,
        HEADER_VERSION,
        FORMATS[format_name],
        HEADER_BYTES,
        len(stars),
        len(distances),
        stars.epoch_jyear,
        distances.min_rad,
        distances.max_rad,
        name,
        profile_hash[:8],
        zlib.crc32(body),
    )
    return header + struct.pack("<I", zlib.crc32(header)) + body


def read_header(image: bytes) -> BankHeader:
    """The header of a bank image, checked; the body is not looked at."""
    if len(image) < HEADER_BYTES:
        raise CorruptData("not a bank image", expected=f"at least {HEADER_BYTES} bytes", got=f"{len(image)} bytes")
    magic, version, number, length, stars, pairs, epoch, low, high, name, profile_hash, crc = HEADER.unpack_from(image)
    if magic != MAGIC:
        raise CorruptData("not a bank image", expected=f"magic {MAGIC!r}", got=repr(magic))
    (header_crc,) = struct.unpack_from("<I", image, HEADER.size)
    if header_crc != zlib.crc32(image[: HEADER.size]):
        raise CorruptData(
            "the header of the bank image is damaged",
            expected=f"CRC-32 {zlib.crc32(image[: HEADER.size]):08x}",
            got=f"{header_crc:08x}",
        )
    names = {v: k for k, v in FORMATS.items()}
    if version != HEADER_VERSION or length != HEADER_BYTES or number not in names:
        raise CorruptData(
            "unknown kind of bank image",
            expected=f"header version {HEADER_VERSION} of {HEADER_BYTES} bytes, format {sorted(names)}",
            got=f"version {version} of {length} bytes, format {number}",
        )
    profile_name = name.rstrip(b"\0").decode("utf-8", "replace")
    return BankHeader(names[number], stars, pairs, epoch, low, high, profile_name, profile_hash, crc)


def decode(image: bytes, hip: Ids | None = None) -> OnboardCatalogue:
    """The catalogue in a bank image, at the device's number widths.

    ``hip``: (n,) Hipparcos numbers by row, from the manifest; without them the row numbers stand in. Bytes after the
    end of the body are ignored: a bank of flash is longer than its image.
    """
    header = read_header(image)
    total = image_bytes(header.format_name, header.stars, header.pairs)
    if len(image) < total:
        raise CorruptData("the bank image is cut short", expected=f"{total} bytes", got=f"{len(image)} bytes")
    body = memoryview(image)[HEADER_BYTES:total]
    if zlib.crc32(body) != header.body_crc32:
        raise CorruptData(
            "the body of the bank image is damaged",
            expected=f"CRC-32 {header.body_crc32:08x}",
            got=f"{zlib.crc32(body):08x}",
        )
    if hip is not None and len(hip) != header.stars:
        raise BadInput(
            "the list of Hipparcos numbers is for another image",
            expected=f"{header.stars} numbers",
            got=f"{len(hip)}",
            hint="the manifest that was written together with this image",
        )
    rows = np.arange(header.stars, dtype=np.int32) if hip is None else np.asarray(hip, np.int32)
    icrs, v_mag, distances = (_read_cubestar if header.format_name == "cubestar" else _read_sunsat)(body, header)
    _check_content(icrs, distances, header.stars)
    return OnboardCatalogue(rows, icrs, v_mag, distances)


def quantisation_error(stars: StarTable, distances: DistanceTable, image: bytes) -> QuantisationError:
    """Largest differences between what was meant and what a bank image holds."""
    stored = decode(image)
    position = separation_rad(stored.icrs.astype(float), stars.icrs)
    magnitude = np.abs(stored.v_mag - stars.v_mag)
    distance = np.abs(stored.distances.distance_rad.astype(float) - distances.distance_rad)
    return QuantisationError(
        float(position.max()),
        float(distance.max()) if len(distance) else 0.0,
        float("nan") if np.isnan(magnitude).all() else float(magnitude.max()),
    )


def _cubestar_body(stars: StarTable, distances: DistanceTable) -> bytes:
    columns = [
        np.arange(len(stars)).astype("<i2"),
        *(axis.astype("<f4") for axis in stars.icrs.T),
        distances.first.astype("<i2"),
        distances.second.astype("<i2"),
        distances.distance_rad.astype("<f4"),
    ]
    return b"".join(column.tobytes() for column in columns)


def _sunsat_body(stars: StarTable, distances: DistanceTable) -> bytes:
    star = np.empty(len(stars), SUNSAT_STAR)
    star["ra"], star["dec"] = ra_dec_from_unit(stars.icrs)
    star["v"] = stars.v_mag
    pair = np.empty(len(distances), SUNSAT_PAIR)
    pair["first"], pair["second"], pair["distance"] = distances.first, distances.second, distances.distance_rad
    return star.tobytes() + pair.tobytes()


Body = tuple[NDArray[np.floating], NDArray[np.floating], DistanceTable]


def _read_cubestar(body: memoryview, header: BankHeader) -> Body:
    n, m = header.stars, header.pairs
    ids = np.frombuffer(body, "<i2", n)
    if not np.array_equal(ids, np.arange(n)):
        raise CorruptData("star numbers are not the row numbers", expected=f"0 to {n - 1} in order", got="another list")
    icrs = np.frombuffer(body, "<f4", 3 * n, 2 * n).reshape(3, n).T.astype(np.float32)
    at = 14 * n
    first = np.frombuffer(body, "<i2", m, at).astype(np.int32)
    second = np.frombuffer(body, "<i2", m, at + 2 * m).astype(np.int32)
    distance = np.frombuffer(body, "<f4", m, at + 4 * m).astype(np.float32)
    table = DistanceTable(first, second, distance, header.min_rad, header.max_rad)
    return icrs, np.full(n, np.nan, np.float32), table


def _read_sunsat(body: memoryview, header: BankHeader) -> Body:
    star = np.frombuffer(body, SUNSAT_STAR, header.stars)
    pair = np.frombuffer(body, SUNSAT_PAIR, header.pairs, 12 * header.stars)
    icrs = unit_from_ra_dec(star["ra"].astype(float), star["dec"].astype(float))
    table = DistanceTable(
        pair["first"].astype(np.int32),
        pair["second"].astype(np.int32),
        pair["distance"].astype(np.float32),
        header.min_rad,
        header.max_rad,
    )
    return icrs, star["v"].astype(np.float32), table


def _check_content(icrs: NDArray[np.floating], distances: DistanceTable, stars: int) -> None:
    """A right CRC does not make a right catalogue: the same checks a careful reader of the bytes would make."""
    norm = np.linalg.norm(icrs.astype(float), axis=1)
    if not np.all(np.abs(norm - 1) < NORM_TOLERANCE):
        raise CorruptData("a star's direction is no unit vector", expected="length 1", got=f"row {_worst(norm)}")
    ends = np.stack([distances.first, distances.second])
    if ends.size and (ends.min() < 0 or ends.max() >= stars or np.any(ends[0] == ends[1])):
        raise CorruptData("a pair names a star that is not in the list", expected=f"0 to {stars - 1}, two different")
    step = np.diff(distances.distance_rad)
    if not (np.all(np.isfinite(distances.distance_rad)) and np.all(step >= 0)):
        raise CorruptData("the distance table is not sorted", expected="ascending, finite distances")


def _worst(norm: NDArray[np.floating]) -> int:
    return int(np.argmax(np.abs(np.nan_to_num(norm, nan=np.inf) - 1)))
