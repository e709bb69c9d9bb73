"""``gss catalogue show | diff | export | import | report | timeline``: existing catalogues, as files or in the
store."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gss.catalogue_tools.diff import compare, coverage_change
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.manifest import BuildManifest, check_image, manifest_of, read_manifest
from gss.catalogue_tools.onboard import decode
from gss.cli.input_files import IMAGE_BYTES, TABLE_FILE_BYTES, TEXT_BYTES, read_limited
from gss.cli.instruments import camera
from gss.cli.whole_files import write_whole
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput
from gss.skytables.bank import OnboardCatalogue

if TYPE_CHECKING:
    from gss.catalogue_tools.build import BuiltCatalogue
    from gss.cli import Subparsers
    from gss.operations.report.parts import Report
    from gss.wiring.services import Services

NEEDED_STARS = 3
SPAN = timedelta(days=60)
MAX_DAYS = 36525
CATALOGUE_HELP = "bank image with its manifest in IMAGE.json, or the number of a stored catalogue"


def register(commands: Subparsers) -> None:
    """Add the commands to the catalogue group."""
    show = _parser(commands, "show", "check a catalogue with its manifest and list its content", run_show)
    show.add_argument("image", help=CATALOGUE_HELP)
    diff = _parser(commands, "diff", "compare two catalogues", run_diff)
    diff.add_argument("old", help=CATALOGUE_HELP)
    diff.add_argument("new", help=CATALOGUE_HELP)
    export = _parser(commands, "export", "write a catalogue as a file for other programs", run_export)
    export.add_argument("image", help=CATALOGUE_HELP)
    export.add_argument(
        "--kind",
        default="csv",
        help="image | manifest | c | csv | ecsv | fits | parquet | tables-fits | tables-csv | tables-ecsv | tables-parquet",
    )
    export.add_argument("--out", type=Path, required=True, metavar="FILE")
    stars = _parser(
        commands, "stars", "write the stars of Hipparcos as a list to edit and to build from (build --list)", run_stars
    )
    stars.add_argument("--mag-limit", type=float, default=6.5, metavar="V", help="faint limit in V (default 6.5)")
    stars.add_argument("--epoch", type=float, metavar="YEAR", help="Julian year of the positions (default 1991.25)")
    stars.add_argument("--out", type=Path, required=True, metavar="FILE", help="file: .csv, .ecsv, .fits or .vot")
    back = _parser(
        commands, "import", "create the bank image from a file written by export --kind tables-…", run_import
    )
    back.add_argument("file", type=Path)
    back.add_argument("--out", type=Path, required=True, metavar="FILE")
    report = _parser(commands, "report", "write the quality report of a catalogue as one HTML page", run_report)
    report.add_argument("image", help=CATALOGUE_HELP)
    report.add_argument(
        "--out", type=Path, metavar="FILE", help="file to write, .html or .pdf; without it and --json: standard output"
    )
    timeline = _parser(commands, "timeline", "list past, current and planned catalogues of each bank", run_timeline)
    timeline.add_argument("--device", type=int, metavar="N", help="number of the device (default: the latest device)")
    timeline.add_argument("--days", type=float, default=60.0, help="number of past days (default 60)")


def _parser(commands: Subparsers, name: str, help_text: str, run: Any) -> argparse.ArgumentParser:
    parser = commands.add_parser(name, help=help_text)
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)
    return parser


def run_show(arguments: argparse.Namespace) -> int:
    """Check a catalogue and print its properties."""
    image, manifest, _ = _read(arguments, arguments.image)
    catalogue = _decoded(image, manifest)
    facts = {
        "name": manifest.name,
        "author": manifest.author,
        "tool": manifest.tool,
        "profile": manifest.profile_name,
        "format": manifest.format_name,
        "frame": manifest.frame,
        "epoch_jyear": manifest.epoch_jyear,
        "valid_from": manifest.valid_from or None,
        "valid_to": manifest.valid_to or None,
        "stars": len(catalogue),
        "pairs": len(catalogue.distances),
        "bytes": len(image),
        "sha256": manifest.image_sha256,
        "manifest_version": manifest.version,
    }
    print_facts(facts, arguments.json)
    return 0


def run_diff(arguments: argparse.Namespace) -> int:
    """Compare two catalogues and print the differences."""
    (old_image, old_manifest, _), (new_image, new_manifest, _) = (
        _read(arguments, a) for a in (arguments.old, arguments.new)
    )
    old, new = _decoded(old_image, old_manifest), _decoded(new_image, new_manifest)
    difference = compare(old, new)
    cover = coverage_change(old, new, FieldShape(camera(new_manifest.profile_name).camera).equal_circle_rad)
    lists = {
        "added": difference.added,
        "dropped": difference.dropped,
        "moved": difference.moved,
        "magnitude_changed": difference.magnitude_changed,
    }
    facts: dict[str, object] = {
        "same": len(difference.same),
        "pairs_old": difference.pairs[0],
        "pairs_new": difference.pairs[1],
        "same_camera": old_manifest.profile_name == new_manifest.profile_name,
        "circles": len(cover.old),
        "circles_poorer": cover.poorer(NEEDED_STARS),
        "fewest_in_circle_old": int(cover.old.min()),
        "fewest_in_circle_new": int(cover.new.min()),
    }
    if arguments.json:
        hip_lists = {name: hip.tolist() for name, hip in lists.items()}
        amounts = {
            "moved_arcsec": (difference.moved_rad / ARCSEC_RAD).round(3).tolist(),
            "magnitude_change_mag": difference.magnitude_change_mag.round(3).tolist(),
            "coverage": {"nside": cover.nside, "old": cover.old.tolist(), "new": cover.new.tolist()},
        }
        print_facts(hip_lists | amounts | facts, True)
    else:
        print_facts({name: len(hip) for name, hip in lists.items()} | facts, False)
    return 0


def run_stars(arguments: argparse.Namespace) -> int:
    """Write a star list."""
    from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
    from gss.catalogue_tools.sources.star_list_export import write_star_list
    from gss.operations.catalogues.star_lists import kind_of

    stars = load_stars(arguments.mag_limit)
    if arguments.epoch is not None:
        stars = propagate(stars, arguments.epoch)
    content = write_star_list(stars, kind_of(arguments.out.name))
    write_whole(arguments.out, content)
    print_facts({"file": str(arguments.out), "stars": len(stars), "epoch_jyear": stars.epoch_jyear}, arguments.json)
    return 0


def run_export(arguments: argparse.Namespace) -> int:
    """Convert a catalogue and write the file."""
    from gss.operations.catalogues.catalogue_files import export_file

    image, manifest, _ = _read(arguments, arguments.image)
    exported = export_file(image, manifest.as_dict(), arguments.kind, manifest.name)
    write_whole(arguments.out, exported.content)
    if arguments.json:
        print_facts({"file": str(arguments.out), "kind": arguments.kind, "bytes": len(exported.content)}, True)
    return 0


def run_import(arguments: argparse.Namespace) -> int:
    """Read the tables, verify them and write the image."""
    from gss.catalogue_tools.onboard import read_header
    from gss.operations.catalogues.catalogue_files import import_file
    from gss.operations.parsing.parse_processes import ParseProcesses

    name = arguments.file.name
    with ParseProcesses() as parsing:
        image = parsing.parse(import_file, _bytes(arguments.file, TABLE_FILE_BYTES), name, subject=name)
    write_whole(arguments.out, image)
    header = read_header(image)
    facts = {"profile": header.profile_name, "format": header.format_name, "stars": header.stars, "bytes": len(image)}
    print_facts(facts, arguments.json)
    return 0


def run_report(arguments: argparse.Namespace) -> int:
    """Write the stored report. If there is no stored report, rebuild the catalogue from the request in the manifest.
    The rebuilt image must have the same bytes."""
    from gss.api.present.catalogue_sheet import catalogue_sheet
    from gss.catalogue_tools.request import request_from
    from gss.catalogue_tools.sources.hipparcos import load_stars
    from gss.catalogue_tools.sources.sources import load_source
    from gss.operations.catalogues.catalogue_report import report_again
    from gss.operations.report.html import as_html

    _, manifest, stored = _read(arguments, arguments.image)
    report: Mapping[str, Any] | None = stored
    if report is None:
        profile = camera(manifest.profile_name)
        request = request_from(manifest.parameters, profile)
        if request.source == "list":
            raise BadInput(
                "the report needs the star list of the catalogue",
                expected="a stored catalogue, or build --list … --report FILE",
                got=arguments.image,
            )
        source = load_stars() if request.source == "hipparcos" else load_source(request.source, request.depth_mag)
        report = report_again(manifest, profile, source)
    sheet = catalogue_sheet(manifest.as_dict(), report)
    if arguments.out is not None:
        _write_sheet(arguments.out, sheet)
    if arguments.json:
        print_facts({"manifest": manifest.as_dict(), "report": report}, True)
    elif arguments.out is None:
        print(as_html(sheet))
    return 0


def run_timeline(arguments: argparse.Namespace) -> int:
    """Print the bank timeline of a device in the store."""
    if not 0 <= arguments.days <= MAX_DAYS:
        raise BadInput("number of days out of range", expected=f"0 to {MAX_DAYS}", got=f"{arguments.days:g}")
    from gss.api.present.catalogues import timeline
    from gss.operations.clock import utc_now

    services, now = _services(arguments), utc_now()
    bank_timeline = services.transfers.bank_history.timeline(
        now - timedelta(days=arguments.days), now + SPAN, arguments.device
    )
    history = timeline(bank_timeline, now, services.base.settings.catalogue_watch_days)
    if arguments.json:
        print(history.model_dump_json(indent=1))
        return 0
    print(f"{history.device.name}: {history.cover.text}")
    for stay in history.stays:
        until = f"{stay.ended:%Y-%m-%d %H:%M}" if stay.ended else "now"
        valid = f", valid to {stay.valid_to:%Y-%m-%d %H:%M}" if stay.valid_to else ""
        label = stay.name or stay.sha256[:8] or "–"
        source = " ".join((stay.how, stay.user)).strip()
        print(f"{stay.bank:6} {stay.state:8} {stay.began:%Y-%m-%d %H:%M} to {until:16} {label}{valid} ({source})")
    for plan in history.planned:
        print(f"{plan.bank:6} {plan.kind:10} {f'{plan.at:%Y-%m-%d %H:%M}' if plan.at else 'soon'} {plan.text}")
    return 0


def write_report(path: Path, built: BuiltCatalogue) -> None:
    """Write the quality report of a new build."""
    from gss.api.present.catalogue_sheet import catalogue_sheet
    from gss.operations.catalogues.catalogue_report import report_of

    _write_sheet(path, catalogue_sheet(built.manifest.as_dict(), report_of(built)))


def _write_sheet(path: Path, sheet: Report) -> None:
    """Write a report as PDF if the name ends in .pdf, else as HTML."""
    from gss.operations.clock import utc_now
    from gss.operations.report.html import as_html
    from gss.operations.report.pdf import as_pdf

    write_whole(path, as_pdf(sheet, utc_now()) if path.suffix == ".pdf" else as_html(sheet).encode())


def _read(arguments: argparse.Namespace, catalogue: str) -> tuple[bytes, BuildManifest, dict[str, object] | None]:
    """Return the image, the manifest and, for a stored catalogue, the report. Raises BadInput if image and manifest do
    not match."""
    if catalogue.isdigit() and not Path(catalogue).exists():
        services = _services(arguments)
        row = services.catalogues.catalogues.get(int(catalogue))
        return services.catalogues.catalogues.image(row.id), manifest_of(row.manifest), row.report
    path = Path(catalogue)
    manifest_path = path.with_name(path.name + ".json")
    image = _bytes(path)
    try:
        manifest = read_manifest(read_limited(manifest_path, TEXT_BYTES).decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput("the catalogue cannot be read", expected=f"{path} and {manifest_path}", got=str(error)) from None
    check_image(manifest, image)
    return image, manifest, None


def _decoded(image: bytes, manifest: BuildManifest) -> OnboardCatalogue:
    return decode(image, np.array(manifest.hip, np.int32))


def _services(arguments: argparse.Namespace) -> Services:
    from gss.cli.records import services_of

    return services_of(arguments)


def _bytes(path: Path, max_bytes: int = IMAGE_BYTES) -> bytes:
    try:
        return read_limited(path, max_bytes)
    except OSError as error:
        raise BadInput("the catalogue cannot be read", expected=f"{path} with its manifest", got=str(error)) from None


def print_facts(facts: Mapping[str, object], as_json: bool) -> None:
    """Print one JSON object, or one line per value."""
    if as_json:
        print(json.dumps(facts, indent=1, allow_nan=False))
        return
    width = max(map(len, facts))
    print("\n".join(f"{name:<{width}}  {'-' if value in (None, '') else value}" for name, value in facts.items()))
