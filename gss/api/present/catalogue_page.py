"""The quality report of a catalogue as one page to read and to print: no scripts, nothing from elsewhere, drawings inside."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

from gss.api.present import sky_svg
from gss.api.present.contact_page import STYLE

NEED = 5
ENDLESS = 1e6
SHOWN_STARS = 60
ARCSEC_RAD = math.pi / 648_000


def catalogue_page(manifest: Mapping[str, Any], report: Mapping[str, Any]) -> str:
    """The whole page. ``report``: plain values as ``operations.catalogues.catalogue_report`` makes them; what is missing is
    said."""
    title = f"Catalogue {manifest.get('name') or manifest.get('image_sha256', '')[:8] or 'without a name'}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p class='soft'>{escape(_byline(manifest))}</p>",
        "<h2>Figures</h2>",
        _facts(_figures(manifest, report)),
        *_section("Stars per field", _histogram(report)),
        *_section("Envelope", _envelope(report)),
        *_section("Where stars can be mistaken", _ambiguity(report)),
        *_section("Lifetime", _lifetime(report)),
        *_section("Bank", _bank(report)),
        *_section("From catalogue to bank", _funnel(report)),
        *_section("Screening list", _screening(manifest)),
        *_section("Corrections", _corrections(manifest)),
        *_section("Number widths on board", _quantisation(manifest)),
        *_section("Source", _source(manifest)),
        "<h2>Asked for</h2>",
        _facts(_flat(manifest.get("parameters", {}))) or "<p class='soft'>Not known.</p>",
    ]
    head = f"<meta charset='utf-8'><title>{escape(title)}</title><style>{STYLE}</style>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{''.join(parts)}</body></html>"


def _section(title: str, body: str) -> tuple[str, str]:
    return f"<h2>{escape(title)}</h2>", body or "<p class='soft'>Not known: the catalogue was not built here.</p>"


def _byline(m: Mapping[str, Any]) -> str:
    words = [
        f"camera {m.get('profile_name', 'not told')}",
        f"format {m.get('format_name', 'not told')}",
        _validity(m),
        f"by {m.get('author') or 'nobody named'}",
        str(m.get("tool", "")),
        f"SHA-256 {m.get('image_sha256', 'not told')}",
    ]
    return ", ".join(word for word in words if word)


def _validity(m: Mapping[str, Any]) -> str:
    start, end = str(m.get("valid_from") or "")[:16], str(m.get("valid_to") or "")[:16]
    return f"valid {start} to {end} UTC" if end else "no end of validity"


def _figures(m: Mapping[str, Any], report: Mapping[str, Any]) -> list[tuple[str, str]]:
    counts, q = m.get("counts", {}), report.get("quality") or {}
    facts = [
        ("stars", f"{counts.get('stars', '–')}"),
        ("pairs", f"{counts.get('pairs', '–')}"),
        ("epoch", _number(m.get("epoch_jyear"), 4)),
        ("frame", str(m.get("frame", "–"))),
    ]
    if q:
        facts += [
            ("mean stars per field", f"{q['mean']:.2f}"),
            ("P(fewer than 3)", f"{100 * q['p_fewer_than_3']:.3f} %"),
            ("P(fewer than 5)", f"{100 * q['p_fewer_than_5']:.3f} %"),
            ("fewest stars found", f"{q['worst_stars']} at {q['worst_ra_deg']:.2f}° {q['worst_dec_deg']:+.2f}°"),
            ("candidates per query", _number(q.get("candidates_per_query"), 2)),
            ("candidates per star", _number(q.get("candidates_per_star"), 2)),
            ("fields blinded", f"{100 * (q.get('blinded_share') or 0.0):.2f} %"),
        ]
    return facts


def _histogram(report: Mapping[str, Any]) -> str:
    q = report.get("quality")
    if not q:
        return ""
    words = f"{q['pointings']} random pointings within the limits; fewer than {NEED} stars in another colour"
    return _figure(sky_svg.bars(q["histogram"], "Stars per field", need=NEED, mean=q["mean"]), words)


def _envelope(report: Mapping[str, Any]) -> str:
    e, q = report.get("envelope"), report.get("quality")
    if not e:
        return ""
    stars = [(s["ra_deg"], s["dec_deg"], s["v_mag"]) for s in report.get("sky", []) if s["state"] == "kept"]
    lines = [("", line) for line in e["outline_start"]] + [("5 4", line) for line in e["outline_end"]]
    mark = (q["worst_ra_deg"], q["worst_dec_deg"], f"fewest stars: {q['worst_stars']}") if q else None
    drawn = sky_svg.sky_map(e["nside"], e["fraction"], "Envelope", stars=stars, lines=lines, mark=mark)
    peak = 100 * max(e["fraction"], default=0.0)
    words = (
        f"Share of time in the field, darkest {peak:.2g} %; edge at the start solid, at the end dashed; ICRS, Mollweide"
    )
    return _figure(drawn, words)


def _ambiguity(report: Mapping[str, Any]) -> str:
    a = report.get("ambiguity")
    if not a:
        return ""
    drawn = sky_svg.sky_map(a["nside"], [_decades(v) for v in a["value"]], "Other triangles per triangle")
    words = (
        f"Other triangles like one of the field's brightest, within {a['tolerance_arcsec']:.0f}″, 0.001 to 100 by tone"
    )
    if a.get("worst") is not None and a["worst"] < ENDLESS:
        words += f"; most {a['worst']:.3g} at {a['worst_ra_deg']:.1f}° {a['worst_dec_deg']:+.1f}°"
    return _figure(drawn, words)


def _decades(value: float | None) -> float | None:
    """Tone on a scale of five decades from a thousandth."""
    return None if not value else min(1.0, max(0.0, (math.log10(value) + 3) / 5))


def _lifetime(report: Mapping[str, Any]) -> str:
    life = report.get("lifetime")
    if not life:
        return ""
    until = f"until {life['until'][:10]}" if life.get("until") else "longer than was looked at"
    if not life["days_curve"]:
        return "<p>Nothing drifts: the field stays.</p>"
    drawn = sky_svg.curve(life["days_curve"], life["share_curve"], "Share of fields covered", "days", life["threshold"])
    words = f"Share of the fields still inside the envelope, days after the end of validity; {life['threshold']:.0%} {until}"
    return _figure(drawn, words)


def _bank(report: Mapping[str, Any]) -> str:
    sizes = report.get("sizes")
    if not sizes:
        return ""
    parts, whole = list(sizes["by_part"].items()), float(sizes["bank_bytes"])
    used = sum(size for _, size in parts)
    return _figure(
        sky_svg.share_bar(parts, whole, "Bytes of the bank"),
        f"{used:.0f} of {whole:.0f} bytes, {whole - used:.0f} free",
    )


def _funnel(report: Mapping[str, Any]) -> str:
    rows = [(f["label"], f"{-f['stars'] if f['kind'] == 'drop' else f['stars']}") for f in report.get("funnel", [])]
    return _table(("step", "stars"), rows) if rows else ""


def _screening(m: Mapping[str, Any]) -> str:
    found = (m.get("assessment") or {}).get("screening")
    if not found:
        return "<p class='soft'>Not asked for.</p>"
    rows = [(reason, str(stars)) for reason, stars in found["counts"].items()]
    named = [
        (f"HIP {s['hip']}", ", ".join(s["reasons"]), str(s["companions"]), "kept" if s["kept"] else "left out")
        for s in found["stars"][:SHOWN_STARS]
    ]
    ring = f"mean {_number(found['mean_companions'], 2)}, most {_number(found['most_companions'], 0)}"
    return (
        _table(("reason", "stars in the envelope"), rows)
        + _facts([("stars in the ring of each", ring), ("chance of a third star", _short(found["third"]))])
        + (_table(("star", "reasons", "in its ring", ""), named) if named else "")
    )


def _corrections(m: Mapping[str, Any]) -> str:
    facts = m.get("corrections") or {}
    applied = facts.get("applied", [])
    if not facts:
        return (
            "<p>Proper motion to the epoch; the manifest is of version 1 and names no others.</p>"
            if m.get("tool")
            else ""
        )
    rows = [
        (str(a.get("name")), f"{a.get('stars', '–')}", f"{_short(a.get('largest'))} {a.get('unit', '')}")
        for a in applied
    ]
    return _table(("correction", "stars", "largest"), rows) if rows else "<p>None.</p>"


def _quantisation(m: Mapping[str, Any]) -> str:
    q = m.get("quantisation")
    if not q:
        return ""
    return _facts(
        [
            ("worst position", _arcsec(q.get("position_rad"))),
            ("worst distance", _arcsec(q.get("distance_rad"))),
            ("worst magnitude", _number(q.get("v_mag"), 6)),
        ]
    )


def _source(m: Mapping[str, Any]) -> str:
    facts = [("catalogue", str(m["source"]))] if m.get("source") else []
    facts += _flat(m.get("source_facts") or {})
    return _facts([*facts, ("table SHA-256", str(m.get("star_table_sha256", "–")))]) if facts else ""


def _flat(values: Mapping[str, Any], before: str = "") -> list[tuple[str, str]]:
    """Nested plain values as lines; angles in radians say so in their names and get their degrees."""
    found: list[tuple[str, str]] = []
    for name, value in values.items():
        label = f"{before}{name}"
        if isinstance(value, Mapping):
            found += _flat(value, f"{label}.")
        elif name.endswith("_rad") and value is not None:
            degrees = [math.degrees(v) for v in (value if isinstance(value, list | tuple) else [value])]
            found.append((label.removesuffix("_rad"), " to ".join(f"{d:.4g}°" for d in degrees)))
        elif value not in (None, "", [], {}):
            found.append((label, str(value)[:200]))
    return found


def _figure(svg: str, words: str) -> str:
    return f"<figure>{svg}<figcaption>{escape(words)}</figcaption></figure>"


def _facts(facts: Iterable[tuple[str, str]]) -> str:
    rows = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in facts)
    return f"<dl class='facts'>{rows}</dl>" if rows else ""


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _number(value: Any, decimals: int) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else str(value if value is not None else "–")


def _arcsec(angle_rad: Any) -> str:
    return "–" if angle_rad is None else f"{angle_rad / ARCSEC_RAD:.3g}″"
