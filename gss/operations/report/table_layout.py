"""Layout of a printed table: column widths, and cells wrapped at words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

GAP = 9.0
"""Points between two columns."""
SIZES = (8.0, 7.2, 6.4, 5.6, 4.8)
"""Letter sizes in points. The layout uses the largest size at which every word fits into its column."""

Measure = Callable[[str, float], float]
"""Function that returns the width in points of a text at a letter size."""


@dataclass(frozen=True)
class TableLayout:
    """Layout of a table. ``size``: letter size; ``widths``: column widths with the gap, both in points; ``rows``: lines
    of text of each cell."""

    size: float
    widths: list[float]
    rows: list[list[list[str]]]


def table_layout(rows: Sequence[Sequence[str]], across: float, measure: Measure) -> TableLayout:
    """Lay out rows with equal numbers of cells in a width of ``across`` points. Cells of columns that are wider than
    their share are wrapped."""
    for size in SIZES:
        full_widths = [max(measure(r[k], size) for r in rows) + GAP for k in range(len(rows[0]))]
        word_widths = [
            max(measure(w, size) for r in rows for w in (r[k].split() or [""])) + GAP for k in range(len(rows[0]))
        ]
        if sum(word_widths) <= across:
            break
    else:
        shrink = across / sum(word_widths)
        word_widths = [w * shrink for w in word_widths]
    widths = _shared(full_widths, word_widths, across)
    wrapped = [
        [_wrapped(cell, width - GAP, size, measure) for cell, width in zip(row, widths, strict=True)] for row in rows
    ]
    return TableLayout(size, widths, wrapped)


def _shared(full_widths: Sequence[float], word_widths: Sequence[float], across: float) -> list[float]:
    """Return the column widths. Narrow columns get their full width; wide columns share the remaining width equally."""
    if sum(full_widths) <= across:
        return list(full_widths)
    widths = list(word_widths)
    open_columns = list(range(len(full_widths)))
    while open_columns:
        share = (across - sum(widths[k] for k in range(len(widths)) if k not in open_columns)) / len(open_columns)
        settled = [k for k in open_columns if full_widths[k] <= share or word_widths[k] >= share]
        if not settled:
            for k in open_columns:
                widths[k] = share
            break
        # Columns that need more than an equal share for their longest word are set first, because they reduce the share
        # of the other columns.
        large = [k for k in settled if word_widths[k] >= share]
        for k in large or settled:
            widths[k] = word_widths[k] if large else full_widths[k]
            open_columns.remove(k)
    return widths


def _wrapped(text: str, width: float, size: float, measure: Measure) -> list[str]:
    if measure(text, size) <= width:
        return [text]
    lines: list[str] = []
    line = ""
    for word in text.split():
        longer = f"{line} {word}".strip()
        if line and measure(longer, size) > width:
            lines.append(line)
            line = word
        else:
            line = longer
    return [*lines, line] if line else lines
