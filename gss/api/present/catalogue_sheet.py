"""Quality report of a catalogue for reading and printing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gss.operations.report.parts import Fact, Level, Number, Plot, Report, Section, Series, Shares, SkyMap, Table

NEEDED_STARS = 5
UNBOUNDED = 1e6
SHOWN_STARS = 60
ARCSEC_RAD = math.pi / 648_000
UNKNOWN = "Unknown: the catalogue was not built here."


def catalogue_sheet(manifest: Mapping[str, Any], report: Mapping[str, Any]) -> Report:
    """Return the report. ``report``: values from ``operations.catalogues.catalogue_report``; missing parts are shown as
    unknown."""
    return Report(
        f"Catalogue {manifest.get('name') or manifest.get('image_sha256', '')[:8] or 'without a name'}",
        _byline(manifest),
        [
            Section("Figures", facts=_figures(manifest, report)),
            _histogram(report) or Section("Stars per field", UNKNOWN),
            _envelope(report) or Section("Envelope", UNKNOWN),
            _ambiguity(report) or Section("Ambiguity of the stars", UNKNOWN),
            _lifetime(report) or Section("Lifetime", UNKNOWN),
            _bank(report) or Section("Bank", UNKNOWN),
            _funnel(report) or Section("From catalogue to bank", UNKNOWN),
            _screening(manifest),
            _corrections(manifest),
            _quantisation(manifest) or Section("Number widths on board", UNKNOWN),
            _source(manifest) or Section("Source", UNKNOWN),
            Section("Request", facts=_flat(manifest.get("parameters", {}))),
        ],
    )


def _byline(manifest: Mapping[str, Any]) -> str:
    parts = [
        f"camera {manifest.get('profile_name', 'unknown')}",
        f"format {manifest.get('format_name', 'unknown')}",
        _validity(manifest),
        f"by {manifest.get('author') or 'unknown author'}",
        str(manifest.get("tool", "")),
        f"SHA-256 {manifest.get('image_sha256', 'unknown')}",
    ]
    return ", ".join(part for part in parts if part)


def _validity(manifest: Mapping[str, Any]) -> str:
    if "valid_to" not in manifest:
        return "validity unknown"
    start, end = str(manifest.get("valid_from") or "")[:16], str(manifest.get("valid_to") or "")[:16]
    return f"valid {start} to {end} UTC" if end else "no end of validity"


def _figures(manifest: Mapping[str, Any], report: Mapping[str, Any]) -> list[Fact]:
    counts, quality = manifest.get("counts", {}), report.get("quality") or {}
    facts = [
        ("stars", f"{counts.get('stars', '–')}"),
        ("pairs", f"{counts.get('pairs', '–')}"),
        ("epoch", _number(manifest.get("epoch_jyear"), 4)),
        ("frame", str(manifest.get("frame", "–"))),
    ]
    if quality:
        facts += [
            ("mean stars per field", f"{quality['mean']:.2f}"),
            ("P(fewer than 3)", f"{100 * quality['p_fewer_than_3']:.3f} %"),
            ("P(fewer than 5)", f"{100 * quality['p_fewer_than_5']:.3f} %"),
            (
                "fewest stars",
                f"{quality['worst_stars']} at {quality['worst_ra_deg']:.2f}° {quality['worst_dec_deg']:+.2f}°",
            ),
            ("candidates per query", _number(quality.get("candidates_per_query"), 2)),
            ("candidates per star", _number(quality.get("candidates_per_star"), 2)),
            ("fields with a bright body", f"{100 * (quality.get('blinded_share') or 0.0):.2f} %"),
        ]
    return [Fact(*fact) for fact in facts]


def _histogram(report: Mapping[str, Any]) -> Section | None:
    quality = report.get("quality")
    if not quality:
        return None
    edges, counts = [float(k) for k in range(len(quality["histogram"]) + 1)], [float(n) for n in quality["histogram"]]
    few = Series(f"fewer than {NEEDED_STARS}", edges[: NEEDED_STARS + 1], list(counts[:NEEDED_STARS]), "bars")
    enough = Series("enough", edges[NEEDED_STARS:], list(counts[NEEDED_STARS:]), "bars")
    mean = Level(quality["mean"] + 0.5, f"mean {quality['mean']:.1f}", vertical=True)
    caption = f"{quality['pointings']} random pointings within the limits."
    plot = Plot("Stars per field", "stars in the field", "fields", [enough, few], [mean])
    return Section("Stars per field", caption, drawings=[plot])


def _envelope(report: Mapping[str, Any]) -> Section | None:
    envelope, quality = report.get("envelope"), report.get("quality")
    if not envelope:
        return None
    peak = 100 * max(envelope["fraction"], default=0.0)
    sky_map = SkyMap(
        "Share of time in the field",
        envelope["nside"],
        list(envelope["fraction"]),
        f"darkest {peak:.2g} %; edge at the start solid, at the end dashed; ICRS, Mollweide",
        [(s["ra_deg"], s["dec_deg"], s["v_mag"]) for s in report.get("sky", []) if s["state"] == "kept"],
        envelope["outline_start"],
        envelope["outline_end"],
        (quality["worst_ra_deg"], quality["worst_dec_deg"], f"fewest stars: {quality['worst_stars']}")
        if quality
        else None,
    )
    return Section("Envelope", drawings=[sky_map])


def _ambiguity(report: Mapping[str, Any]) -> Section | None:
    ambiguity = report.get("ambiguity")
    if not ambiguity:
        return None
    caption = f"Other triangles similar to one of the brightest stars of the field, within {ambiguity['tolerance_arcsec']:.0f}″."
    if ambiguity.get("worst") is not None and ambiguity["worst"] < UNBOUNDED:
        caption += (
            f" Most: {ambiguity['worst']:.3g} at {ambiguity['worst_ra_deg']:.1f}° {ambiguity['worst_dec_deg']:+.1f}°."
        )
    tones = [_decades(v) for v in ambiguity["value"]]
    sky_map = SkyMap("Other triangles per triangle", ambiguity["nside"], tones, "0.001 to 100 by tone")
    return Section("Ambiguity of the stars", caption, drawings=[sky_map])


def _decades(value: Number) -> Number:
    """Return the tone of a value on a logarithmic scale: 0.001 to 100 maps to 0 to 1."""
    return None if not value else min(1.0, max(0.0, (math.log10(value) + 3) / 5))


def _lifetime(report: Mapping[str, Any]) -> Section | None:
    life = report.get("lifetime")
    if not life:
        return None
    until = f"until {life['until'][:10]}" if life.get("until") else "beyond the examined period"
    if not life["days_curve"]:
        return Section("Lifetime", "The field does not drift.")
    shares = [None if y is None else 100 * y for y in life["share_curve"]]
    line = Level(100 * life["threshold"], f"{life['threshold']:.0%} {until}")
    series = Series("covered", list(life["days_curve"]), shares)
    plot = Plot("Fields inside the envelope", "days after the end of validity", "%", [series], [line])
    return Section("Lifetime", drawings=[plot])


def _bank(report: Mapping[str, Any]) -> Section | None:
    sizes = report.get("sizes")
    if not sizes:
        return None
    parts, bank_bytes = list(sizes["by_part"].items()), float(sizes["bank_bytes"])
    used = sum(size for _, size in parts)
    caption = f"{used:.0f} of {bank_bytes:.0f} bytes, {bank_bytes - used:.0f} free."
    return Section("Bank", caption, drawings=[Shares("Bytes of the bank", parts, bank_bytes, "B")])


def _funnel(report: Mapping[str, Any]) -> Section | None:
    rows = [[f["label"], f"{-f['stars'] if f['kind'] == 'drop' else f['stars']}"] for f in report.get("funnel", [])]
    return _listed("From catalogue to bank", ("step", "stars"), rows) if rows else None


def _screening(manifest: Mapping[str, Any]) -> Section:
    screening = (manifest.get("assessment") or {}).get("screening")
    if not screening:
        return Section("Screening list", "Not requested.")
    rows = [[reason, str(stars)] for reason, stars in screening["counts"].items()]
    star_rows = [
        [f"HIP {s['hip']}", ", ".join(s["reasons"]), str(s["companions"]), "kept" if s["kept"] else "left out"]
        for s in screening["stars"][:SHOWN_STARS]
    ]
    ring = f"mean {_number(screening['mean_companions'], 2)}, most {_number(screening['most_companions'], 0)}"
    tables = [Table("", ["reason", "stars in the envelope"], rows)]
    tables += [Table("Stars", ["star", "reasons", "in its ring", ""], star_rows)] if star_rows else []
    facts = [Fact("stars in the ring of each", ring), Fact("chance of a third star", _short(screening["third"]))]
    return Section("Screening list", facts=facts, tables=tables)


def _corrections(manifest: Mapping[str, Any]) -> Section:
    facts = manifest.get("corrections") or {}
    if not facts:
        old = "Proper motion to the epoch. The manifest has version 1 and lists no other corrections."
        return Section("Corrections", old if manifest.get("tool") else UNKNOWN)
    rows = [
        [str(a.get("name")), f"{a.get('stars', '–')}", f"{_short(a.get('largest'))} {a.get('unit', '')}"]
        for a in facts.get("applied", [])
    ]
    return _listed("Corrections", ("correction", "stars", "largest"), rows)


def _quantisation(manifest: Mapping[str, Any]) -> Section | None:
    quantisation = manifest.get("quantisation")
    if not quantisation:
        return None
    facts = [
        Fact("worst position", _arcsec(quantisation.get("position_rad"))),
        Fact("worst distance", _arcsec(quantisation.get("distance_rad"))),
        Fact("worst magnitude", _number(quantisation.get("v_mag"), 6)),
    ]
    return Section("Number widths on board", facts=facts)


def _source(manifest: Mapping[str, Any]) -> Section | None:
    facts = [Fact("catalogue", str(manifest["source"]))] if manifest.get("source") else []
    facts += _flat(manifest.get("source_facts") or {})
    if not facts:
        return None
    return Section("Source", facts=[*facts, Fact("table SHA-256", str(manifest.get("star_table_sha256", "–")))])


def _listed(title: str, columns: Sequence[str], rows: list[list[str]]) -> Section:
    return Section(title, tables=[Table("", list(columns), rows)])


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[Fact]:
    """Flatten nested values to facts. Values whose names end in ``_rad`` are shown in degrees."""
    facts: list[Fact] = []
    for name, value in values.items():
        label = f"{prefix}{name}"
        if isinstance(value, Mapping):
            facts += _flat(value, f"{label}.")
        elif name.endswith("_rad") and value is not None:
            degrees = [math.degrees(v) for v in (value if isinstance(value, list | tuple) else [value])]
            facts.append(Fact(label.removesuffix("_rad"), " to ".join(f"{d:.4g}°" for d in degrees)))
        elif value not in (None, "", [], {}):
            facts.append(Fact(label, str(value)[:200]))
    return facts


def _number(value: Any, decimals: int) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else str(value if value is not None else "–")


def _arcsec(angle_rad: Any) -> str:
    return "–" if angle_rad is None else f"{angle_rad / ARCSEC_RAD:.3g}″"
