"""One series as a small drawing for paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

WIDTH, HEIGHT = 720.0, 150.0
LEFT, RIGHT, TOP, BOTTOM = 56.0, 8.0, 8.0, 22.0
GAP_SHARE, GAP_S = 0.02, 12.0
"""A line is not drawn across more than this share of the span, and this time, without a sample."""


def plot(t: Sequence[float], y: Sequence[float | None]) -> str:
    """SVG of y over Unix seconds t, with the range of both axes written; breaks where there is nothing."""
    known = [(a, b) for a, b in zip(t, y, strict=True) if b is not None and math.isfinite(b)]
    if not known:
        return f"<svg viewBox='0 0 {WIDTH:g} {HEIGHT:g}' role='img'></svg>"
    t0, t1 = known[0][0], known[-1][0]
    low, high = min(b for _, b in known), max(b for _, b in known)
    if high - low < 1e-12 * max(1.0, abs(high)):
        low, high = low - 0.5, high + 0.5
    across, up = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def place(a: float, b: float) -> tuple[float, float]:
        x = LEFT + (across * (a - t0) / (t1 - t0) if t1 > t0 else across / 2)
        return x, TOP + up * (high - b) / (high - low)

    lines = "".join(_line([place(*sample) for sample in run]) for run in _runs(t, y, GAP_SHARE * (t1 - t0)))
    box = f"<rect x='{LEFT}' y='{TOP}' width='{across}' height='{up}' fill='none' stroke='#999'/>"
    words = (
        _text(LEFT - 4, TOP + 9, f"{high:.4g}", "end")
        + _text(LEFT - 4, TOP + up, f"{low:.4g}", "end")
        + _text(LEFT, HEIGHT - 6, f"{datetime.fromtimestamp(t0, UTC):%H:%M:%S}", "start")
        + _text(WIDTH - RIGHT, HEIGHT - 6, f"{datetime.fromtimestamp(t1, UTC):%H:%M:%S} UTC", "end")
    )
    return f"<svg viewBox='0 0 {WIDTH:g} {HEIGHT:g}' role='img' font-size='11'>{box}{lines}{words}</svg>"


def _runs(t: Sequence[float], y: Sequence[float | None], longest_s: float) -> list[list[tuple[float, float]]]:
    """Samples that belong together."""
    runs: list[list[tuple[float, float]]] = [[]]
    for a, b in zip(t, y, strict=True):
        far = bool(runs[-1]) and a - runs[-1][-1][0] > max(longest_s, GAP_S)
        if (b is None or far) and runs[-1]:
            runs.append([])
        if b is not None:
            runs[-1].append((a, b))
    return [run for run in runs if run]


def _line(points: Sequence[tuple[float, float]]) -> str:
    if len(points) == 1:
        return f"<circle cx='{points[0][0]:.1f}' cy='{points[0][1]:.1f}' r='1.5' fill='#1f4e8c'/>"
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f"<polyline points='{path}' fill='none' stroke='#1f4e8c' stroke-width='1.2'/>"


def _text(x: float, y: float, words: str, anchor: str) -> str:
    return f"<text x='{x:g}' y='{y:g}' text-anchor='{anchor}' fill='#333'>{words}</text>"
