"""Draws the whole sky as a Mollweide map with shades, stars and lines."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from gss.catalogue_tools.envelope.healpix import centres
from gss.domain.angles import unit_from_ra_dec
from gss.operations.report.parts import Number, Place, SkyMap
from gss.operations.report.pens import COLOURS, HAIR, INK, SOFT, Pen, Point

WIDTH, TOP = 510.0, 18.0
ACROSS, UP = 241.0, 120.5
HEIGHT = TOP + 2 * UP + 22
CELLS = (220, 110)
LEVELS = 12
MARK = COLOURS[1]


def draw_sky(pen: Pen, sky: SkyMap) -> None:
    """Draw the map with its upper left corner at (0, 0)."""
    pen.text(0, 11, sky.title, size=8.5)
    _shade(pen, sky.nside, sky.values)
    _graticule(pen)
    for line in sky.solid:
        _path(pen, line, COLOURS[0], 0.9)
    for line in sky.dashed:
        _path(pen, line, COLOURS[0], 0.9, 4)
    for ra_deg, dec_deg, v_mag in sky.stars:
        pen.dots([place(ra_deg, dec_deg)], INK, max(0.4, 1.9 - 0.3 * v_mag))
    if sky.mark:
        x, y = place(sky.mark[0], sky.mark[1])
        pen.box(x - 5, y - 5, 10, 10, stroke=MARK)
        near_edge, label_width = x > WIDTH * 0.7, 3.9 * len(sky.mark[2]) + 4
        pen.box(x - 8 - label_width if near_edge else x + 6, y - 5, label_width, 10, fill="#ffffff")
        pen.text(
            x + (-10 if near_edge else 8),
            y + 3,
            sky.mark[2],
            size=7.5,
            colour=MARK,
            anchor="end" if near_edge else "start",
        )
    rim = [(math.cos(t), math.sin(t)) for t in np.linspace(0, 2 * math.pi, 181).tolist()]
    pen.line([(WIDTH / 2 + ACROSS * c, TOP + UP + UP * s) for c, s in rim], SOFT, 0.6)
    pen.text(0, HEIGHT - 6, sky.note, size=7.5, colour=SOFT)


def place(ra_deg: float, dec_deg: float) -> Point:
    """Return the map coordinates of a direction. The centre of the map is at right ascension 180°."""
    lat, theta = math.radians(dec_deg), math.radians(dec_deg)
    for _ in range(12):
        slope = 2 + 2 * math.cos(2 * theta)
        if slope < 1e-9:
            break
        theta -= (2 * theta + math.sin(2 * theta) - math.pi * math.sin(lat)) / slope
    lon = math.radians((180.0 - ra_deg + 180.0) % 360.0 - 180.0)
    return WIDTH / 2 + ACROSS * lon / math.pi * math.cos(theta), TOP + UP - UP * math.sin(theta)


def _shade(pen: Pen, nside: int, values: Sequence[Number]) -> None:
    """Shade the map. Adjacent cells of equal tone in a row are drawn as one box."""
    numbers = np.array([math.nan if v is None else v for v in values], float)
    peak = float(np.nanmax(numbers, initial=0.0))
    if peak <= 0:
        return
    columns, rows = CELLS
    y = 1 - 2 * (np.arange(rows) + 0.5) / rows
    x = 2 * (np.arange(columns) + 0.5) / columns - 1
    theta = np.arcsin(y)
    dec = np.arcsin((2 * theta + np.sin(2 * theta)) / np.pi)
    lon = np.pi * x[None, :] / np.cos(theta)[:, None]
    _, pixel = cKDTree(centres(nside)).query(unit_from_ra_dec(np.pi - lon, np.broadcast_to(dec[:, None], lon.shape)))
    tone = np.nan_to_num(np.ceil(LEVELS * numbers[pixel] / peak)).astype(int)
    tone[np.abs(lon) > np.pi] = 0
    cell_width, cell_height = 2 * ACROSS / columns, 2 * UP / rows
    for row in range(rows):
        edges = np.flatnonzero(np.diff(np.concatenate([[-1], tone[row], [-1]])))
        for a, b in itertools.pairwise(edges.tolist()):
            if tone[row, a] > 0:
                ink = 235 - 15 * int(tone[row, a])
                fill = f"#{ink - 10:02x}{ink + 5:02x}f5"
                pen.box(
                    WIDTH / 2 - ACROSS + a * cell_width,
                    TOP + row * cell_height,
                    (b - a) * cell_width + 0.15,
                    cell_height + 0.15,
                    fill=fill,
                )


def _graticule(pen: Pen) -> None:
    for ra in range(30, 360, 30):
        _path(pen, [(ra, dec) for dec in range(-90, 91, 6)], HAIR, 0.4)
    for dec in (-60, -30, 0, 30, 60):
        _path(pen, [(min(ra, 359.99), dec) for ra in range(0, 361, 10)], HAIR, 0.4)
    for hour in range(3, 24, 3):
        x, y = place(15.0 * hour, 0)
        pen.text(x, y - 2, f"{hour}h", size=7, colour=SOFT, anchor="middle")
    for dec in (-60, -30, 30, 60):
        x, y = place(359.99, dec)
        pen.text(x - 4, y, f"{dec:+d}°", size=7, colour=SOFT, anchor="end")


def _path(pen: Pen, points: Sequence[Place], ink: str, width: float, dash: float = 0.0) -> None:
    """Draw a line on the sky, split where it crosses the edge of the map."""
    runs: list[list[Point]] = [[]]
    for point in points:
        at = place(*point)
        if runs[-1] and abs(at[0] - runs[-1][-1][0]) > ACROSS:
            runs.append([])
        runs[-1].append(at)
    for run in runs:
        if len(run) > 1:
            pen.line(run, ink, width, dash)
