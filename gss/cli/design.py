"""``gss design``: stars in view and attitude accuracy of a documented or edited camera. Angles are in degrees."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from gss.catalogue_tools.design.camera import LIMITS, WHOLE_NUMBERS, DesignCamera
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.cli.instruments import CAMERA_HELP, camera, registry
from gss.cli.whole_files import write_whole
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.catalogues.design import DesignQuestion
    from gss.operations.catalogues.design_values import DesignValues, TradeValues

SHEET_KINDS = (".pdf", ".html", ".json")
EDITABLE = tuple(f.name for f in fields(DesignCamera) if f.name != "name")

ORBIT = ("pointing", "raan_deg", "roll_deg", "pitch_deg", "yaw_deg")
"""Options of an orbit, which need an inclination."""


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "design",
        description="Start from a published camera and change any number. Ranges are MIN:MAX in degrees.",
    )
    parser.add_argument("--profile", metavar="INSTRUMENT", help=f"{CAMERA_HELP} (default: GSS_INSTRUMENT)")
    for name in EDITABLE:
        unit = LIMITS[name][2] if name in LIMITS else "V; default: limit from the radiometry"
        kind = int if name in WHOLE_NUMBERS else float
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, metavar="N", help=unit or None)
    parser.add_argument(
        "--exclusion-deg", type=float, metavar="N", help="angle from which the baffle blocks sources (default 40)"
    )
    parser.add_argument(
        "--spare-mm", type=float, default=0.0, metavar="N", help="widening of the baffle for misalignment"
    )
    parser.add_argument(
        "--inclination-deg", type=float, metavar="N", help="orbit inclination; without it: the whole sky"
    )
    parser.add_argument("--raan-deg", type=_range, metavar="MIN:MAX", help="right ascension of the ascending node")
    parser.add_argument("--pointing", help=f"{' | '.join(ORBIT_LAWS)} (default zenith)")
    for name in ("roll", "pitch", "yaw"):
        parser.add_argument(f"--{name}-deg", type=_range, metavar="MIN:MAX", help=f"limits of {name}")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random pointings (default 1)")
    parser.add_argument(
        "--pointings", type=int, default=1_000_000, metavar="N", help="number of pointings (default a million)"
    )
    parser.add_argument(
        "--quick", action="store_true", help="two thousand pointings instead of a million, without the lens trade"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--sheet",
        type=_sheet_file,
        metavar="FILE",
        help="write the performance sheet of the design (terms of ECSS-E-ST-60-20C): .pdf, .html or .json",
    )
    parser.add_argument("--html", type=Path, metavar="FILE", help="write a page with figures and drawings")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compute and print the design report."""
    from gss.operations.catalogues.design import answer, document_rows

    question, stars = question_of(arguments), load_stars()
    documents = document_rows(registry().cameras().values(), stars)
    base = DesignCamera.from_profile(camera(arguments.profile))
    record = answer(question, base, stars, quick=arguments.quick, documents=documents, progress=_show_progress)
    if arguments.html is not None:
        from gss.operations.catalogues.design_sheet import design_sheet
        from gss.operations.report.html import as_html

        write_whole(arguments.html, as_html(design_sheet(record)).encode())
    if arguments.sheet is not None:
        from gss.operations.clock import utc_now
        from gss.operations.studies.design_performance import sheet_file, sheet_of_design

        sheet = sheet_of_design(question, base, stars)
        write_whole(arguments.sheet, sheet_file(sheet, arguments.sheet.suffix.removeprefix("."), utc_now()))
    if arguments.json:
        print(json.dumps(record, allow_nan=False))
    else:
        print(as_text(record))
    return 0


def question_of(arguments: argparse.Namespace) -> DesignQuestion:
    """Return the request of parsed arguments."""
    from gss.operations.catalogues.design import DesignQuestion
    from gss.operations.requests import request_from

    names = ("profile", *EDITABLE, "exclusion_deg", "spare_mm", "seed", "pointings")
    values = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    orbit = {name: getattr(arguments, name) for name in ORBIT if getattr(arguments, name) is not None}
    if orbit and arguments.inclination_deg is None:
        raise BadInput(f"--{next(iter(orbit)).replace('_', '-')} needs an orbit", expected="--inclination-deg")
    if arguments.inclination_deg is not None:
        values |= {"sky": "orbit", "inclination_deg": arguments.inclination_deg, **orbit}
    return request_from(DesignQuestion, values)


def as_text(record: DesignValues) -> str:
    """Return the figures as text: value, unit, source, and the value in the camera's document."""
    changes = ", ".join(f"{k} {record['camera'][k]:g}" for k in record["changed"]) or "as in the document"
    lines = [f"{record['profile']}: {changes}; {record['sky']}, elapsed {record['elapsed_ms'] / 1000:.1f} s"]
    group = ""
    for figure in record["figures"]:
        if figure["group"] != group:
            group = figure["group"]
            lines += ["", group]
        value = "–" if figure["value"] is None else f"{figure['value']:.4g}"
        paper = "" if figure["paper"] is None else f"  paper {figure['paper']:g} ({figure['paper_source']})"
        lines.append(f"  {figure['label']:34} {value:>10} {figure['unit']:6} {figure['source']}{paper}")
    lines += ["", *_table("Cameras", record["cameras"])]
    if record["trade"]:
        lines += ["", *_table("Lenses of this camera", record["trade"])]
    lines += [""] * bool(record["notes"] or record["baffle_problem"])
    lines += [f"Note: {note}" for note in (*record["notes"], record["baffle_problem"]) if note]
    return "\n".join(lines)


def _table(title: str, rows: list[TradeValues]) -> list[str]:
    head = "camera          f mm     f/    field °       ″/px  limit V  stars  <3 %   across ″  roll ″  ½ mag °/s"
    lines = [title, "  " + head]
    for row in rows:
        field = f"{row['fov_deg'][0]:.1f} x {row['fov_deg'][1]:.1f}"
        accuracies = [f"{v:.2f}" if v is not None else "–" for v in (row["cross_arcsec"], row["roll_arcsec"])]
        lens = f"{row['name']:12} {row['focal_mm']:7.2f} {row['f_number']:6.2f}  {field:12} {row['pixel_arcsec']:6.1f}"
        figures = f"{row['limit_mag']:7.2f} {row['stars']:6.1f}  {100 * row['p_fewer_3']:5.2f}"
        lines.append(f"  {lens}  {figures}  {accuracies[0]:>8} {accuracies[1]:>7}  {row['blur_rate_deg_s']:9.3f}")
    return lines


def _sheet_file(name: str) -> Path:
    path = Path(name)
    if path.suffix not in SHEET_KINDS:
        raise argparse.ArgumentTypeError(f"unknown file format: {name}; expected {' | '.join(SHEET_KINDS)}")
    return path


def _range(text: str) -> list[float]:
    low, _, high = text.partition(":")
    try:
        return [float(low), float(high or low)]
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected MIN:MAX in degrees, got {text}") from None


def _show_progress(done: int, total: int, text: str) -> None:
    if sys.stderr.isatty():
        print(
            f"\r{text}, {100 * done // max(1, total)} % ",
            end="\n" if done >= total else "",
            file=sys.stderr,
            flush=True,
        )
