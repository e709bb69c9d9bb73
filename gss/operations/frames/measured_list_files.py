"""Lists of measured stars from a file. Without the solver, because a child process that reads one file imports this module."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from tokenize import TokenError

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.results import Centroids

ARRAYS = ("col_px", "row_px", "flux", "first")
COLUMNS = ("list", "col_px", "row_px", "flux")
UNREADABLE = (
    *(zipfile.BadZipFile, zlib.error, ValueError, OSError, EOFError, KeyError),
    *(NotImplementedError, RuntimeError, SyntaxError, TypeError, TokenError),
)
"""Errors of zipfile and numpy for a damaged file. numpy reads the header of an array as Python source."""
EXPECTED = f"an .npz with the arrays {', '.join(ARRAYS)}, or a .csv with the columns {', '.join(COLUMNS)}"
MAX_LIST_BYTES = 256 << 20
MAX_LISTS, MAX_STARS = 2_000_000, 8_000_000
MAX_STARS_PER_LIST = 20_000
MAX_PX = 1e6


@dataclass(frozen=True)
class StarLists:
    """Stars of several lists. ``col_px``, ``row_px``: (n,) positions in pixels (pixel centres at integers). ``flux``: (n,) in any
    unit. List k contains the stars ``first[k]`` to ``first[k + 1] - 1``. The last offset in ``first`` is n."""

    col_px: Array
    row_px: Array
    flux: Array
    first: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.first) - 1

    def centroids(self, index: int, sigma_px: float) -> Centroids:
        """Return the stars of one list, brightest first."""
        part = slice(int(self.first[index]), int(self.first[index + 1]))
        order = np.argsort(-self.flux[part], kind="stable")
        pixels = np.column_stack([self.col_px[part], self.row_px[part]])[order]
        return Centroids.from_pixels(pixels, self.flux[part][order], sigma_px)


def read_star_lists(data: bytes, name: str) -> StarLists:
    """Read the lists in an .npz or .csv file. ``name``: name of the file in messages. Raises BadInput."""
    if not data:
        raise BadInput(f"{name} is empty", expected=EXPECTED, got="0 bytes")
    lists = _read_npz(data, name) if data[:4] == b"PK\x03\x04" else _read_csv(data, name)
    _check(lists, name)
    return lists


def _read_npz(data: bytes, name: str) -> StarLists:
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            if unpacked > MAX_LIST_BYTES:
                limit = f"at most {MAX_LIST_BYTES >> 20} MiB"
                raise BadInput(f"{name} is too large when it is unpacked", expected=limit, got=f"{unpacked >> 20} MiB")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            missing = [a for a in ARRAYS if a not in file.files]
            if missing:
                got = ", ".join(file.files)[:200] or "no arrays"
                raise BadInput(f"{name} has no array {', '.join(missing)}", expected=EXPECTED, got=got)
            arrays = {a: np.asarray(file[a]) for a in ARRAYS}
    except UNREADABLE as error:
        raise BadInput(f"{name} cannot be read", expected=EXPECTED, got=str(error)[:200]) from None
    for array_name, array in arrays.items():
        kinds = "iu" if array_name == "first" else "iuf"
        if array.ndim != 1 or array.dtype.kind not in kinds:
            kind = "integers" if array_name == "first" else "numbers"
            got = f"shape {array.shape}, type {array.dtype}"
            raise BadInput(
                f"the array {array_name} in {name} is of the wrong kind", expected=f"one row of {kind}", got=got
            )
    col, row, flux = (arrays[a].astype(float) for a in ARRAYS[:3])
    return StarLists(col, row, flux, arrays["first"].astype(np.int64))


def _read_csv(data: bytes, name: str) -> StarLists:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise BadInput(f"{name} is neither .npz nor text", expected=EXPECTED, got=data[:12].hex(" ")) from None
    head, _, body = text.partition("\n")
    names = [part.strip() for part in head.split(",")]
    if sorted(names) != sorted(COLUMNS):
        raise BadInput(f"the first line of {name} does not name the columns", expected=EXPECTED, got=head.strip()[:200])
    table = _csv_numbers(body, name)
    number, col, row, flux = (table[:, names.index(column)] for column in COLUMNS)
    is_valid = np.isfinite(number) & (number == np.floor(number)) & (number >= 0) & (number < MAX_LISTS)
    if not is_valid.all():
        bad = int(np.flatnonzero(~is_valid)[0])
        expected = f"the number of the list, an integer from 0 to {MAX_LISTS - 1}"
        raise BadInput(f"line {_line_of(body, bad)} of {name} has no list", expected=expected, got=f"{number[bad]:g}")
    invalid = _first_invalid(col, row, flux)
    if invalid is not None:
        line = _line_of(body, invalid.star)
        raise BadInput(
            f"the value of {invalid.column} in line {line} of {name} is invalid",
            expected=invalid.expected,
            got=f"{invalid.value:g}",
        )
    order = np.argsort(number, kind="stable")
    count = np.bincount(number.astype(np.int64)) if len(number) else np.zeros(0, np.int64)
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    return StarLists(col[order], row[order], flux[order], first)


def _csv_numbers(body: str, name: str) -> Array:
    """Return the (n, 4) numbers below the first line. Raises BadInput that names the first line without four numbers."""
    if not body.strip():
        return np.zeros((0, len(COLUMNS)))
    try:
        table = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2)
        if table.shape[1] == len(COLUMNS):
            return table
    except ValueError:
        pass
    for row, (line, text) in enumerate(_data_lines(body)):
        try:
            values = len(np.array(text.split(","), float))
        except ValueError:
            values = -1
        if values != len(COLUMNS):
            got = f"{text.strip()[:100]!r}, data row {row + 1}"
            raise BadInput(f"line {line} of {name} does not have four numbers", expected=EXPECTED, got=got)
    raise BadInput(f"{name} cannot be read as numbers", expected=EXPECTED)


def _data_lines(body: str) -> Iterator[tuple[int, str]]:
    """Yield the line number and text of each line with data. The line above ``body`` is line 1."""
    for line, text in enumerate(body.splitlines(), start=2):
        text = text.partition("#")[0]
        if text.strip():
            yield line, text


def _line_of(body: str, row: int) -> int:
    """Return the line number of a data row."""
    return next(islice(_data_lines(body), row, None))[0]


@dataclass(frozen=True)
class _InvalidValue:
    """The first value outside its range. ``star``: index of the star."""

    column: str
    star: int
    value: float
    expected: str


def _first_invalid(col_px: Array, row_px: Array, flux: Array) -> _InvalidValue | None:
    for column, values, low in (("col_px", col_px, -MAX_PX), ("row_px", row_px, -MAX_PX), ("flux", flux, 0.0)):
        high = MAX_PX if column != "flux" else np.finfo(float).max
        bad = np.flatnonzero(~((values >= low) & (values <= high)))
        if len(bad):
            star = int(bad[0])
            expected = "0 or more" if column == "flux" else f"a position in pixels, within ±{MAX_PX:g}"
            return _InvalidValue(column, star, float(values[star]), expected)
    return None


def _check(lists: StarLists, name: str) -> None:
    n, first = len(lists.col_px), lists.first
    if not len(lists.row_px) == len(lists.flux) == n:
        got = f"{n}, {len(lists.row_px)} and {len(lists.flux)}"
        raise BadInput(
            f"col_px, row_px and flux in {name} differ in length", expected="one value each per star", got=got
        )
    if n > MAX_STARS or len(first) - 1 > MAX_LISTS:
        got = f"{n} stars in {len(first) - 1} lists"
        raise BadInput(f"{name} is too long", expected=f"at most {MAX_STARS} stars in {MAX_LISTS} lists", got=got)
    if len(first) < 2:
        raise BadInput(
            f"{name} has no list", expected="an offset for each list in first, followed by the number of stars"
        )
    if first[0] != 0 or first[-1] != n or (np.diff(first) < 0).any():
        got = f"{first[0]} to {first[-1]} for {n} stars"
        expected = "ascending offsets that begin with 0 and end with the number of stars"
        raise BadInput(f"the array first in {name} does not divide the stars", expected=expected, got=got)
    longest = int(np.diff(first).max())
    if longest > MAX_STARS_PER_LIST:
        expected = f"at most {MAX_STARS_PER_LIST} stars in a list"
        raise BadInput(f"a list in {name} is too long", expected=expected, got=str(longest))
    invalid = _first_invalid(lists.col_px, lists.row_px, lists.flux)
    if invalid is not None:
        index = int(np.searchsorted(first, invalid.star, side="right")) - 1
        raise BadInput(
            f"the value of {invalid.column} of star {invalid.star - first[index]} in list {index} of {name} is invalid",
            expected=invalid.expected,
            got=f"{invalid.value:g}",
        )
