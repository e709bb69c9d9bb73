"""Bench results as sections of a report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from gss.operations.report.figures import number
from gss.operations.report.parts import Arrows, Drawing, Fact, Level, Plot, Section, Series, Table

CIRCLE_POINTS = 72
ZERO_C_K = 273.15


def _centre(c: Mapping[str, Any]) -> list[Section]:
    method = "circle through the positions" if c["circle"] else "centre of the box around all positions"
    facts = [
        Fact("optical centre", f"{number(c['col_px'], 7)}, {number(c['row_px'], 7)}", "px", method),
        Fact("σ", number(c["sigma_px"], 2), "px", "per axis"),
        Fact("radius of the circle", number(c["radius_px"], 3), "px"),
        Fact("extent of the positions", f"{number(c['box_px'][0], 3)} x {number(c['box_px'][1], 3)}", "px"),
    ]
    series = [Series("places", [d[0] for d in c["dots_px"]], [d[1] for d in c["dots_px"]], "dots")]
    if c["circle"]:
        turns = [2 * math.pi * k / CIRCLE_POINTS for k in range(CIRCLE_POINTS + 1)]
        col = [c["col_px"] + c["radius_px"] * math.cos(t) for t in turns]
        row: list[float | None] = [c["row_px"] + c["radius_px"] * math.sin(t) for t in turns]
        series.append(Series("circle", col, row))
    plot = Plot("Dot during the camera rotation", "column, px", "row, px", series)
    return [Section("Optical centre from a dot", "Jacobs 1995 §6.2.1.", facts, [plot])]


def _tilt(t: Mapping[str, Any]) -> list[Section]:
    degrees = 180 / math.pi
    facts = [
        Fact(
            "largest tilt", number(t["tilt_max_rad"] * degrees, 3), "°", f"σ {number(t['sigma_rad'][0] * degrees, 2)}°"
        ),
        Fact(
            "distances converge towards",
            number(t["tilt_direction_rad"] * degrees, 4),
            "°",
            "from +columns towards +rows",
        ),
        Fact("distance of the dots", number(t["radius_mm"], 5), "mm", "on a detector without tilt"),
        Fact("residual", number(1000 * t["rms_mm"], 3), "µm", "rms"),
    ]
    angle = [a * degrees for a in t["angle_rad"]]
    residual_um = [1000 * v for v in t["residual_mm"]]
    measured = Plot("Distance of the dots", "angle, °", "mm", [Series("measured", angle, t["distance_mm"], "dots")])
    residuals = Plot("Measured − eq. 6.15", "angle, °", "µm", [Series("residual", angle, residual_um, "dots")])
    return [Section("Tilt of the detector from pairs of dots", "Jacobs 1995 §6.2.3.1.", facts, [measured, residuals])]


def _focal(f: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("focal length", number(f["focal_px"], 7), "px", f"σ {number(f['sigma_px'], 2)} px"),
        Fact("by the small-angle form", number(f["erlank_px"], 7), "px", "Erlank 2013 eq. 5.4.1"),
        Fact("documented", number(f["documented_px"], 7), "px"),
        Fact("pairs", number(f["pairs"]), "", f"of {f['frames']} frames"),
    ]
    plot = Plot(
        "Focal length of every pair",
        "distance of the farther star from the centre, px",
        "px",
        [Series("pairs", f["radius_px"], f["values_px"], "dots")],
        [Level(f["focal_px"], "mean weighted by pair length")],
    )
    return [Section("Focal length from pairs of stars", "Jacobs 1995 eq. 6.4–6.6.", facts, [plot])]


def _radial(r: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("residual", number(1000 * r["rms_mm"], 3), "µm", "rms"),
        Fact("frames", number(r["frames"]), "", "with a star near the centre"),
    ]
    rows = [
        [f"k{k + 1}", number(v, 5), number(s, 2)]
        for k, (v, s) in enumerate(zip(r["coefficients"], r["sigma"], strict=True))
    ]
    at = sorted(r["r_mm"])
    fit: list[float | None] = [sum(k * x ** (n + 1) for n, k in enumerate(r["coefficients"])) for x in at]
    plot = Plot(
        "Measured − true distance from the centre",
        "distance, mm",
        "mm",
        [Series("stars", r["r_mm"], r["delta_mm"], "dots"), Series("polynomial", at, fit)],
    )
    table = Table("Δr = k1 r + k2 r² + …, mm", ["", "value", "σ"], rows)
    return [Section("Radial polynomial", "Jacobs 1995 §6.2.3.1, eq. 6.16–6.17.", facts, [plot], [table])]


def _checkerboard(c: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("residual", number(c["residual_rms_px"], 3), "px", "rms per axis"),
        Fact("pictures", number(sum(c["found"])), "", f"of {len(c['found'])}"),
        Fact("corners in", number(100 * c["covered"], 3), "%", "of the field"),
    ]
    rows = [
        [n, number(v, 7), number(s, 2) if s else "held"]
        for n, v, s in zip(c["names"], c["values"], c["sigma"], strict=True)
    ]
    pictures = [
        [name, "found" if found_board else "not found", number(rms, 3)]
        for name, found_board, rms in zip(c["pictures"], c["found"], c["rms_px"], strict=True)
    ]
    camera = c["camera"]
    longest = max((math.hypot(d[0], d[1]) for d in c["residual_px"]), default=0.0)
    arrows: list[Drawing] = [
        Arrows(
            "Residual at each corner",
            camera["columns"],
            camera["rows"],
            [p[0] for p in c["corners_px"]],
            [p[1] for p in c["corners_px"]],
            [d[0] for d in c["residual_px"]],
            [d[1] for d in c["residual_px"]],
            camera["columns"] / 20 / longest if longest > 0 else 1.0,
        )
    ]
    tables = [Table("Parameters", ["name", "value", "σ"], rows), Table("Pictures", ["", "board", "rms px"], pictures)]
    text = "A camera focused on a board is not focused on stars: determine the focal length from stars."
    return [Section("Checkerboard", text, facts, arrows, tables)]


def _dark_law(d: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("dark current", number(d["at_reference_e_s"]), "e⁻/s", f"at {number(d['reference_k'] - ZERO_C_K, 3)} °C"),
        Fact("doubles every", number(d["doubling_k"], 3), "°C", f"σ {number(d['doubling_sigma_k'], 2)} °C"),
        Fact("band gap", number(d["band_gap_ev"], 3), "eV", "silicon 1.1 eV, generation at mid-gap"),
    ]
    at = sorted(d["temperature_c"])
    law: list[float | None] = [
        d["at_reference_e_s"] * math.exp(d["exponent_k"] * (1 / d["reference_k"] - 1 / (t + ZERO_C_K))) for t in at
    ]
    series = [Series("measured", d["temperature_c"], d["dark_e_s"], "dots"), Series("law", at, law)]
    plot = Plot("Dark current", "temperature, °C", "e⁻/s", series, log_y=True)
    return [Section("Dark current against temperature", "Jacobs 1995 eq. H.1–H.2.", facts, [plot])]


def _focus_run(f: Mapping[str, Any]) -> list[Section]:
    wished = f["wished_positions"]
    facts = [
        Fact("sharpest at", number(f["position"], 5), "", f"σ {number(f['position_sigma'], 2)}"),
        Fact("σ of the stars there", number(f["smallest_sigma_px"], 3), "px"),
        Fact(f"σ {number(f['wished_sigma_px'], 2)} px at", f"{number(wished[0], 5)} and {number(wished[1], 5)}"),
    ]
    plot = Plot(
        "Width of the stars",
        "setting of the lens",
        "σ, px",
        [Series("pictures", f["positions"], f["sigma_px"], "dots")],
        [Level(f["wished_sigma_px"], "wished"), Level(f["position"], "sharpest", True)],
    )
    a = f["advice"]
    return [Section("Focus run", f"Sharpest: {a['text']}; {a['hint']}.", facts, [plot])]


BENCH: dict[str, Callable[[Any], list[Section]]] = {
    "centre": _centre,
    "tilt": _tilt,
    "focal": _focal,
    "radial": _radial,
    "checkerboard": _checkerboard,
    "dark_law": _dark_law,
    "focus_run": _focus_run,
}
