"""Design record as a report to store or send: values, curves, baffle and tables."""

from __future__ import annotations

from itertools import groupby
from typing import Any

from gss.operations.catalogues.design_values import (
    BaffleValues,
    CurveValues,
    DesignValues,
    FigureValue,
    TradeValues,
)
from gss.operations.report.parts import Level, Note, Outline, Place, Plot, Report, Section, Series, Table

TRADE = ("camera", "f, mm", "f/", "field, °", "pixel, ″", "limit V", "stars", "< 3, %", "across, ″", "roll, ″")


def design_sheet(record: DesignValues) -> Report:
    """Return the complete report of a design record."""
    changed = ", ".join(f"{k} {record['camera'][k]:g} (was {_plain(record['base'][k])})" for k in record["changed"])
    sample_sizes = (
        f"{record['histogram']['pointings']} pointings for the histogram, {record['looks']} for curves and accuracy"
    )
    sections = [
        Section("Figures", tables=[_figures(group, rows) for group, rows in _groups(record["figures"])]),
        Section("Curves", drawings=[_curve(c) for c in record["curves"] if c["lines"]]),
        Section("Baffle, section to scale", drawings=[_baffle(b) for b in record["baffles"]]),
        Section("Cameras", tables=[_trade(record["cameras"])]),
    ]
    if record["trade"]:
        sections.append(Section("Lenses of this camera", tables=[_trade(record["trade"])]))
    camera = "; ".join(f"{k} {_plain(v)}" for k, v in record["camera"].items() if k != "name")
    return Report(
        f"Camera design: {record['profile']}{', edited' if changed else ''}",
        "; ".join([changed or "as in the document", record["sky"], sample_sizes]),
        [*sections, Section("All numbers of the camera", camera)],
        [Note(n) for n in (*record["notes"], record["baffle_problem"]) if n],
    )


def _plain(value: Any) -> str:
    return "auto" if value is None else f"{value:g}"


def _groups(figures: list[FigureValue]) -> list[tuple[str, list[FigureValue]]]:
    return [(group, list(rows)) for group, rows in groupby(figures, key=lambda f: str(f["group"]))]


def _figures(group: str, figures: list[FigureValue]) -> Table:
    rows = [
        [
            f["label"],
            "–" if f["value"] is None else f"{f['value']:.4g}",
            f["unit"],
            "" if f["paper"] is None else f"{f['paper']:g}",
            f["source"] + (f"; paper: {f['paper_source']}" if f["paper_source"] else ""),
        ]
        for f in figures
    ]
    return Table(group, ["figure", "value", "unit", "paper", "from"], rows)


def _trade(cameras: list[TradeValues]) -> Table:
    rows = [
        [
            r["name"],
            f"{r['focal_mm']:.2f}",
            f"{r['f_number']:.2f}",
            f"{r['fov_deg'][0]:.1f} × {r['fov_deg'][1]:.1f}",
            f"{r['pixel_arcsec']:.1f}",
            f"{r['limit_mag']:.2f}",
            f"{r['stars']:.1f}",
            f"{100 * r['p_fewer_3']:.2f}",
            *("–" if v is None else f"{v:.2f}" for v in (r["cross_arcsec"], r["roll_arcsec"])),
        ]
        for r in cameras
    ]
    return Table("", list(TRADE), rows)


def _curve(curve: CurveValues) -> Plot:
    """Return the plot of a curve, including the published points."""
    lines = [Series(line["label"], line["x"], line["y"]) for line in curve["lines"]]
    if curve["marks"]:
        lines.append(
            Series(
                curve["marks"][0]["source"], [m["x"] for m in curve["marks"]], [m["y"] for m in curve["marks"]], "dots"
            )
        )
    span = [x for line in curve["lines"] for x in line["x"]]
    uprights = [
        Level(u["x"], f"{u['label']} {u['x']:.3g}", vertical=True)
        for u in curve["uprights"]
        if min(span) <= u["x"] <= max(span)
    ]
    return Plot(
        curve["title"], curve["x_label"], curve["y_label"], lines, uprights, log_y=curve["log_y"], log_x=curve["log_x"]
    )


def _baffle(baffle: BaffleValues) -> Outline:
    outer = max(w[2] for w in baffle["walls_mm"])

    def wall(z: float) -> float:
        return float(next((w[2] for w in baffle["walls_mm"] if z <= w[1] + 1e-6), outer))

    lines: list[list[Place]] = []
    for side in (-1, 1):
        lines += [[(z0, side * r), (z1, side * r)] for z0, z1, r in baffle["walls_mm"]]
        lines += [[(z, side * wall(z)), (z, side * r)] for z, r in baffle["edges_mm"]]
    lens = baffle["lens_radius_mm"]
    stages = "One stage" if baffle["kind"] == "one" else "Two stages"
    text = f"{stages}, {baffle['length_mm']:.1f} mm long, ⌀ {2 * outer:.1f} mm, keeps out from {baffle['exclusion_deg']:.1f}°"
    return Outline(text, lines, [[(0.0, -lens), (0.0, lens)]])
