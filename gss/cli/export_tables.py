"""``gss export parquet``: write the store as partitioned tables."""

from __future__ import annotations

import argparse
import sys
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli.records import Kinds


def register(kinds: Kinds) -> None:
    """Add the command to ``gss export``."""
    parser = kinds.add_parser(
        "parquet", help="export telemetry, solutions, stars, commands and events as partitioned Parquet tables"
    )
    parser.add_argument(
        "--out", required=True, type=Path, metavar="FOLDER", help="new folder, or folder of an earlier export"
    )
    parser.add_argument(
        "--from", dest="first", type=date.fromisoformat, metavar="DAY", help="first UTC day, 2026-12-01"
    )
    parser.add_argument("--to", dest="last", type=date.fromisoformat, metavar="DAY", help="last UTC day, included")
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.set_defaults(run=export)


def export(arguments: argparse.Namespace) -> int:
    """Write the tables."""
    from gss.cli.records import services_of
    from gss.operations.upkeep.parquet_export import export_parquet

    services = services_of(arguments)

    def show_folder(folder: str) -> None:
        if sys.stderr.isatty():
            print(f"… {folder}", file=sys.stderr, flush=True)

    dictionary = services.telemetry.telemetry.archive.dictionary
    written = export_parquet(
        services.base.database, dictionary, arguments.out, arguments.first, arguments.last, show_folder
    )
    print(f"{arguments.out}: {written.files} files, {written.rows} rows, {written.bytes} bytes")
    return 0
