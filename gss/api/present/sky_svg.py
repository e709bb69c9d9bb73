"""Drawings of a catalogue for paper: the sky by Mollweide, bars, a curve. No scripts, colours that print."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from gss.catalogue_tools.envelope.healpix import centres
from gss.domain.angles import unit_from_ra_dec

WIDTH, HEIGHT = 720.0, 372.0
ACROSS, UP = 340.0, 170.0
COLUMNS, ROWS = 220, 110
LEVELS = 12
Line = Sequence[Sequence[float]]


def sky_map(
    nside: int,
    values: Sequence[float | None],
    title: str,
    *,
    stars: Sequence[tuple[float, float, float]] = (),
    lines: Sequence[tuple[str, Line]] = (),
    mark: tuple[float, float, str] | None = None,
) -> str:
    """SVG of HEALPix ring values, white where None or 0. ``stars``: RA, Dec in degrees and V. ``lines``: a dash pattern and
    points (RA, Dec) in degrees. ``mark``: RA, Dec in degrees and words. RA grows to the left, 180° in the middle."""
    parts = [_shade(nside, values), _graticule()]
    parts += [_path(points, dash) for dash, points in lines]
    parts += [_star(*star) for star in stars]
    if mark:
        x, y = place(mark[0], mark[1])
        parts.append(f"<rect x='{x - 8:.1f}' y='{y - 8:.1f}' width='16' height='16' fill='none' stroke='#a46000'/>")
        anchor = "end" if x > WIDTH * 0.7 else "start"
        shift = -12 if anchor == "end" else 12
        parts.append(text(x + shift, y + 4, mark[2], anchor))
    rim = f"<ellipse cx='{WIDTH / 2}' cy='{HEIGHT / 2}' rx='{ACROSS}' ry='{UP}' fill='none' stroke='#555'/>"
    return f"<svg viewBox='0 0 {WIDTH:g} {HEIGHT:g}' role='img' aria-label='{title}'>{''.join(parts)}{rim}</svg>"


def place(ra_deg: float, dec_deg: float) -> tuple[float, float]:
    """Where a direction is drawn."""
    lat, theta = math.radians(dec_deg), math.radians(dec_deg)
    for _ in range(12):
        change = 2 * theta + math.sin(2 * theta) - math.pi * math.sin(lat)
        slope = 2 + 2 * math.cos(2 * theta)
        if slope < 1e-9:
            break
        theta -= change / slope
    lon = math.radians((180.0 - ra_deg + 180.0) % 360.0 - 180.0)
    return WIDTH / 2 + ACROSS * lon / math.pi * math.cos(theta), HEIGHT / 2 - UP * math.sin(theta)


def bars(counts: Sequence[int], title: str, *, need: int, mean: float) -> str:
    """SVG of a histogram from 0 up; fewer than ``need`` in another colour."""
    wide, high = WIDTH, 150.0
    peak, step = max(max(counts, default=1), 1), (wide - 20) / max(10, len(counts))
    drawn = "".join(
        f"<rect x='{10 + k * step:.1f}' y='{high - 22 - n / peak * (high - 40):.1f}' width='{max(0.5, step - 1):.1f}' "
        f"height='{n / peak * (high - 40):.1f}' fill='{'#c98a00' if k < need else '#3a77a3'}'/>"
        for k, n in enumerate(counts)
    )
    ticks = "".join(text(10 + k * step, high - 8, f"{k}", "start") for k in range(0, len(counts), 5))
    at = 10 + mean * step
    line = f"<line x1='{at:.1f}' x2='{at:.1f}' y1='14' y2='{high - 22}' stroke='#111' stroke-dasharray='3 3'/>"
    return (
        f"<svg viewBox='0 0 {wide:g} {high:g}' role='img' aria-label='{title}'>{drawn}{line}"
        f"{text(at + 4, 18, f'mean {mean:.1f}', 'start')}{ticks}</svg>"
    )


def curve(x: Sequence[float], y: Sequence[float], title: str, x_word: str, threshold: float) -> str:
    """SVG of shares between 0 and 1 over x, with a threshold."""
    wide, high, left = WIDTH, 150.0, 46.0
    low = min([threshold, *y]) - 0.02
    span = max(x) or 1.0

    def at(a: float, b: float) -> tuple[float, float]:
        return left + (wide - left - 10) * a / span, 10 + (high - 40) * (1 - b) / max(1 - low, 1e-9)

    points = " ".join(f"{px:.1f},{py:.1f}" for px, py in (at(a, b) for a, b in zip(x, y, strict=True)))
    bar = at(0, threshold)[1]
    return (
        f"<svg viewBox='0 0 {wide:g} {high:g}' role='img' aria-label='{title}'>"
        f"<polyline points='{points}' fill='none' stroke='#1f4e8c' stroke-width='1.4'/>"
        f"<line x1='{left}' x2='{wide - 10}' y1='{bar:.1f}' y2='{bar:.1f}' stroke='#a46000' stroke-dasharray='4 3'/>"
        f"{text(left - 4, 16, '100 %', 'end')}{text(left - 4, bar + 4, f'{100 * threshold:.0f} %', 'end')}"
        f"{text(left, high - 8, '0', 'start')}{text(wide - 10, high - 8, f'{span:.0f} {x_word}', 'end')}</svg>"
    )


def share_bar(parts: Sequence[tuple[str, float]], whole: float, title: str) -> str:
    """SVG of parts beside each other in a whole."""
    inks, wide, x, drawn, words = ("#27506e", "#5bb7f0", "#a5d8f7", "#3a77a3", "#7a5f00"), WIDTH, 0.0, [], []
    for k, (name, size) in enumerate(parts):
        length = wide * size / max(whole, 1e-9)
        drawn.append(f"<rect x='{x:.1f}' y='0' width='{length:.1f}' height='18' fill='{inks[k % len(inks)]}'/>")
        words.append(f"<tspan fill='{inks[k % len(inks)]}'>■ </tspan>{name} {size:.0f} B&#160;&#160;&#160;")
        x += length
    frame = f"<rect x='0.5' y='0.5' width='{wide - 1}' height='17' fill='none' stroke='#999'/>"
    legend = f"<text x='0' y='34' font-size='11' fill='#333'>{''.join(words)}</text>"
    return f"<svg viewBox='0 0 {wide:g} 40' role='img' aria-label='{title}'>{''.join(drawn)}{frame}{legend}</svg>"


def text(x: float, y: float, words: str, anchor: str) -> str:
    """Small print with a white rim."""
    return (
        f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' font-size='11' fill='#222' stroke='#fff' "
        f"stroke-width='3' paint-order='stroke'>{words}</text>"
    )


def _shade(nside: int, values: Sequence[float | None]) -> str:
    """Runs of equal tone along rows of the map."""
    known = np.array([math.nan if v is None else v for v in values], float)
    peak = float(np.nanmax(known, initial=0.0))
    if peak <= 0:
        return ""
    y = 1 - 2 * (np.arange(ROWS) + 0.5) / ROWS
    x = 2 * (np.arange(COLUMNS) + 0.5) / COLUMNS - 1
    theta = np.arcsin(y)
    dec = np.arcsin((2 * theta + np.sin(2 * theta)) / np.pi)
    lon = np.pi * x[None, :] / np.cos(theta)[:, None]
    ra = np.pi - lon
    _, pixel = cKDTree(centres(nside)).query(unit_from_ra_dec(ra, np.broadcast_to(dec[:, None], ra.shape)))
    tone = np.nan_to_num(np.ceil(LEVELS * known[pixel] / peak)).astype(int)
    tone[np.abs(lon) > np.pi] = 0
    wide, high = 2 * ACROSS / COLUMNS, 2 * UP / ROWS
    drawn = []
    for row in range(ROWS):
        edges = np.flatnonzero(np.diff(np.concatenate([[-1], tone[row], [-1]])))
        for a, b in itertools.pairwise(edges):
            if tone[row, a] > 0:
                ink = 235 - 15 * int(tone[row, a])
                drawn.append(
                    f"<rect x='{WIDTH / 2 - ACROSS + a * wide:.1f}' y='{HEIGHT / 2 - UP + row * high:.1f}' "
                    f"width='{(b - a) * wide + 0.2:.1f}' height='{high + 0.2:.1f}' fill='rgb({ink - 10},{ink + 5},{245})'/>"
                )
    return "".join(drawn)


def _graticule() -> str:
    lines: list[list[tuple[float, float]]] = [[(ra, dec) for dec in range(-90, 91, 6)] for ra in range(30, 360, 30)]
    lines += [[(min(ra, 359.99), dec) for ra in range(0, 361, 10)] for dec in (-60, -30, 0, 30, 60)]
    words = "".join(text(*place(15.0 * h, 0), f"{h}h", "middle") for h in range(3, 24, 3))
    words += "".join(text(place(359.99, d)[0] - 6, place(359.99, d)[1], f"{d:+d}°", "end") for d in (-60, -30, 30, 60))
    return "".join(_path(line, "", "#d5dbe2") for line in lines) + words


def _path(points: Line, dash: str, ink: str = "#0a66ad") -> str:
    """A line of the sky, cut where it leaves one side of the map for the other."""
    runs: list[list[tuple[float, float]]] = [[]]
    for point in points:
        at = place(point[0], point[1])
        if runs[-1] and abs(at[0] - runs[-1][-1][0]) > ACROSS:
            runs.append([])
        runs[-1].append(at)
    dashes = f" stroke-dasharray='{dash}'" if dash else ""
    return "".join(
        f"<polyline points='{' '.join(f'{x:.1f},{y:.1f}' for x, y in run)}' fill='none' stroke='{ink}'{dashes}/>"
        for run in runs
        if len(run) > 1
    )


def _star(ra_deg: float, dec_deg: float, v_mag: float) -> str:
    x, y = place(ra_deg, dec_deg)
    return f"<circle cx='{x:.1f}' cy='{y:.1f}' r='{max(0.6, 2.6 - 0.4 * v_mag):.1f}' fill='#111'/>"
