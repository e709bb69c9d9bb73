"""Checksums by name: every CRC of the CRC RevEng catalogue (library ``anycrc``), and XXH32."""

from __future__ import annotations

import re
from collections.abc import Callable

import anycrc
import xxhash

from gss.domain.errors import BadInput

XXH32 = "XXH32"
CRC_NAME = re.compile(r"CRC-(\d+)(?:/([A-Z0-9-]+))?")
Calculate = Callable[[bytes], int]


def checksum_named(name: str, seed: int = 0) -> tuple[Calculate, int]:
    """Return the function that computes a checksum, and the checksum's size in bytes. ``seed`` is used only for XXH32.
    Raises BadInput if the name is unknown or the width is not a multiple of 8 bits."""
    algorithm = name.upper()
    if algorithm == XXH32:
        return lambda data: int(xxhash.xxh32_intdigest(data, seed)), 4
    match = CRC_NAME.fullmatch(algorithm)
    if match is None or seed:
        raise BadInput("unknown checksum", expected="a name like CRC-16/MCRF4XX, or XXH32 with a seed", got=name)
    width = int(match[1])
    try:
        model = anycrc.Model(algorithm.replace("CRC-", "CRC", 1).replace("/", "-", 1))
    except (KeyError, ValueError, TypeError) as error:
        raise BadInput("unknown checksum", expected="a name of the CRC RevEng catalogue", got=name) from error
    if width % 8:
        raise BadInput("the checksum does not fill whole bytes", expected="CRC-8, -16, -24, -32, -40 or -64", got=name)
    return lambda data: int(model.calc(data)), width // 8
