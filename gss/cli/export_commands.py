"""``gss export commands``: export the command history with the filters of the console page."""

from __future__ import annotations

import argparse
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.operations.commanding.command_history import Filter

DESCRIPTION = """Export the commands that match all conditions, oldest first, with arguments, result and every stage.
Times are ISO 8601, UTC by default. --name and --result can be repeated."""


def register(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``gss export``."""
    parser = kinds.add_parser("commands", help="export the command history as CSV or JSON", description=DESCRIPTION)
    parser.add_argument("--format", choices=("csv", "json"), default="csv", help="default csv")
    parser.add_argument("--from", dest="start", metavar="TIME", help="created at or after this time")
    parser.add_argument("--to", dest="end", metavar="TIME", help="created before this time")
    parser.add_argument("--name", action="append", default=[], help="name of the command")
    parser.add_argument("--result", action="append", default=[], help="for example completed, failed, unknown")
    parser.add_argument("--user", default="", help="name of the sender")
    parser.add_argument("--contact", type=int, help="number of the contact")
    parser.add_argument("--text", default="", help="text in name, arguments, detail, note or values")
    parser.add_argument("--out", type=Path, help="file to write; standard output without it")
    parser.add_argument("--data", type=Path, help="data folder (GSS_DATA)")
    parser.set_defaults(run=export_commands)


def export_commands(arguments: argparse.Namespace) -> int:
    """Write the matching commands."""
    from gss.cli.records import services_of
    from gss.cli.whole_files import write_pieces

    command_filter = filter_of(arguments)
    services = services_of(arguments)
    pieces = (
        services.commanding.history.csv(command_filter)
        if arguments.format == "csv"
        else services.commanding.history.json(command_filter)
    )
    if arguments.out is None:
        sys.stdout.writelines(pieces)
    else:
        write_pieces(arguments.out, pieces)
    return 0


def filter_of(arguments: argparse.Namespace) -> Filter:
    """Return the filter of parsed arguments. Raises BadInput if a time is not valid."""
    from gss.operations.commanding.command_history import Filter

    return Filter(
        start=_moment("--from", arguments.start),
        end=_moment("--to", arguments.end),
        names=tuple(arguments.name),
        results=tuple(arguments.result),
        user=arguments.user,
        contact_id=arguments.contact,
        text=arguments.text,
    )


def _moment(option: str, text: str | None) -> datetime | None:
    from gss.domain.errors import BadInput

    if text is None:
        return None
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise BadInput(
            f"{option} is not a valid time", expected="ISO 8601, for example 2026-12-01T18:00:00Z", got=text
        ) from None
    return time if time.tzinfo else time.replace(tzinfo=UTC)
