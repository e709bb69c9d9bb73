"""Contents of the sections that any format may have: k-vector, reduced catalogue, linked list of neighbours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.blocks import Block, to_bytes, to_columns
from gss.domain.errors import BadInput, CorruptData
from gss.skytables.bank import BankTables, ReducedCatalogue, ReducedFrame
from gss.skytables.kvector import KVector, k_vector
from gss.skytables.neighbours import NeighbourLinks

WIDE = 1 << 16
FRAME = [("width_rad", "<f4"), ("height_rad", "<f4"), ("step_rad", "<f4"), ("brightest", "<u4")]
LINE = [("start", "<f8"), ("step", "<f8")]

# --- k-vector: f64 start, f64 step, then one count per pair: u16 if the number of pairs fits, else u32 ---


def line_index(values: NDArray[np.floating]) -> KVector | None:
    """Return the k-vector of ascending values; None if there are fewer than two different values."""
    if len(values) < 2 or not values[-1] > values[0]:
        return None
    return k_vector(values)


def k_blocks(size: int, stars: int, pairs: int) -> tuple[Block, ...]:
    width = "<u2" if pairs < WIDE else "<u4"
    return Block("k_vector_line", np.dtype(LINE), 1), Block("k_vector", np.dtype(width), pairs, "k")


def write_k(tables: BankTables, stars: int, pairs: int) -> bytes | None:
    if tables.index is None:
        return None
    if len(tables.index.k) != pairs:
        raise BadInput("the k-vector belongs to another table", expected=f"{pairs} pairs", got=str(len(tables.index.k)))
    index = tables.index
    columns = {"k": index.k, "start": np.array([index.start]), "step": np.array([index.step])}
    return to_bytes(k_blocks(0, stars, pairs), columns)


def read_k(data: bytes, tables: BankTables, stars: int, pairs: int) -> BankTables:
    columns = to_columns(k_blocks(len(data), stars, pairs), data)
    return replace(
        tables, index=KVector(columns["k"].astype(np.int32), float(columns["start"][0]), float(columns["step"][0]))
    )


# --- reduced catalogue: its frame, then one bit per star, the first in the lowest bit of the first byte ---


def reduced_blocks(size: int, stars: int, pairs: int) -> tuple[Block, ...]:
    return Block("reduced_frame", np.dtype(FRAME), 1), Block("reduced", np.dtype("u1"), -(-stars // 8), "kept_bits")


def write_reduced(tables: BankTables, stars: int, pairs: int) -> bytes | None:
    if tables.reduced is None:
        return None
    rows, frame = tables.reduced.kept, tables.reduced.frame
    if len(rows) != stars:
        raise BadInput(
            "the reduced catalogue belongs to another star list", expected=f"{stars} stars", got=str(len(rows))
        )
    columns = {name: np.array([getattr(frame, name)]) for name, _ in FRAME}
    return to_bytes(reduced_blocks(0, stars, pairs), columns | {"kept_bits": np.packbits(rows, bitorder="little")})


def read_reduced(data: bytes, tables: BankTables, stars: int, pairs: int) -> BankTables:
    columns = to_columns(reduced_blocks(len(data), stars, pairs), data)
    bits = np.unpackbits(columns["kept_bits"], bitorder="little").astype(bool)
    if bits[stars:].any():
        raise CorruptData("the reduced catalogue names stars beyond the list", expected=f"{stars} stars")
    width, height, step = (float(columns[name][0]) for name in ("width_rad", "height_rad", "step_rad"))
    frame = ReducedFrame(width, height, int(columns["brightest"][0]), step)
    return replace(tables, reduced=ReducedCatalogue(bits[:stars], frame))


# --- linked list: u16 count and u16 pointer per star, then u16 neighbours ---


def link_blocks(size: int, stars: int, pairs: int) -> tuple[Block, ...]:
    columns = tuple(Block("links", np.dtype("<u2"), stars, name) for name in ("count", "pointer"))
    return (*columns, Block("neighbours", np.dtype("<u2"), max(0, size - 4 * stars) // 2, "neighbour"))


def write_links(tables: BankTables, stars: int, pairs: int) -> bytes | None:
    links = tables.links
    if links is None:
        return None
    if len(links) != stars:
        raise BadInput("the links belong to another star list", expected=f"{stars} stars", got=str(len(links)))
    if len(links.neighbour) >= WIDE or stars > WIDE:
        raise BadInput("too many links for 16 bits", expected=f"at most {WIDE - 1}", got=str(len(links.neighbour)))
    columns = {"count": np.diff(links.start), "pointer": links.start[:-1], "neighbour": links.neighbour}
    return to_bytes(link_blocks(4 * stars + 2 * len(links.neighbour), stars, pairs), columns)


def read_links(data: bytes, tables: BankTables, stars: int, pairs: int) -> BankTables:
    columns = to_columns(link_blocks(len(data), stars, pairs), data)
    count, pointer = columns["count"].astype(np.intp), columns["pointer"].astype(np.intp)
    near = columns["neighbour"].astype(np.intp)
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.intp)
    if start[-1] != len(near) or not np.array_equal(pointer, start[:-1]):
        raise CorruptData("the pointers of the linked list do not fit its counts", expected=f"{len(near)} neighbours")
    owner = np.repeat(np.arange(stars), count)
    forward, back = owner * stars + near, np.sort(near * stars + owner)
    if len(near) and (near.max() >= stars or np.any(forward[1:] <= forward[:-1]) or not np.array_equal(forward, back)):
        raise CorruptData("a link is stored at one end only", expected="every neighbour once at both stars, ascending")
    return replace(tables, links=NeighbourLinks(start, near))
