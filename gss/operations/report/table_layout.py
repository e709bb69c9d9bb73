"""Column widths of a printed table, and its cells wrapped at words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

GAP = 9.0
"""Points between two columns."""
SIZES = (8.0, 7.2, 6.4, 5.6, 4.8)
"""Letter sizes in points; the largest is used at which no word is wider than its column."""

Measure = Callable[[str, float], float]
"""Width in points of a text at a letter size."""


@dataclass(frozen=True)
class TableLayout:
    """``size``: of the letters; ``widths``: of the columns with the gap; ``rows``: the lines of each cell."""

    size: float
    widths: list[float]
    rows: list[list[list[str]]]


def table_layout(rows: Sequence[Sequence[str]], across: float, measure: Measure) -> TableLayout:
    """Lay out rows of equal length in the width. Columns that are wider than their share are wrapped."""
    for size in SIZES:
        longest = [max(measure(r[k], size) for r in rows) + GAP for k in range(len(rows[0]))]
        word = [max(measure(w, size) for r in rows for w in (r[k].split() or [""])) + GAP for k in range(len(rows[0]))]
        if sum(word) <= across:
            break
    else:
        shrink = across / sum(word)
        word = [w * shrink for w in word]
    widths = _shared(longest, word, across)
    wrapped = [
        [_wrapped(cell, width - GAP, size, measure) for cell, width in zip(row, widths, strict=True)] for row in rows
    ]
    return TableLayout(size, widths, wrapped)


def _shared(longest: Sequence[float], word: Sequence[float], across: float) -> list[float]:
    """Give narrow columns what they need and divide the rest evenly among the wide ones."""
    if sum(longest) <= across:
        return list(longest)
    widths = list(word)
    open_columns = list(range(len(longest)))
    while open_columns:
        share = (across - sum(widths[k] for k in range(len(widths)) if k not in open_columns)) / len(open_columns)
        settled = [k for k in open_columns if longest[k] <= share or word[k] >= share]
        if not settled:
            for k in open_columns:
                widths[k] = share
            break
        # Columns that need more than a share are settled first, because they leave less for the others.
        large = [k for k in settled if word[k] >= share]
        for k in large or settled:
            widths[k] = word[k] if large else longest[k]
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
