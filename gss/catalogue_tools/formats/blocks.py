"""Body of an image as a sequence of blocks: arrays of one type each, in the order of their bytes.

C source, table files and the documented byte tables are all generated from this description.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

AnyArray = NDArray[Any]
Columns = dict[str, AnyArray]
NUMBER_TYPE = re.compile(r"[<|](?:[ui][124]|f[48])")
MAX_CONSECUTIVE = 64


@dataclass(frozen=True)
class BlockField:
    """Description of one number of a star or a pair. ``type``: numpy type name. ``unit``: "" if there is none."""

    name: str
    type: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class Block:
    """``count`` consecutive values of ``dtype``.

    ``name``: name of a scalar column; the columns of records have the names in the dtype. ``bits``: if set, the bytes
    contain whole numbers of these widths, lowest first, and ``name`` contains their names, separated by spaces.
    """

    table: str
    dtype: np.dtype[Any]
    count: int
    name: str = ""
    bits: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Size in bytes."""
        return self.dtype.itemsize * self.count


@dataclass(frozen=True)
class Rows:
    """Storage of one table in a format: consecutive records, consecutive columns, or bits packed into bytes."""

    table: str
    fields: tuple[BlockField, ...]
    records: bool = False
    bits: tuple[int, ...] = ()

    @property
    def row_bytes(self) -> int:
        """Bytes per row."""
        if self.bits:
            return -(-sum(self.bits) // 8)
        return sum(np.dtype(f.type).itemsize for f in self.fields)

    def blocks(self, count: int) -> tuple[Block, ...]:
        """Blocks of ``count`` rows."""
        if self.bits:
            names = " ".join(f.name for f in self.fields)
            return (Block(self.table, np.dtype(("u1", (self.row_bytes,))), count, names, self.bits),)
        if self.records:
            return (Block(self.table, np.dtype([(f.name, f.type) for f in self.fields]), count),)
        return tuple(Block(self.table, np.dtype(f.type), count, f.name) for f in self.fields)


def dtype_of(described: object, shape: Sequence[object]) -> np.dtype[Any]:
    """Return the type described by a file's layout: a number, a short array of numbers, or a record.

    Raises ValueError for any other description, because an untrusted file must not use the full syntax of numpy's type
    descriptions.
    """
    if isinstance(described, str) and NUMBER_TYPE.fullmatch(described):
        sizes = [n for n in shape if type(n) is int and 0 < n <= MAX_CONSECUTIVE]
        if len(sizes) == len(shape) <= 1:
            return np.dtype((described, tuple(sizes)))
    elif isinstance(described, list) and 0 < len(described) <= MAX_CONSECUTIVE:
        pairs = [(str(name), dtype_of(kind, ()).str) for name, kind in described]
        if all(name.isidentifier() for name, _ in pairs):
            return np.dtype(pairs)
    raise ValueError(f"a type {str(described)[:60]!r} of shape {str(shape)[:60]}")


def to_bytes(blocks: Sequence[Block], columns: Columns) -> bytes:
    """Encode columns by name."""
    return b"".join(_block_bytes(block, columns) for block in blocks)


def _block_bytes(block: Block, columns: Columns) -> bytes:
    if block.bits:
        return pack_bits([columns[name] for name in block.name.split()], block.bits).tobytes()
    if block.dtype.names is None:
        return np.asarray(columns[block.name]).astype(block.dtype).tobytes()
    rows = np.empty(block.count, block.dtype)
    for name in block.dtype.names:
        rows[name] = columns[name]
    return rows.tobytes()


def to_columns(blocks: Sequence[Block], data: bytes | memoryview) -> Columns:
    """Decode columns by name. ``data`` must be at least as long as the blocks."""
    columns: Columns = {}
    at = 0
    for block in blocks:
        columns |= block_columns(block, bytes(data[at : at + block.size]))
        at += block.size
    return columns


def block_columns(block: Block, data: bytes) -> Columns:
    """Decode the columns of one block."""
    if block.bits:
        packed = np.frombuffer(data, np.uint8).reshape(block.count, block.dtype.itemsize)
        return dict(zip(block.name.split(), unpack_bits(packed, block.bits), strict=True))
    rows = np.frombuffer(data, block.dtype, block.count)
    if block.dtype.names is None:
        return {block.name: rows}
    return {name: rows[name] for name in block.dtype.names}


def pack_bits(values: Sequence[AnyArray], bits: Sequence[int]) -> NDArray[np.uint8]:
    """Pack whole numbers of the stated widths into (n, bytes) little-endian words, the first number in the lowest bits.
    Spare bits are zero."""
    word = np.zeros(len(values[0]), np.uint64)
    shift = 0
    for value, width in zip(values, bits, strict=True):
        word |= np.asarray(value).astype(np.uint64) << np.uint64(shift)
        shift += width
    return np.ascontiguousarray(word.astype("<u8").view(np.uint8).reshape(-1, 8)[:, : -(-shift // 8)])


def unpack_bits(packed: NDArray[np.uint8], bits: Sequence[int]) -> list[AnyArray]:
    """Unpack the numbers of (n, bytes) words as u16."""
    padded = np.zeros((len(packed), 8), np.uint8)
    padded[:, : packed.shape[1]] = packed
    word = padded.view("<u8")[:, 0]
    values, shift = [], 0
    for width in bits:
        values.append(((word >> np.uint64(shift)) & np.uint64((1 << width) - 1)).astype(np.uint16))
        shift += width
    return values


def raw(data_or_size: int, name: str = "") -> Block:
    """Return a block of bytes that do not belong to a table."""
    return Block("raw", np.dtype("u1"), data_or_size, name)


def padding(size: int, to: int = 4) -> int:
    """Return the number of zero bytes up to the next multiple of ``to``."""
    return -size % to


u32 = struct.Struct("<I")
