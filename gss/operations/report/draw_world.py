"""Draws a map of the Earth: values over latitude and longitude, coasts and a graticule, in equirectangular
projection."""

from __future__ import annotations

from gss.operations.report.parts import WorldMap
from gss.operations.report.pens import HAIR, INK, SOFT, Pen, Point
from gss.operations.report.shades import shade

LEFT, RIGHT, TOP, BOTTOM = 30.0, 4.0, 18.0, 30.0
WIDTH = 510.0
SCALE = (WIDTH - LEFT - RIGHT) / 360.0
HEIGHT = TOP + 180 * SCALE + BOTTOM
STEP_DEG = 30


def draw_world(pen: Pen, world: WorldMap) -> None:
    """Draw the map with its upper left corner at (0, 0)."""
    pen.text(LEFT, 11, world.title, size=8.5)
    levels = [v for line in world.values for v in line if v is not None]
    low, high = (min(levels), max(levels)) if levels else (0.0, 1.0)
    lat_step_deg, lon_step_deg = 180.0 / len(world.values), 360.0 / len(world.values[0])
    for j, line in enumerate(world.values):
        for i, value in enumerate(line):
            if value is not None:
                x, y = _place(-180 + i * lon_step_deg, 90 - j * lat_step_deg)
                pen.box(x, y, lon_step_deg * SCALE, lat_step_deg * SCALE, fill=shade(value, low, high))
    for degrees in range(-180 + STEP_DEG, 180, STEP_DEG):
        pen.line([_place(degrees, 90), _place(degrees, -90)], HAIR, 0.4)
    for degrees in range(-90 + STEP_DEG, 90, STEP_DEG):
        pen.line([_place(-180, degrees), _place(180, degrees)], HAIR, 0.4)
    for coast in world.coasts:
        pen.line([_place(*p) for p in coast], INK, 0.6)
    bottom = TOP + 180 * SCALE
    pen.box(LEFT, TOP, 360 * SCALE, 180 * SCALE, stroke=SOFT)
    for degrees in range(-120, 180, 60):
        pen.text(_place(degrees, 0)[0], bottom + 10, _east(degrees), size=7, colour=SOFT, anchor="middle")
    for degrees in (-60, -30, 0, 30, 60):
        pen.text(LEFT - 4, _place(0, degrees)[1] + 2.5, _north(degrees), size=7, colour=SOFT, anchor="end")
    span = f"{low:.3g} to {high:.3g} {world.unit}" if levels else "no frame with a known place"
    pen.text(LEFT, bottom + 23, f"{span}; {world.note}" if world.note else span, size=7.5, colour=SOFT)


def _place(east_deg: float, north_deg: float) -> Point:
    return LEFT + (east_deg + 180) * SCALE, TOP + (90 - north_deg) * SCALE


def _east(degrees: int) -> str:
    return "0°" if degrees == 0 else f"{abs(degrees)}° {'E' if degrees > 0 else 'W'}"


def _north(degrees: int) -> str:
    return "0°" if degrees == 0 else f"{abs(degrees)}° {'N' if degrees > 0 else 'S'}"
