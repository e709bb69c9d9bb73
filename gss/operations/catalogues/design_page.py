"""A design record as one page to keep or send: figures, curves, baffle, tables. No script and nothing from outside."""

from __future__ import annotations

import math
from html import escape
from typing import Any

WIDTH, HEIGHT = 520.0, 240.0
LEFT, RIGHT, TOP, BOTTOM = 52.0, 12.0, 10.0, 36.0
DASHES = ("", "6 3", "1 3")
STYLE = (
    "body{font:13px/1.4 'IBM Plex Sans',sans-serif;margin:24px;max-width:1100px;color:#12171d;background:#fff}"
    "h1{font-size:20px}h2{font-size:15px;margin:22px 0 6px}table{border-collapse:collapse}"
    "td,th{padding:2px 10px 2px 0;text-align:left;border-bottom:1px solid #dce1e7}"
    "td.n,th.n{text-align:right}.t{color:#556170}figure{display:inline-block;margin:0 8px 12px 0}"
    "figcaption{font-weight:600}text{font-size:11px;fill:#556170}"
)


def page_of(record: dict[str, Any]) -> str:
    """The whole page."""
    changed = ", ".join(f"{k} {record['camera'][k]:g} (was {_plain(record['base'][k])})" for k in record["changed"])
    head = f"<h1>Camera design: {escape(record['profile'])}{', edited' if changed else ''}</h1>"
    said = [
        changed or "as in the document",
        record["sky"],
        f"{record['histogram']['pointings']} pointings for the histogram, {record['looks']} for curves and accuracy",
    ]
    notes = "".join(f"<p>{escape(n)}</p>" for n in (*record["notes"], record["baffle_problem"]) if n)
    parts = [
        head,
        f"<p class='t'>{escape('; '.join(said))}</p>",
        notes,
        _figures(record["figures"]),
        "<h2>Curves</h2>",
        *(_curve(c) for c in record["curves"]),
        "<h2>Baffle, section to scale</h2>",
        *(_baffle(b) for b in record["baffles"]),
        _table("Cameras", record["cameras"]),
        _table("Lenses of this camera", record["trade"]) if record["trade"] else "",
        f"<h2>All numbers of the camera</h2><p>{escape(_camera(record['camera']))}</p>",
    ]
    title = f"Camera design: {escape(record['profile'])}"
    body = "\n".join(parts)
    return f"<!doctype html><html lang='en'><meta charset='utf-8'><title>{title}</title><style>{STYLE}</style>{body}</html>\n"


def _camera(camera: dict[str, Any]) -> str:
    return "; ".join(f"{k} {_plain(v)}" for k, v in camera.items() if k != "name")


def _plain(value: Any) -> str:
    return "auto" if value is None else f"{value:g}"


def _figures(figures: list[dict[str, Any]]) -> str:
    rows, group = [], ""
    for f in figures:
        if f["group"] != group:
            group = f["group"]
            rows.append(f"<tr><th colspan='5'>{escape(group)}</th></tr>")
        paper = "" if f["paper"] is None else f"{f['paper']:g}"
        source = f["source"] + (f"; paper: {f['paper_source']}" if f["paper_source"] else "")
        value = "–" if f["value"] is None else f"{f['value']:.4g}"
        rows.append(
            f"<tr><td>{escape(f['label'])}</td><td class='n'>{value}</td><td class='t'>{f['unit']}</td>"
            f"<td class='n'>{paper}</td><td class='t'>{escape(source)}</td></tr>"
        )
    head = "<tr><th>figure</th><th class='n'>value</th><th>unit</th><th class='n'>paper</th><th>from</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>"


def _table(title: str, rows: list[dict[str, Any]]) -> str:
    names = ("camera", "f, mm", "f/", "field, °", "pixel, ″", "limit V", "stars", "&lt; 3, %", "across, ″", "roll, ″")
    head = "".join(f"<th class='n'>{n}</th>" for n in names)
    body = []
    for r in rows:
        known = ["–" if v is None else f"{v:.2f}" for v in (r["cross_arcsec"], r["roll_arcsec"])]
        cells = (
            escape(r["name"]),
            f"{r['focal_mm']:.2f}",
            f"{r['f_number']:.2f}",
            f"{r['fov_deg'][0]:.1f} × {r['fov_deg'][1]:.1f}",
            f"{r['pixel_arcsec']:.1f}",
            f"{r['limit_mag']:.2f}",
            f"{r['stars']:.1f}",
            f"{100 * r['p_fewer_3']:.2f}",
            *known,
        )
        body.append("<tr>" + "".join(f"<td class='n'>{c}</td>" for c in cells) + "</tr>")
    return f"<h2>{title}</h2><table><tr>{head}</tr>{''.join(body)}</table>"


