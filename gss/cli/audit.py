"""``gss audit``: export and verify the audit log."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss.cli.accounts_store import account_store, with_data
from gss.cli.whole_files import write_pieces

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("audit")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    p = with_data(subcommands.add_parser("export", help="export all rows, oldest first"))
    p.add_argument("--format", default="jsonl", choices=("jsonl", "csv"), help="default jsonl")
    p.add_argument("--out", type=Path, help="file to write; standard output without it")
    p.set_defaults(run=export)
    p = with_data(
        subcommands.add_parser(
            "verify",
            help="check the hash chain of the audit log",
            description="Recompute every hash and compare the log with its anchor file. "
            "Exit code 0: intact; 1: a row was changed or removed, or the end was truncated.",
        )
    )
    p.add_argument(
        "--last-hash", default="", metavar="HASH", help="hash recorded earlier, which must still be in the log"
    )
    p.set_defaults(run=verify)
    p = with_data(
        subcommands.add_parser(
            "accept",
            help="accept the current audit log after the database was replaced",
            description="From now on compare only later rows with the anchor file. The file records the acceptance. Use this "
            "command only if you know why they differ, for example because you restored an older copy of the database.",
        )
    )
    p.add_argument("--reason", required=True, metavar="TEXT", help="why the log and the anchor file differ")
    p.set_defaults(run=accept)


def export(arguments: argparse.Namespace) -> int:
    """Write the audit log to a file or standard output."""
    with account_store(arguments) as store:
        pieces = store.audit.export(arguments.format)
        if arguments.out:
            write_pieces(arguments.out, pieces)
        else:
            sys.stdout.writelines(pieces)
        store.record("audit_export", str(arguments.out or "standard output"))
    return 0


def verify(arguments: argparse.Namespace) -> int:
    """Verify the audit log and print the result."""
    with account_store(arguments) as store:
        verdict = store.audit.verify(arguments.last_hash)
    if verdict.problem:
        print(f"The audit log is not intact: {verdict.problem}", file=sys.stderr)
        return 1
    print(f"{verdict.rows} rows, intact. {verdict.anchors}".strip())
    print(f"Record the last hash elsewhere: {verdict.last_hash}")
    return 0


def accept(arguments: argparse.Namespace) -> int:
    """Accept the current audit log and verify it."""
    with account_store(arguments) as store:
        store.audit.accept(store.user, arguments.reason)
    return verify(argparse.Namespace(data=arguments.data, last_hash=""))
