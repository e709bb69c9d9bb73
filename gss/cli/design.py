"""``gss design``: what a documented or edited camera would see, and how accurate its attitude would be. Angles are in degrees."""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gss.catalogue_tools.design.camera import LIMITS, WHOLE, DesignCamera
from gss.catalogue_tools.envelope.attitude import ORBIT_LAWS
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.domain.profiles import PROFILES

if TYPE_CHECKING:
    from gss.cli import Commands

EDITABLE = tuple(f.name for f in fields(DesignCamera) if f.name != "name")


def register(subparsers: Commands) -> None:
    """Add the command."""
    p = subparsers.add_parser(
        "design",
        description="Starts from a document's camera; every number of it can be changed. Ranges are MIN:MAX in degrees.",
    )
    p.add_argument("--profile", default="cubestar", help=" | ".join(PROFILES))
    for name in EDITABLE:
        unit = LIMITS[name][2] if name in LIMITS else "V; default: what the radiometry allows"
        kind = int if name in WHOLE else float
        p.add_argument(f"--{name.replace('_', '-')}", type=kind, metavar="N", help=unit or None)
    p.add_argument(
        "--exclusion-deg", type=float, metavar="N", help="the baffle keeps out sources from here (default 40)"
    )
    p.add_argument("--spare-mm", type=float, default=0.0, metavar="N", help="widening of the baffle for misalignment")
    p.add_argument("--inclination-deg", type=float, metavar="N", help="fly along an orbit instead of the whole sky")
    p.add_argument("--raan-deg", type=_range, default=(0.0, 360.0), metavar="MIN:MAX", help="of the ascending node")
    p.add_argument("--pointing", default="zenith", help=f"{' | '.join(ORBIT_LAWS)} (default zenith)")
    for name in ("roll", "pitch", "yaw"):
        p.add_argument(f"--{name}-deg", type=_range, default=(0.0, 0.0), metavar="MIN:MAX", help=f"limits of {name}")
    p.add_argument("--seed", type=int, default=1, help="of every pointing (default 1)")
    p.add_argument("--pointings", type=int, default=1_000_000, metavar="N", help="fields counted (default a million)")
    p.add_argument("--quick", action="store_true", help="two thousand pointings instead of a million, no lens trade")
    p.add_argument("--json", action="store_true", help="print one JSON object")
    p.add_argument("--html", type=Path, metavar="FILE", help="write a page of figures and drawings")
    p.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compute and print the design report."""
    from gss.operations.catalogues.design import answer

    question = question_of(arguments)
    record = answer(question, load_stars(), quick=arguments.quick, progress=_told)
    if arguments.html is not None:
        from gss.operations.catalogues.design_sheet import design_sheet
        from gss.operations.report.html import as_html

        arguments.html.write_text(as_html(design_sheet(record)), "utf-8")
    if arguments.json:
        print(json.dumps(record, ensure_ascii=False, allow_nan=False))
    else:
        print(as_text(record))
    return 0


def question_of(arguments: argparse.Namespace) -> Any:
    """Return the request of parsed arguments; converts degrees to radians."""
    from gss.operations.catalogues.design import Along, Question, radians

    changes = {name: getattr(arguments, name) for name in EDITABLE if getattr(arguments, name) is not None}
    along = None
    if arguments.inclination_deg is not None:
        inclination = math.radians(arguments.inclination_deg)
        limits = [radians(getattr(arguments, f"{name}_deg")) for name in ("roll", "pitch", "yaw")]
        along = Along((inclination, inclination), radians(arguments.raan_deg), arguments.pointing, *limits)
    exclusion = None if arguments.exclusion_deg is None else math.radians(arguments.exclusion_deg)
    if arguments.seed < 0:
        raise BadInput("a seed is not negative", expected="0 or more", got=str(arguments.seed))
    return Question(
        arguments.profile, changes, exclusion, arguments.spare_mm, along, arguments.seed, arguments.pointings
    )


def as_text(record: dict[str, Any]) -> str:
    """Return the figures as text: value, unit, the value in the camera's document, and the source."""
    changes = ", ".join(f"{k} {record['camera'][k]:g}" for k in record["changed"]) or "as in the document"
    lines = [f"{record['profile']}: {changes}; {record['sky']}, elapsed {record['elapsed_ms'] / 1000:.1f} s"]
    group = ""
    for f in record["figures"]:
        if f["group"] != group:
            group = f["group"]
            lines += ["", group]
        value = "–" if f["value"] is None else f"{f['value']:.4g}"
        paper = "" if f["paper"] is None else f"  paper {f['paper']:g} ({f['paper_source']})"
        lines.append(f"  {f['label']:34} {value:>10} {f['unit']:6} {f['source']}{paper}")
    lines += ["", *_table("Cameras", record["cameras"])]
    if record["trade"]:
        lines += ["", *_table("Lenses of this camera", record["trade"])]
    lines += [""] * bool(record["notes"] or record["baffle_problem"])
    lines += [f"Note: {note}" for note in (*record["notes"], record["baffle_problem"]) if note]
    return "\n".join(lines)


def _table(title: str, rows: list[dict[str, Any]]) -> list[str]:
    head = "camera          f mm     f/    field °       ″/px  limit V  stars  <3 %   across ″  roll ″  ½ mag °/s"
    lines = [title, "  " + head]
    for r in rows:
        field = f"{r['fov_deg'][0]:.1f} x {r['fov_deg'][1]:.1f}"
        known = [f"{v:.2f}" if v is not None else "–" for v in (r["cross_arcsec"], r["roll_arcsec"])]
        lens = f"{r['name']:12} {r['focal_mm']:7.2f} {r['f_number']:6.2f}  {field:12} {r['pixel_arcsec']:6.1f}"
        seen = f"{r['limit_mag']:7.2f} {r['stars']:6.1f}  {100 * r['p_fewer_3']:5.2f}"
        lines.append(f"  {lens}  {seen}  {known[0]:>8} {known[1]:>7}  {r['blur_rate_deg_s']:9.3f}")
    return lines


def _range(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    try:
        return float(low), float(high or low)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected MIN:MAX in degrees, got {text}") from None


def _told(done: int, total: int, text: str) -> None:
    if sys.stderr.isatty():
        print(
            f"\r{text}, {100 * done // max(1, total)} % ",
            end="\n" if done >= total else "",
            file=sys.stderr,
            flush=True,
        )
