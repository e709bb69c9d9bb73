"""Convert a bank image to C source and back. The source contains constant arrays for firmware, as in CubeStar (Erlank
2013 §5.3.2).

Each block of the image becomes one array: of numbers for a column, of structures without padding for records, of bytes
for bit-packed entries. The arrays have the order of the blocks, so on a little-endian processor the concatenated
compiled arrays are identical to the image. Decimal numbers have enough digits to restore single (9) or double (17)
precision exactly.
"""

from __future__ import annotations

import json
import re

import numpy as np

from gss.catalogue_tools.formats.blocks import AnyArray, Block, dtype_of
from gss.catalogue_tools.formats.registry import blocks_of, decode, read_header
from gss.domain.errors import BadInput, CorruptData

C_TYPES = {
    "u1": "uint8_t",
    "i1": "int8_t",
    "u2": "uint16_t",
    "i2": "int16_t",
    "u4": "uint32_t",
    "i4": "int32_t",
    "f4": "float",
    "f8": "double",
}
PREFIX = "gss_"
LAYOUT = re.compile(r"^ \* gss-layout: (.*)$", re.MULTILINE)
ARRAY = re.compile(r"const \w+ (gss_\w+)(?:\[\d+\])+ = \{(.*?)\};", re.DOTALL)
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
NUMBER = re.compile(r"NAN|[-+]?\d[\d.]*(?:[eE][-+]?\d+)?")
PER_LINE = 8


def c_source(image: bytes) -> str:
    """Check a bank image and return its C source."""
    decode(image)
    header, parts = read_header(image), [p for p in blocks_of(image) if p[0].size]
    layout = json.dumps([_described(block) for block, _ in parts], separators=(",", ":"))
    lines = [
        f"/* Star catalogue in the {header.format_name} format for {header.profile_name}: {header.stars} stars, "
        f"{header.pairs} pairs, epoch J{header.epoch_jyear:g}.",
        " * Written by gss. The arrays in this order, little-endian and without padding, form the bank image.",
        f" * gss-layout: {layout}",
        " */",
        "#include <math.h>",
        "#include <stdint.h>",
        "",
        f"#define GSS_STARS {header.stars}u",
        f"#define GSS_PAIRS {header.pairs}u",
        f"#define GSS_BODY_CRC32 0x{header.body_crc32:08x}u",
        "",
    ]
    for block, data in parts:
        lines += _array(block, data)
    return "\n".join(lines) + "\n"


def identifier(block: Block) -> str:
    """Name of a block's array."""
    block_name = "" if block.dtype.names or block.bits else block.name
    return PREFIX + "_".join(word for word in (block.table.removeprefix("raw"), block_name) if word)


def _described(block: Block) -> list[object]:
    dtype = block.dtype.descr if block.dtype.names else block.dtype.base.str
    return [identifier(block), dtype, list(block.dtype.shape), block.count]


def _array(block: Block, data: bytes) -> list[str]:
    rows, name = np.frombuffer(data, block.dtype, block.count), identifier(block)
    if block.dtype.names:
        kind = f"{name}_row"
        members = " ".join(f"{_c_type(block.dtype[n])} {n};" for n in block.dtype.names)
        texts = ["{" + ", ".join(_text(row[n]) for n in block.dtype.names) + "}" for row in rows]
        return [
            f"typedef struct {{ {members} }} {kind};",
            f"const {kind} {name}[{block.count}] = {{",
            *_wrapped(texts, 3),
        ]
    if block.dtype.shape:
        texts = ["{" + ", ".join(map(str, row)) + "}" for row in rows.tolist()]
        return [f"const uint8_t {name}[{block.count}][{block.dtype.shape[0]}] = {{", *_wrapped(texts, 5)]
    texts = [_text(value) for value in rows]
    return [f"const {_c_type(block.dtype)} {name}[{block.count}] = {{", *_wrapped(texts, PER_LINE)]


def _c_type(dtype: np.dtype) -> str:
    return C_TYPES[dtype.str[1:]]


def _text(value: np.generic) -> str:
    if value.dtype.kind != "f":
        return str(int(value))
    if np.isnan(value):
        return "NAN"
    single = value.dtype.itemsize == 4
    text = f"{float(value):.9g}" if single else f"{float(value):.17g}"
    if not any(mark in text for mark in ".e"):
        text += ".0"
    return text + ("f" if single else "")


def _wrapped(texts: list[str], per_line: int) -> list[str]:
    rows = ["  " + ", ".join(texts[k : k + per_line]) for k in range(0, len(texts), per_line)]
    return [",\n".join(rows), "};", ""]


def read_c_source(text: str) -> bytes:
    """Return the bank image that was converted by :func:`c_source`. The image is checked by :func:`decode`.

    Raises BadInput if the text is not such a source, and CorruptData if its layout line is damaged or a number is missing
    or was changed.
    """
    header = LAYOUT.search(text)
    if header is None:
        raise BadInput("not a catalogue in C source", expected="the gss-layout line of its first comment")
    arrays = dict(ARRAY.findall(COMMENT.sub("", text)))
    try:
        layout = [(str(n), dtype_of(d, shape), int(count)) for n, d, shape, count in json.loads(header[1])]
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise CorruptData("the layout line of the C source is damaged", expected="a list", got=str(error)) from None
    image = b"".join(_parsed(name, dtype, count, arrays.get(name)).tobytes() for name, dtype, count in layout)
    decode(image)
    return image


def _parsed(name: str, dtype: np.dtype, count: int, text: str | None) -> AnyArray:
    per_row = len(dtype.names) if dtype.names else int(np.prod(dtype.shape, dtype=int))
    numbers = NUMBER.findall(text or "")
    if text is None or len(numbers) != count * per_row:
        raise CorruptData(f"array {name} is incomplete", expected=f"{count * per_row} numbers", got=str(len(numbers)))
    try:
        if dtype.names:
            rows = np.empty(count, dtype)
            for k, column in enumerate(dtype.names):
                rows[column] = _values(numbers[k::per_row], dtype[column])
            return rows
        return _values(numbers, dtype.base)
    except (ValueError, OverflowError) as error:
        raise CorruptData(f"array {name} contains a value that is not a number of its type", got=str(error)) from None


def _values(numbers: list[str], dtype: np.dtype) -> AnyArray:
    if dtype.kind == "f":
        return np.array([np.nan if n == "NAN" else float(n) for n in numbers], dtype)
    return np.array([int(n) for n in numbers], dtype)
