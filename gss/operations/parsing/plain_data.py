"""Serialization of a child process's results: JSON and separate arrays. Unlike a pickle, it cannot refer to code.

Supported types: None, booleans, numbers, text, bytes, arrays of plain numbers, times, tuples, lists, dictionaries, and
dataclasses that the reader permits by name.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from itertools import pairwise
from typing import Any

import numpy as np

from gss.domain.errors import CorruptData

ALIGN_BYTES = 16
ARRAY, BYTES, TUPLE, TIME, OBJECT, MAP, TEXTS = "array", "bytes", "tuple", "time", "object", "map", "texts"
DTYPES = {np.dtype(code).str for code in "?bBhHiIqQefd"}


def encode(value: object) -> tuple[bytes, list[memoryview]]:
    """Return JSON text and the buffers that follow it, each aligned to a multiple of ``ALIGN_BYTES``. Raises TypeError for an
    unsupported type."""
    buffers: list[memoryview] = []
    return json.dumps(_plain(value, buffers, [0])).encode(), buffers


def decode(text: bytes, body: bytearray, classes: Mapping[str, type]) -> Any:
    """Return the value that :func:`encode` encoded. Arrays are views of ``body``. Raises CorruptData if the text or a byte range
    is not valid."""
    try:
        return _value(json.loads(text), memoryview(body), classes)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise CorruptData(
            "the result of the file parser cannot be read",
            expected="plain data",
            got=f"{type(error).__name__}: {error}",
        ) from None


def padding(size: int) -> int:
    """Return the number of bytes to add after ``size`` to align the next buffer."""
    return -size % ALIGN_BYTES


def _plain(value: object, buffers: list[memoryview], end: list[int]) -> Any:
    def keep(data: memoryview) -> list[int]:
        start = end[0]
        buffers.append(data)
        end[0] = start + data.nbytes + padding(data.nbytes)
        return [start, data.nbytes]

    def inner(part: object) -> Any:
        return _plain(part, buffers, end)

    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value, value.dtype.newbyteorder("="))
        if array.dtype.str not in DTYPES:
            raise TypeError(f"an array of {array.dtype} is not plain data")
        return [ARRAY, array.dtype.str, list(value.shape), *keep(array.reshape(-1).view(np.uint8).data)]
    if isinstance(value, bytes | bytearray):
        return [BYTES, *keep(memoryview(value))]
    if isinstance(value, datetime):
        return [TIME, value.isoformat()]
    if isinstance(value, tuple | list):
        return [TUPLE, isinstance(value, tuple), [inner(part) for part in value]]
    if isinstance(value, dict):
        if value and all(isinstance(k, int) and isinstance(v, str) for k, v in value.items()):
            return [TEXTS, *_texts(value, inner)]
        return [MAP, [[inner(k), inner(v)] for k, v in value.items()]]
    if is_dataclass(value) and not isinstance(value, type):
        return [OBJECT, type(value).__name__, {f.name: inner(getattr(value, f.name)) for f in fields(value) if f.init}]
    raise TypeError(f"{type(value).__name__} is not plain data")


def _texts(value: Mapping[int, str], inner: Any) -> list[Any]:
    """Encode a mapping of numbers to texts as three arrays. Converting millions of texts to JSON would block the
    interpreter for seconds."""
    parts = [text.encode("utf-8", "replace") for text in value.values()]
    lengths = np.array([len(part) for part in parts], np.int64)
    return [inner(np.array(list(value), np.int64)), inner(lengths), inner(b"".join(parts))]


def _value(tree: Any, body: memoryview, classes: Mapping[str, type]) -> Any:
    if not isinstance(tree, list):
        return tree

    def inner(part: Any) -> Any:
        return _value(part, body, classes)

    kind, *arguments = tree
    if kind == ARRAY:
        dtype, shape, start, size = arguments
        if dtype not in DTYPES or math.prod(shape) * np.dtype(dtype).itemsize != size or min(shape, default=0) < 0:
            raise ValueError(f"an array of {dtype} {shape} in {size} bytes")
        if not size:
            return np.empty(shape, dtype)
        return np.frombuffer(_range(body, start, size), dtype).reshape(shape)
    if kind == BYTES:
        return bytes(_range(body, *arguments))
    if kind == TIME:
        return datetime.fromisoformat(arguments[0])
    if kind == TUPLE:
        parts = [inner(part) for part in arguments[1]]
        return tuple(parts) if arguments[0] else parts
    if kind == MAP:
        return {inner(k): inner(v) for k, v in arguments[0]}
    if kind == TEXTS:
        keys, lengths, text = (inner(part) for part in arguments)
        ends = [0, *np.cumsum(lengths).tolist()]
        return {k: text[a:b].decode() for k, (a, b) in zip(keys.tolist(), pairwise(ends), strict=True)}
    return classes[arguments[0]](**{name: inner(part) for name, part in arguments[1].items()})


def _range(body: memoryview, start: int, size: int) -> memoryview:
    if not (start >= 0 and size >= 0 and start + size <= len(body)):
        raise ValueError(f"bytes {start} to {start + size} of {len(body)}")
    return body[start : start + size]
