"""Compiled loops over all pixels of a frame: filter, lit pixels, and their connected components. Each is equivalent to the
numpy function that its docstring names; a test compares the results."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.pipeline.loops import loop
from gss.pipeline.small import Rows

BLOCK = 256


def binomial(image: NDArray[Any]) -> NDArray[Any]:
    """Apply the binomial filter; equivalent to ``peaks._binomial_sum``."""
    kind = np.uint16 if image.dtype == np.uint8 else np.float32
    out = np.empty(image.shape, kind)
    if kind is np.uint16:
        _binomial_integer(image, out)
    else:
        _binomial_float(np.ascontiguousarray(image, np.float32), out)
    return out


@loop
def _binomial_integer(image, out):
    rows, cols = image.shape
    line = np.empty(cols + 4, np.uint16)
    for r in range(rows):
        a, b = max(r - 2, 0), max(r - 1, 0)
        d, e = min(r + 1, rows - 1), min(r + 2, rows - 1)
        for c in range(cols):
            line[c + 2] = (
                np.uint16(image[a, c])
                + np.uint16(image[e, c])
                + np.uint16(4) * (np.uint16(image[b, c]) + np.uint16(image[d, c]))
                + np.uint16(6) * np.uint16(image[r, c])
            )
        line[0] = line[1] = line[2]
        line[cols + 2] = line[cols + 3] = line[cols + 1]
        for c in range(cols):
            out[r, c] = line[c] + line[c + 4] + np.uint16(4) * (line[c + 1] + line[c + 3]) + np.uint16(6) * line[c + 2]


@loop
def _binomial_float(image, out):
    """Add in the same order as the numpy version: pairs of neighbours, four times along rows, then four times along columns."""
    rows, cols = image.shape
    across = np.empty((rows, cols), np.float32)
    line = np.empty(cols + 4, np.float32)
    for r in range(rows):
        for c in range(cols):
            line[c + 2] = image[r, c]
        line[0] = line[1] = line[2]
        line[cols + 2] = line[cols + 3] = line[cols + 1]
        for k in range(3):
            for c in range(cols + 3 - k):
                line[c] = line[c] + line[c + 1]
        for c in range(cols):
            across[r, c] = line[c] + line[c + 1]
    for r in range(rows):
        a, b = max(r - 2, 0), max(r - 1, 0)
        d, e = min(r + 1, rows - 1), min(r + 2, rows - 1)
        for c in range(cols):
            v0, v1, v2, v3, v4 = across[a, c], across[b, c], across[r, c], across[d, c], across[e, c]
            w0, w1, w2, w3 = v0 + v1, v1 + v2, v2 + v3, v3 + v4
            x0, x1, x2 = w0 + w1, w1 + w2, w2 + w3
            out[r, c] = (x0 + x1) + (x1 + x2)


def lit(image: NDArray[Any], threshold: float) -> Rows:
    """Return the flat indices of the pixels above a threshold, ascending; equivalent to ``numpy.flatnonzero``."""
    if image.dtype.kind == "u":
        limit = math.floor(threshold)
        top = int(np.iinfo(image.dtype).max)
        if limit >= top:
            return np.empty(0, np.intp)
        if limit < 0:
            return np.arange(image.size)
        limit_value = np.full(1, limit, image.dtype)
        flat = np.ascontiguousarray(image).ravel().view()
        flat.flags.writeable = False  # otherwise the loop would be compiled again for a frame that is read-only
        rows: Rows = _lit(flat, limit_value[0])
        return rows
    return np.flatnonzero(image > threshold)


@loop
def _lit(flat, limit):
    size = len(flat)
    out = np.empty(1024, np.intp)
    n = 0
    for first in range(0, size, BLOCK):
        last = min(first + BLOCK, size)
        any_above = False
        for value in flat[first:last]:
            any_above |= value > limit
        if not any_above:
            continue
        for c in range(first, last):
            if flat[c] > limit:
                if n == len(out):
                    larger = np.empty(2 * n, np.intp)
                    larger[:n] = out
                    out = larger
                out[n] = c
                n += 1
    return out[:n]


def components(lit: Rows, columns: int) -> tuple[int, NDArray[np.int32]]:
    """Label the 4-connected components of lit pixels, numbered by their first pixel; equivalent to ``regions._label``."""
    label = np.empty(len(lit), np.int32)
    return int(_components(lit, columns, label)), label


@loop
def _components(lit, columns, label):
    n = len(lit)
    parent = np.arange(n)
    up = 0
    for i in range(n):
        if i > 0 and lit[i] - lit[i - 1] == 1 and lit[i] % columns != 0:
            _join(parent, i, i - 1)
        while up < i and lit[up] < lit[i] - columns:
            up += 1
        if up < i and lit[up] == lit[i] - columns:
            _join(parent, i, up)
    count = 0
    for i in range(n):
        root = _root(parent, i)
        if root == i:
            label[i] = count
            count += 1
        else:
            label[i] = label[root]
    return count


@loop
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@loop
def _join(parent, i, j):
    """Merge two components. The earlier root stays, because components are numbered by their first pixel."""
    a, b = _root(parent, i), _root(parent, j)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
