"""Report of a stored calibration: results, comparison before and after, and warnings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from gss.operations.report.figures import number
from gss.operations.report.parts import (
    Arrows,
    Cells,
    Drawing,
    Fact,
    Note,
    Picture,
    Plot,
    Report,
    Section,
    Series,
    Table,
)
from gss.operations.studies.bench_sheet import BENCH
from gss.store.models import Calibration

ARROW_CELL_SHARE = 0.9
"""Length of the longest arrow in a map as a share of a cell."""


def calibration_sheet(row: Calibration) -> Report:
    """Return the report of a calibration."""
    result = row.result
    makers = {
        "health": _health,
        "geometry": _geometry,
        "photometry": _photometry,
        "psf": _psf,
        "dark_frame": _dark_frame,
        "dark": _dark,
        "photon_transfer": _photon_transfer,
        "response": _dead,
    } | BENCH
    sections = [section for name, make in makers.items() if name in result for section in make(result[name])]
    sections += _account(result)
    notes = [Note(w["text"], w["hint"], w["severe"], w["code"]) for w in result.get("warnings", [])]
    for name, title in (
        ("photometry_problem", "magnitudes were not calibrated"),
        ("psf_problem", "spots were not measured"),
    ):
        if name in result:
            notes.append(Note(f"{title}: {result[name]}"))
    author = f"by {row.author}" if row.author else ""
    subtitle = ", ".join(part for part in (row.name, f"{row.created:%Y-%m-%d %H:%M}Z", author, row.tool) if part)
    title = f"Calibration {row.id} of {row.profile}" if row.id else f"Calibration of {row.profile}"  # 0: not stored
    return Report(title, subtitle, sections, notes)


def _health(health: Mapping[str, Any]) -> list[Section]:
    """Return the changes that a health analysis proposes."""
    rows = [
        [
            c["name"],
            number(c["old"], 7),
            number(c["new"]["value"], 7),
            f"{number(c['new']['low'], 7)} – {number(c['new']['high'], 7)}",
            c["unit"],
        ]
        for c in health["changes"]
    ]
    text = "Proposed from the trends of ordinary frames. All other values are unchanged."
    table = Table("Changes", ["value", "before", "after", "95 %", "unit"], rows)
    return [Section("Health of the sensor", text, [], [], [table])]


# --- geometry -------------------------------------------------------------------------------------------------------


def _geometry(geometry: Mapping[str, Any]) -> list[Section]:
    after, before, held_out = geometry["residuals"], geometry["before"], geometry["held_out"]
    facts = [
        Fact("lens model", str(geometry["model"])),
        Fact("residual before", number(before["rms_px"]), "px", "rms per axis"),
        Fact("residual after", number(after["rms_px"]), "px", "rms per axis"),
        Fact("scatter of one star", number(after["noise_px"]), "px", "corrected for degrees of freedom"),
        Fact("leave-one-out over frames", number(held_out["noise_px"] if held_out else None), "px", "held-out stars"),
        Fact("stars used", number(after["stars"]), "", f"{after['rejected']} rejected"),
    ]
    columns, rows = geometry["camera"]["columns"], geometry["camera"]["rows"]
    scale = _arrow_scale(geometry["before_map"], columns)
    tables = [
        Table(
            "Parameters",
            ["name", "value", "σ", "unit"],
            [[p["name"], number(p["value"], 8), number(p["sigma"], 2), p["unit"]] for p in geometry["parameters"]],
        )
    ]
    if geometry["frozen"]:
        rows_held = [[f["name"], number(f["value"], 6), f["reason"]] for f in geometry["frozen"]]
        tables.append(Table("Fixed: not determined by the data", ["name", "value", "reason"], rows_held))
    tables.append(
        Table(
            "Lens models on the same stars",
            ["model", "parameters", "BIC", "AICc", "rms px", "left-out px", ""],
            [
                [
                    m["model"],
                    number(m["free_parameters"]),
                    number(m["bic"]),
                    number(m["aicc"]),
                    number(m["rms_px"]),
                    number(m["held_out_px"]),
                    "chosen" if m["chosen"] else "",
                ]
                for m in geometry["comparison"]
            ],
        )
    )
    maps: list[Drawing] = [
        _arrows("Residuals before", geometry["before_map"], columns, rows, scale),
        _arrows("Residuals after, same scale", geometry["after_map"], columns, rows, scale),
        Cells("Residuals after, rms px", columns, rows, geometry["after_map"]["rms_px"], "px"),
        _against_radius(geometry),
    ]
    return [Section("Geometry", "", facts, maps, tables)]


def _arrow_scale(field: Mapping[str, Any], columns: int) -> float:
    lengths = [(c[0] ** 2 + c[1] ** 2) ** 0.5 for line in field["mean_px"] for c in line if None not in (c[0], c[1])]
    cell = columns / max(1, len(field["col_px"]))
    longest = max(lengths, default=0.0)
    return ARROW_CELL_SHARE * cell / longest if longest > 0 else 1.0


def _arrows(title: str, field: Mapping[str, Any], columns: int, rows: int, scale: float) -> Arrows:
    means = [
        (c, r, cell)
        for r, line in zip(field["row_px"], field["mean_px"], strict=True)
        for c, cell in zip(field["col_px"], line, strict=True)
    ]
    return Arrows(
        title,
        columns,
        rows,
        [c for c, _, _ in means],
        [r for _, r, _ in means],
        [cell[0] for _, _, cell in means],
        [cell[1] for _, _, cell in means],
        scale,
        "mean of each cell",
    )


def _against_radius(geometry: Mapping[str, Any]) -> Plot:
    camera, stars = geometry["camera"], geometry["stars"]
    radius = [
        ((c - camera["centre_col_px"]) ** 2 + (r - camera["centre_row_px"]) ** 2) ** 0.5 for c, r in stars["pixels"]
    ]
    return Plot(
        "Residual of each star against its distance from the optical centre",
        "distance, px",
        "residual, px",
        [
            Series("before", radius, [_length(v) for v in stars["before_px"]], "dots"),
            Series("after", radius, [_length(v) for v in stars["residual_px"]], "dots"),
        ],
    )


def _length(vector: Sequence[float | None]) -> float | None:
    x, y = vector
    return None if x is None or y is None else (x * x + y * y) ** 0.5


# --- photometry and spots -------------------------------------------------------------------------------------------


def _photometry(photometry: Mapping[str, Any]) -> list[Section]:
    vignetting = Fact("vignetting in the corner", "not determined")
    if photometry["corner_loss_sigma"] is not None:
        sigma = f"σ {number(_percent(photometry['corner_loss_sigma']), 2)} %"
        vignetting = replace(vignetting, value=number(_percent(photometry["corner_loss"]), 3), unit="%", note=sigma)
    facts = [
        Fact(
            "zero point",
            number(photometry["zero_point_mag"]),
            "mag",
            f"V of 1 DN/s, σ {number(photometry['zero_point_sigma_mag'], 2)}",
        ),
        Fact(
            "colour term",
            number(photometry["colour_mag_per_mag"], 3),
            "mag/mag",
            f"of B−V, σ {number(photometry['colour_sigma'], 2)}",
        ),
        vignetting,
        Fact(
            "linearity",
            number(photometry["linearity"]),
            "",
            f"1 is linear, σ {number(photometry['linearity_sigma'], 2)}",
        ),
        Fact("saturation", number(photometry["saturation_mag"], 3), "mag"),
        Fact(
            "magnitude error", number(photometry["robust_sigma_mag"], 3), "mag", "σ of one star; Jacobs 1995 §6.3: 0.2"
        ),
        Fact("k_illum", number(photometry["k_illum_lux_per_dn"], 3), "lux/DN", "Jacobs 1995 eq. 6.24"),
        Fact("k_area", number(photometry["k_area"], 3), "mag", f"σ {number(photometry['k_area_sigma'], 2)}"),
    ]
    histogram = photometry["histogram"]
    drawings: list[Drawing] = [
        Plot(
            "Magnitude error",
            "measured − catalogue, mag",
            "stars",
            [Series("stars", histogram["edges"], histogram["counts"], "bars")],
        ),
        Plot(
            "Magnitude error against magnitude",
            "V",
            "mag",
            [Series("stars", photometry["v_mag"], photometry["error_mag"], "dots")],
        ),
    ]
    return [Section("Magnitudes", "", facts, drawings)]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _psf(psf: Mapping[str, Any]) -> list[Section]:
    field, focus = psf["field"], psf["focus"]
    facts = [
        Fact("σ in the middle", number(field["centre_sigma_px"], 3), "px"),
        Fact("σ in the corner", number(field["corner_sigma_px"], 3), "px"),
        Fact("pixel over σ", number(focus["pixel_over_sigma"], 3), "", "Moniteq 1983 §4.2: 2 to 2.5"),
        Fact("focus", str(focus["verdict"])),
    ]
    return [Section("Spots", f"{focus['text']} {focus['hint']}".strip(), facts)]


# --- detector -------------------------------------------------------------------------------------------------------


def _dark(dark: Mapping[str, Any]) -> list[Section]:
    facts = [
        Fact("frames", number(dark["frames"])),
        Fact("noise", number(dark["noise_dn"]), "DN"),
        Fact("fixed pattern", number(dark["pattern_sigma_dn"]), "DN", "σ over the pixels"),
        Fact("columns", number(dark["column_sigma_dn"]), "DN"),
        Fact("rows", number(dark["row_sigma_dn"]), "DN"),
        Fact("hot pixels", number(dark["hot_count"])),
        Fact("noisy pixels", number(dark["noisy_count"])),
    ]
    rows = [
        [number(int(c)), number(int(r)), number(e)]
        for (c, r), e in zip(dark["hot"], dark["hot_excess_dn"], strict=True)
    ]
    hottest = [Table("Hottest pixels", ["column", "row", "DN above"], rows[:12])] if rows else []
    return [Section("Dark frames", "", facts, [], hottest)]


def _photon_transfer(transfer: Mapping[str, Any]) -> list[Section]:
    read_noise = Fact("read noise", "not determined")
    if transfer["read_noise_e"] is not None:
        sigma = f"σ {number(transfer['read_noise_sigma_e'], 2)}"
        read_noise = Fact("read noise", number(transfer["read_noise_e"]), "e⁻", sigma)
    facts = [
        Fact("gain", number(transfer["gain_e_per_dn"]), "e⁻/DN", f"σ {number(transfer['gain_sigma'], 2)}"),
        read_noise,
        Fact("bias", number(transfer["bias_dn"]), "DN"),
        Fact("response of the pixels", number(_percent(transfer["response_sigma"]), 3), "%", "σ"),
        Fact("full well", number(transfer["full_well_e"], 5), "e⁻"),
    ]
    curve = Plot(
        "Photon transfer",
        "signal, DN",
        "variance, DN²",
        [Series("pairs", transfer["signal_dn"], transfer["variance_dn2"], "dots")],
    )
    return [Section("Photon transfer", "", facts, [curve])]


def _dead(dark: Mapping[str, Any]) -> list[Section]:
    rows = [[number(int(c)), number(int(r))] for c, r in dark["dead"][:40]]
    facts = [Fact("pixels without light", number(dark["dead_count"]))]
    return [
        Section("Dead pixels", "", facts, [], [Table("First dead pixels", ["column", "row"], rows)] if rows else [])
    ]


def _dark_frame(dark: Any) -> list[Section]:
    """Describe the dark frame that reruns subtract. A calibration from stars only states that a dark frame was used."""
    if not isinstance(dark, Mapping):
        return [Section("Dark frame", "The active dark frame was applied to the frames.")]
    picture = dark["picture"]
    replaced = Fact("pixels replaced", number(dark["bad"]), "", "hot, noisy or dead: the median of their neighbours")
    if picture is None:
        return [Section("Bad pixels", "No dark frame is subtracted.", [replaced])]
    facts = [
        Fact(
            "exposure",
            number(dark["exposure_s"], 3),
            "s",
            "the pattern is subtracted from frames whose exposure is within 20 %",
        ),
        replaced,
    ]
    low_dn, high_dn = number(picture["low_dn"], 3), number(picture["high_dn"], 3)
    caption = f"black {low_dn} DN, white {high_dn} DN or more, relative to the typical pixel"
    return [Section("Dark frame", "", facts, [Picture("Median dark frame", picture["png"], caption)])]


def _account(result: Mapping[str, Any]) -> list[Section]:
    """Return a table of the frames, with the reason for each unused frame."""
    fits = {f["name"]: f for f in result.get("geometry", {}).get("frames", [])}
    rows = []
    for entry in result.get("account", []):
        fit = fits.get(entry["name"])
        reason = entry["reason"] or (fit["excluded"] if fit else "")
        rows.append(
            [
                entry["name"],
                number(fit["stars"]) if fit else "–",
                number(fit["rms_px"], 3) if fit else "–",
                number(fit["scale"], 6) if fit else "–",
                reason or "used",
            ]
        )
    if not rows:
        return []
    return [Section("Frames", "", [], [], [Table("Frames", ["frame", "stars", "rms px", "scale", ""], rows)])]
