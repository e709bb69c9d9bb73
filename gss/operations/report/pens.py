"""The drawing interface (lines, boxes, dots and text) and its SVG implementation."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Protocol
from unicodedata import category

Point = tuple[float, float]
INK, SOFT, HAIR = "#1b222a", "#5a6672", "#c9d0d8"
COLOURS = ("#0a66ad", "#b04f00", "#11704a", "#6a43bf", "#8a6d00")
"""Colours of the series, in order. Labels also identify the series, so colour is not the only distinction."""

INVISIBLE = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Unicode categories of characters without a glyph. Some of them reverse the direction of the text after them, so that a
stored text can look like another one."""


def escaped(text: str) -> str:
    """Return a text for HTML and SVG. Characters without a glyph, except line breaks and tabs, are replaced by �."""
    if not text.isprintable():
        text = "".join("\N{REPLACEMENT CHARACTER}" if category(c) in INVISIBLE and c not in "\n\t" else c for c in text)
    return escape(text)


class Pen(Protocol):
    """Drawing interface. Coordinates are points of 1/72 inch, y downwards."""

    def line(self, points: Sequence[Point], colour: str, width: float = 1.0, dash: float = 0.0) -> None:
        """Draw a line through points."""
        ...

    def box(self, x: float, y: float, width: float, height: float, stroke: str = "", fill: str = "") -> None:
        """Draw a rectangle; "" omits its border or fill."""
        ...

    def dots(self, points: Sequence[Point], colour: str, radius: float) -> None:
        """Draw small discs."""
        ...

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 8,
        colour: str = INK,
        anchor: str = "start",
        up: bool = False,
    ) -> None:
        """Draw text on its baseline; ``anchor``: start, middle or end; ``up``: rotated to read upwards."""
        ...


class SvgPen:
    """A pen that writes SVG."""

    def __init__(self, width: float, height: float, title: str) -> None:
        self._size, self._title = (width, height), title
        self._parts: list[str] = []

    def line(self, points: Sequence[Point], colour: str, width: float = 1.0, dash: float = 0.0) -> None:
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        dashes = f" stroke-dasharray='{dash:g}'" if dash else ""
        self._parts.append(
            f"<polyline points='{path}' fill='none' stroke='{colour}' stroke-width='{width:g}'{dashes}/>"
        )

    def box(self, x: float, y: float, width: float, height: float, stroke: str = "", fill: str = "") -> None:
        self._parts.append(
            f"<rect x='{x:.1f}' y='{y:.1f}' width='{max(0, width):.1f}' height='{max(0, height):.1f}' "
            f"fill='{fill or 'none'}' stroke='{stroke or 'none'}' stroke-width='.6'/>"
        )

    def dots(self, points: Sequence[Point], colour: str, radius: float) -> None:
        # Dots are drawn as zero-length strokes with round caps. All dots are in one path, so thousands of dots need
        # only one element.
        path = " ".join(f"M{x:.1f},{y:.1f}h0" for x, y in points)
        self._parts.append(f"<path d='{path}' stroke='{colour}' stroke-width='{2 * radius:g}' stroke-linecap='round'/>")

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 8,
        colour: str = INK,
        anchor: str = "start",
        up: bool = False,
    ) -> None:
        rotation = f" transform='rotate(-90 {x:.1f} {y:.1f})'" if up else ""
        self._parts.append(
            f"<text x='{x:.1f}' y='{y:.1f}' font-size='{size:g}' text-anchor='{anchor}' fill='{colour}'{rotation}>"
            f"{escaped(text)}</text>"
        )

    def svg(self) -> str:
        """Return the SVG document."""
        width, height = self._size
        return (
            f"<svg viewBox='0 0 {width:g} {height:g}' role='img' xmlns='http://www.w3.org/2000/svg'>"
            f"<title>{escaped(self._title)}</title>{''.join(self._parts)}</svg>"
        )