def _curve(c: dict[str, Any]) -> str:
    xs = [x for line in c["lines"] for x in line["x"]]
    ys = [y for line in c["lines"] for y in line["y"] if y is not None and (y > 0 or not c["log_y"])]
    ys += [m["y"] for m in c["marks"] if m["y"] > 0 or not c["log_y"]]
    if not ys:
        return ""
    x0, x1, y0, y1 = min(xs), max(xs), min(ys), max(ys)

    def place(x: float, y: float) -> tuple[float, float]:
        across = _share(x, x0, x1, c["log_x"]) * (WIDTH - LEFT - RIGHT)
        up = _share(y, y0, y1, c["log_y"]) * (HEIGHT - TOP - BOTTOM)
        return LEFT + across, HEIGHT - BOTTOM - up

    parts = [
        f"<rect x='{LEFT}' y='{TOP}' width='{WIDTH - LEFT - RIGHT}' height='{HEIGHT - TOP - BOTTOM}' fill='none' stroke='#c3cbd4'/>"
    ]
    for k, line in enumerate(c["lines"]):
        points = [
            place(x, y)
            for x, y in zip(line["x"], line["y"], strict=True)
            if y is not None and (y > 0 or not c["log_y"])
        ]
        path = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
        parts.append(f"<polyline points='{path}' fill='none' stroke='#0a66ad' stroke-dasharray='{DASHES[k % 3]}'/>")
    for u in c["uprights"]:
        if x0 <= u["x"] <= x1:
            a, _ = place(u["x"], y1)
            parts.append(f"<path d='M{a:.1f} {TOP}V{HEIGHT - BOTTOM}' stroke='#727e8b' stroke-dasharray='3 3'/>")
            parts.append(f"<text x='{a + 3:.1f}' y='{TOP + 11}'>{escape(u['label'])} {u['x']:.3g}</text>")
    for m in c["marks"]:
        if m["y"] > 0 or not c["log_y"]:
            a, b = place(m["x"], m["y"])
            parts.append(f"<path d='M{a:.1f} {b - 4:.1f}l4 4-4 4-4-4Z' fill='none' stroke='#7a5f00'/>")
    floor = HEIGHT - BOTTOM
    parts += [
        f"<text x='{LEFT - 4}' y='{TOP + 9}' text-anchor='end'>{y1:.3g}</text>",
        f"<text x='{LEFT - 4}' y='{floor}' text-anchor='end'>{y0:.3g}</text>",
        f"<text x='{LEFT}' y='{floor + 14}'>{x0:.3g}</text>",
        f"<text x='{WIDTH - RIGHT}' y='{floor + 14}' text-anchor='end'>{x1:.3g} {escape(c['x_label'])}</text>",
        f"<text x='{LEFT}' y='{HEIGHT - 6}'>{escape(c['y_label'])}: {escape(_key(c))}</text>",
    ]
    drawing = f"<svg width='{WIDTH:g}' height='{HEIGHT:g}' role='img'>{''.join(parts)}</svg>"
    return f"<figure><figcaption>{escape(c['title'])}</figcaption>{drawing}</figure>"


def _key(c: dict[str, Any]) -> str:
    words = ("full", "dashed", "dotted")
    lines = [f"{line['label']} {words[k % 3]}" for k, line in enumerate(c["lines"])]
    return ", ".join([*lines, *(["diamonds " + c["marks"][0]["source"]] if c["marks"] else [])])


def _share(value: float, low: float, high: float, log: bool) -> float:
    if not high > low:
        return 0.5
    return math.log(value / low) / math.log(high / low) if log else (value - low) / (high - low)


def _baffle(b: dict[str, Any]) -> str:
    outer = max(w[2] for w in b["walls_mm"])
    k = min(640 / b["length_mm"], 220 / (2 * outer))
    middle = k * outer + 10

    def wall(z: float) -> float:
        return float(next((w[2] for w in b["walls_mm"] if z <= w[1] + 1e-6), outer))

    lens = k * b["lens_radius_mm"]
    paths = [("#0a66ad", 4.0, f"M20 {middle - lens:.1f}V{middle + lens:.1f}")]
    for side in (-1, 1):
        paths += [
            ("#12171d", 1.6, f"M{20 + k * z0:.1f} {middle + side * k * r:.1f}H{20 + k * z1:.1f}")
            for z0, z1, r in b["walls_mm"]
        ]
        paths += [
            ("#12171d", 1.0, f"M{20 + k * z:.1f} {middle + side * k * wall(z):.1f}V{middle + side * k * r:.1f}")
            for z, r in b["edges_mm"]
        ]
    stages = "One stage" if b["kind"] == "one" else "Two stages"
    said = f"{stages}, {b['length_mm']:.1f} mm long, ⌀ {2 * outer:.1f} mm, keeps out from {b['exclusion_deg']:.1f}°"
    parts = [f"<path d='{d}' stroke='{ink}' stroke-width='{width:g}'/>" for ink, width, d in paths]
    drawing = f"<svg width='{60 + k * b['length_mm']:.0f}' height='{2 * middle:.0f}' role='img'>{''.join(parts)}</svg>"
    return f"<figure><figcaption>{escape(said)}</figcaption>{drawing}</figure>"
