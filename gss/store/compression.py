"""Lossless compression of stored bytes with zstd level 1. The bytes of multi-byte items are first separated into
planes.

Star frames are mostly noise, so the entropy of the noise limits their compressed size. For rendered frames of all
shipped cameras, zstd reaches 1.0 to 1.2 times the entropy of single pixels, and takes 1 to 3 ms per 512 KiB.
Compression of differences between neighbouring pixels adds half a bit of noise to every pixel and gave larger files for
every frame; zlib takes 5 to 8 ms.
"""

from __future__ import annotations

import struct

import numpy as np
import zstandard

MAGIC = b"GSSPACK1"
_HEADER = struct.Struct("<8sBQ")
"""Magic, bytes of an item, bytes before compression."""
LEVEL = 1
MIN_BYTES = 512
"""Shorter content is stored without compression."""
MAX_RATIO = 0.95
"""Maximum ratio of compressed to plain size at which the compressed form is stored."""
MAX_UNPACKED_BYTES = 1 << 32
MAX_ITEM_BYTES = 16


def compressed(data: bytes | memoryview, item_bytes: int = 1) -> bytes | None:
    """Return the compressed form, or None if it is not clearly smaller. ``item_bytes``: size of a number in ``data``.
    Content that starts with ``MAGIC`` is always compressed. Otherwise it would be read as compressed content."""
    size = len(data)
    starts_with_magic = bytes(data[: len(MAGIC)]) == MAGIC
    if size < MIN_BYTES and not starts_with_magic:
        return None
    if 1 < item_bytes <= MAX_ITEM_BYTES and size % item_bytes == 0:
        planes: bytes | memoryview = byte_planes(data, item_bytes)
    else:
        item_bytes, planes = 1, data
    packed = zstd(planes)
    return (
        _HEADER.pack(MAGIC, item_bytes, size) + packed if starts_with_magic or len(packed) < MAX_RATIO * size else None
    )


def decompressed(data: bytes) -> bytes | None:
    """Return the plain bytes of a compressed form; None if ``data`` is plain or damaged. The hash distinguishes these
    cases."""
    if len(data) < _HEADER.size or not data.startswith(MAGIC):
        return None
    _, item_bytes, size = _HEADER.unpack_from(data)
    if not 1 <= item_bytes <= MAX_ITEM_BYTES or size > MAX_UNPACKED_BYTES or size % item_bytes:
        return None
    try:
        plain = zstd_plain(memoryview(data)[_HEADER.size :], size)
        if plain is None or item_bytes == 1:
            return plain
        return items_of_planes(plain, item_bytes)
    except MemoryError:  # a damaged header states a huge size
        return None


def byte_planes(data: bytes | memoryview, item_bytes: int) -> bytes:
    """Return all first bytes of the items, then all second bytes, and so on."""
    return np.frombuffer(data, np.uint8).reshape(-1, item_bytes).T.tobytes()


def items_of_planes(planes: bytes, item_bytes: int) -> bytes:
    """Return the bytes of the items; inverse of :func:`byte_planes`."""
    return np.frombuffer(planes, np.uint8).reshape(item_bytes, -1).T.tobytes()


def zstd(data: bytes | memoryview) -> bytes:
    """Return one zstd frame."""
    return zstandard.ZstdCompressor(level=LEVEL).compress(data)


def zstd_plain(data: bytes | memoryview, size: int) -> bytes | None:
    """Return the ``size`` bytes of one zstd frame; None if it is damaged."""
    try:
        if zstandard.frame_content_size(data) not in (size, -1):  # -1: not given in the frame
            return None
        plain = zstandard.ZstdDecompressor().decompress(data, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError:
        return None
    return plain if len(plain) == size else None
