"""Sections of a report for the results of bench calibrations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from gss.operations.report.figures import number
from gss.operations.report.parts import Arrows, Drawing, Fact, Level, Plot, Section, Series, Table

CIRCLE_POINTS = 72
ZERO_C_K = 273.15
CIRCLE_COLUMNS = (
    ("col_px", 7),
    ("row_px", 7),
    ("sigma_px", 2),
    ("noise_px", 2),
    ("asymmetry_px", 2),
    ("radius_px", 4),
    ("half_px", 4),
)
"""Values of a circle of light in the table of pictures, with their digits."""


def _centre(centre: Mapping[str, Any]) -> list[Section]:
    method = "circle through the positions" if centre["circle"] else "centre of the box around all positions"
    facts = [
        Fact("optical centre", f"{number(centre['col_px'], 7)}, {number(centre['row_px'], 7)}", "px", method),
        Fact("σ", number(centre["sigma_px"], 2), "px", "larger of column and row"),
        Fact("radius of the circle", number(centre["radius_px"], 3), "px"),
        Fact("extent of the positions", f"{number(centre['box_px'][0], 3)} x {number(centre['box_px'][1], 3)}", "px"),
    ]
    series = [Series("positions", [d[0] for d in centre["dots_px"]], [d[1] for d in centre["dots_px"]], "dots")]
    if centre["circle"]:
        angles = [2 * math.pi * k / CIRCLE_POINTS for k in range(CIRCLE_POINTS + 1)]
        col = [centre["col_px"] + centre["radius_px"] * math.cos(t) for t in angles]
        row: list[float | None] = [centre["row_px"] + centre["radius_px"] * math.sin(t) for t in angles]
        series.append(Series("circle", col, row))
    plot = Plot("Dot during the camera rotation", "column, px", "row, px", series)
    return [Section("Optical centre from a dot", "Jacobs 1995 §6.2.1.", facts, [plot])]


def _second_lens(point: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("principal point", f"{number(point['col_px'], 7)}, {number(point['row_px'], 7)}", "px"),
        Fact("σ", number(point["sigma_px"], 2), "px", "per axis"),
        Fact("scatter of the pictures", number(point["scatter_px"], 2), "px", "per axis"),
    ]
    columns = [
        "",
        "column px",
        "row px",
        "σ px",
        "noise px",
        "asymmetry px",
        "radius of the disc px",
        "half light at px",
    ]
    rows = [
        [name, *(number(circle[key], digits) for key, digits in CIRCLE_COLUMNS)]
        for name, circle in zip(point["pictures"], point["circles"], strict=True)
    ]
    centres = [c["col_px"] for c in point["circles"]], [c["row_px"] for c in point["circles"]]
    series = [
        Series("pictures", *centres, "dots"),
        Series("principal point", [point["col_px"]], [point["row_px"]], "dots"),
    ]
    plot = Plot("Centre of the circle of light", "column, px", "row, px", series)
    return [
        Section(
            "Principal point from a second lens", "Erlank 2013 §5.4.", facts, [plot], [Table("Pictures", columns, rows)]
        )
    ]


def _tilt(tilt: Mapping[str, Any]) -> list[Section]:
    degrees = 180 / math.pi
    facts = [
        Fact(
            "largest tilt",
            number(tilt["tilt_max_rad"] * degrees, 3),
            "°",
            f"σ {number(tilt['sigma_rad'][0] * degrees, 2)}°",
        ),
        Fact(
            "distances converge towards",
            number(tilt["tilt_direction_rad"] * degrees, 4),
            "°",
            "from +columns towards +rows",
        ),
        Fact("distance of the dots", number(tilt["radius_mm"], 5), "mm", "on a detector without tilt"),
        Fact("residual", number(1000 * tilt["rms_mm"], 3), "µm", "rms"),
    ]
    angle = [a * degrees for a in tilt["angle_rad"]]
    residual_um = [1000 * v for v in tilt["residual_mm"]]
    measured = Plot("Distance of the dots", "angle, °", "mm", [Series("measured", angle, tilt["distance_mm"], "dots")])
    residuals = Plot("Measured − eq. 6.15", "angle, °", "µm", [Series("residual", angle, residual_um, "dots")])
    return [Section("Tilt of the detector from pairs of dots", "Jacobs 1995 §6.2.3.1.", facts, [measured, residuals])]


def _focal(focal: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("focal length", number(focal["focal_px"], 7), "px", f"σ {number(focal['sigma_px'], 2)} px"),
        Fact("from the small-angle form", number(focal["erlank_px"], 7), "px", "Erlank 2013 eq. 5.4.1"),
        Fact("documented", number(focal["documented_px"], 7), "px"),
        Fact("pairs", number(focal["pairs"]), "", f"of {focal['frames']} frames"),
    ]
    plot = Plot(
        "Focal length of each pair",
        "distance of the farther star from the centre, px",
        "px",
        [Series("pairs", focal["radius_px"], focal["values_px"], "dots")],
        [Level(focal["focal_px"], "mean weighted by pair length")],
    )
    return [Section("Focal length from pairs of stars", "Jacobs 1995 eq. 6.4–6.6.", facts, [plot])]


def _radial(radial: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("residual", number(1000 * radial["rms_mm"], 3), "µm", "rms"),
        Fact("frames", number(radial["frames"]), "", "with a star near the centre"),
    ]
    rows = [
        [f"k{k + 1}", number(v, 5), number(s, 2)]
        for k, (v, s) in enumerate(zip(radial["coefficients"], radial["sigma"], strict=True))
    ]
    at = sorted(radial["r_mm"])
    fit: list[float | None] = [sum(k * x ** (n + 1) for n, k in enumerate(radial["coefficients"])) for x in at]
    plot = Plot(
        "Measured − true distance from the centre",
        "distance, mm",
        "mm",
        [Series("stars", radial["r_mm"], radial["delta_mm"], "dots"), Series("polynomial", at, fit)],
    )
    table = Table("Δr = k1 r + k2 r² + …, mm", ["", "value", "σ"], rows)
    return [Section("Radial polynomial", "Jacobs 1995 §6.2.3.1, eq. 6.16–6.17.", facts, [plot], [table])]


def _checkerboard(checkerboard: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("residual", number(checkerboard["residual_rms_px"], 3), "px", "rms per axis"),
        Fact("pictures", number(sum(checkerboard["found"])), "", f"of {len(checkerboard['found'])}"),
        Fact("corners in", number(100 * checkerboard["covered"], 3), "%", "of the field"),
    ]
    rows = [
        [n, number(v, 7), number(s, 2) if s else "held"]
        for n, v, s in zip(checkerboard["names"], checkerboard["values"], checkerboard["sigma"], strict=True)
    ]
    pictures = [
        [name, "found" if found_board else "not found", number(rms, 3)]
        for name, found_board, rms in zip(
            checkerboard["pictures"], checkerboard["found"], checkerboard["rms_px"], strict=True
        )
    ]
    camera = checkerboard["camera"]
    longest = max((math.hypot(d[0], d[1]) for d in checkerboard["residual_px"]), default=0.0)
    arrows: list[Drawing] = [
        Arrows(
            "Residual at each corner",
            camera["columns"],
            camera["rows"],
            [p[0] for p in checkerboard["corners_px"]],
            [p[1] for p in checkerboard["corners_px"]],
            [d[0] for d in checkerboard["residual_px"]],
            [d[1] for d in checkerboard["residual_px"]],
            camera["columns"] / 20 / longest if longest > 0 else 1.0,
        )
    ]
    tables = [Table("Parameters", ["name", "value", "σ"], rows), Table("Pictures", ["", "board", "rms px"], pictures)]
    text = "A camera that is focused on a board is not focused on stars. Determine the focal length from stars."
    return [Section("Checkerboard", text, facts, arrows, tables)]


def _dark_law(dark: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact(
            "dark current",
            number(dark["at_reference_e_s"]),
            "e⁻/s",
            f"at {number(dark['reference_k'] - ZERO_C_K, 3)} °C",
        ),
        Fact("doubles every", number(dark["doubling_k"], 3), "°C", f"σ {number(dark['doubling_sigma_k'], 2)} °C"),
        Fact("band gap", number(dark["band_gap_ev"], 3), "eV", "silicon 1.1 eV, generation at mid-gap"),
    ]
    at = sorted(dark["temperature_c"])
    law: list[float | None] = [
        dark["at_reference_e_s"] * math.exp(dark["exponent_k"] * (1 / dark["reference_k"] - 1 / (t + ZERO_C_K)))
        for t in at
    ]
    series = [Series("measured", dark["temperature_c"], dark["dark_e_s"], "dots"), Series("law", at, law)]
    plot = Plot("Dark current", "temperature, °C", "e⁻/s", series, log_y=True)
    return [Section("Dark current against temperature", "Jacobs 1995 eq. H.1–H.2.", facts, [plot])]


def _focus_run(focus: Mapping[str, Any]) -> list[Section]:
    wished = focus["wished_positions"]
    facts = [
        Fact("sharpest at", number(focus["position"], 5), "", f"σ {number(focus['position_sigma'], 2)}"),
        Fact("σ of the stars there", number(focus["smallest_sigma_px"], 3), "px"),
        Fact(f"σ {number(focus['wished_sigma_px'], 2)} px at", f"{number(wished[0], 5)} and {number(wished[1], 5)}"),
    ]
    plot = Plot(
        "Width of the stars",
        "setting of the lens",
        "σ, px",
        [Series("pictures", focus["positions"], focus["sigma_px"], "dots")],
        [Level(focus["wished_sigma_px"], "wished"), Level(focus["position"], "sharpest", True)],
    )
    advice = focus["advice"]
    return [Section("Focus run", f"Sharpest: {advice['text']}; {advice['hint']}.", facts, [plot])]


BENCH: dict[str, Callable[[Any], list[Section]]] = {
    "centre": _centre,
    "second_lens": _second_lens,
    "tilt": _tilt,
    "focal": _focal,
    "radial": _radial,
    "checkerboard": _checkerboard,
    "dark_law": _dark_law,
    "focus_run": _focus_run,
}
