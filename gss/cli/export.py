"""``gss export``: write Rerun recordings, the interface document, XTCE, OpenAPI and tables."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli import export_commands, export_rerun, export_tables, instruments, records
from gss.cli.whole_files import write_whole

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("export")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    export_rerun.register(subcommands)
    fits = subcommands.add_parser("fits", help="export stored frames as FITS files with the WCS of their solution")
    fits.add_argument("--frames", required=True, help="ids of frames, for example 3,5-9")
    fits.add_argument("--out", required=True, type=Path, metavar="FOLDER", help="folder for frame-N.fits")
    fits.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    fits.set_defaults(run=export_fits)
    solutions = subcommands.add_parser("solutions", help="export results of stored frames as a table")
    solutions.add_argument("--out", required=True, type=Path, help="file to write")
    solutions.add_argument("--format", default="parquet", choices=("csv", "parquet"), help="default parquet")
    solutions.add_argument("--chain", default="", help="only results of this chain")
    solutions.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    solutions.set_defaults(run=export_solutions)
    icd = subcommands.add_parser("icd", help="write the interface control document")
    instruments.add_option(icd)
    icd.add_argument("--out", type=Path, help="file to write; standard output without it")
    icd.set_defaults(run=export_icd)
    xtce = subcommands.add_parser(
        "xtce", help="write commands, telemetry and limits as XTCE 1.2, for other ground software"
    )
    instruments.add_option(xtce)
    xtce.add_argument("--out", type=Path, help="file to write; standard output without it")
    xtce.add_argument(
        "--repeat-lists", action="store_true", help="write lists as repeated containers, if the reader supports them"
    )
    xtce.set_defaults(run=export_xtce)
    cosmos = subcommands.add_parser("cosmos", help="write commands and telemetry as definitions of OpenC3 COSMOS")
    instruments.add_option(cosmos)
    cosmos.add_argument("--out", required=True, type=Path, metavar="FOLDER", help="folder for cmd.txt and tlm.txt")
    cosmos.add_argument("--target", default="", help="name of the target in COSMOS; default the device model")
    cosmos.set_defaults(run=export_cosmos)
    openapi = subcommands.add_parser("openapi", help="write the OpenAPI document of the HTTP interface")
    openapi.add_argument("--out", type=Path, help="file to write; standard output without it")
    openapi.set_defaults(run=export_openapi)
    shell = subcommands.add_parser("shell", help="write the command-line reference")
    shell.add_argument("--out", type=Path, help="file to write; standard output without it")
    shell.set_defaults(run=export_shell)
    export_commands.register(subcommands)
    records.register_exports(subcommands)
    export_tables.register(subcommands)


def export_shell(arguments: argparse.Namespace) -> int:
    """Write the command reference."""
    from gss.cli import full_parser
    from gss.cli.shell_page import shell_page

    return _write(shell_page(full_parser()), arguments.out)


def export_solutions(arguments: argparse.Namespace) -> int:
    """Write the solutions as a table."""
    from gss.cli.records import services_of
    from gss.operations.frames import solution_export

    services = services_of(arguments)
    data = solution_export.export_solutions(services.base.database, arguments.format, arguments.chain)
    write_whole(arguments.out, data)
    print(f"{arguments.out}: {len(data)} bytes")
    return 0


def export_fits(arguments: argparse.Namespace) -> int:
    """Write one FITS file per frame. Frames with missing rows are skipped and reported."""
    from gss.cli.records import services_of
    from gss.operations.frames.fits_export import fits_file
    from gss.operations.recordings.ranges import ids_of

    services, written = services_of(arguments), 0
    arguments.out.mkdir(parents=True, exist_ok=True)
    for frame_id in ids_of(arguments.frames):
        detail = services.frames.frames.detail(frame_id)
        if not detail.frame.complete:
            print(f"Frame {frame_id} has missing rows and was skipped", file=sys.stderr)
            continue
        data = fits_file(services.frames.frames.picture(detail.frame), detail.frame, detail.ground)
        write_whole(arguments.out / f"frame-{frame_id}.fits", data)
        written += 1
    print(f"{arguments.out}: {written} files")
    return 0


def export_icd(arguments: argparse.Namespace) -> int:
    """Write the interface control document."""
    from gss.device.icd import icd_markdown

    return _write(icd_markdown(instruments.chosen(arguments).dictionary), arguments.out)


def export_xtce(arguments: argparse.Namespace) -> int:
    """Write the dictionary as XTCE."""
    from gss.device.xtce import xtce_of

    return _write(xtce_of(instruments.chosen(arguments), repeat_lists=arguments.repeat_lists), arguments.out)


def export_cosmos(arguments: argparse.Namespace) -> int:
    """Write the dictionary as definitions of COSMOS."""
    from gss.device.cosmos import cosmos_files

    files = cosmos_files(instruments.chosen(arguments), arguments.target)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_whole(arguments.out / name, text.encode())
    print(f"{arguments.out}: {', '.join(files)}")
    return 0


def export_openapi(arguments: argparse.Namespace) -> int:
    """Write the OpenAPI document without starting a server."""
    import json
    import tempfile

    from gss.api.app import create_app
    from gss.settings import Settings
    from gss.wiring.build import build

    with tempfile.TemporaryDirectory() as folder:
        app = create_app(build(Settings(data=Path(folder))))
        return _write(json.dumps(app.openapi(), indent=1) + "\n", arguments.out)


def _write(text: str, out: Path | None) -> int:
    if out is None:
        print(text, end="")
    else:
        write_whole(out, text.encode())
    return 0
