"""``gss audit``: export and verify the audit log."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.accounts_store import desk, with_data

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("audit")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    p = with_data(kinds.add_parser("export", help="all rows, oldest first"))
    p.add_argument("--format", default="jsonl", choices=("jsonl", "csv"), help="default jsonl")
    p.add_argument("--out", type=Path, help="file to write; standard output without it")
    p.set_defaults(run=export)
    p = with_data(
        kinds.add_parser(
            "verify",
            help="is the record whole?",
            description="Computes every hash again. Exit code 0: whole; 1: a row was changed, removed, or the end was cut off.",
        )
    )
    p.add_argument("--last-hash", default="", metavar="HASH", help="a hash noted earlier, which must be there still")
    p.set_defaults(run=verify)


def export(arguments: argparse.Namespace) -> int:
    """Write the audit log to a file or standard output."""
    with desk(arguments) as store:
        pieces = store.audit.export(arguments.format)
        if arguments.out:
            with arguments.out.open("w", encoding="utf-8") as file:
                file.writelines(pieces)
        else:
            sys.stdout.writelines(pieces)
        store.record("audit_export", str(arguments.out or "standard output"))
    return 0


def verify(arguments: argparse.Namespace) -> int:
    """Verify the audit log and print the result."""
    with desk(arguments) as store:
        verdict = store.audit.verify(arguments.last_hash)
    if verdict.problem:
        print(f"the audit record is not whole: {verdict.problem}", file=sys.stderr)
        return 1
    print(f"{verdict.rows} rows, whole; note the last hash elsewhere: {verdict.last_hash}")
    return 0
