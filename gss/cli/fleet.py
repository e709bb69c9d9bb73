"""``gss fleet``: list the units of a running server and restart one of them."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from urllib.parse import quote

from gss.client.connection import ServerConnection
from gss.client.errors import ClientError
from gss.domain.errors import Conflict

if TYPE_CHECKING:
    from gss.cli import Commands

TIMEOUT_S = 30.0


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("fleet")
    subcommands = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listing = _with_server(subcommands.add_parser("list", help="list all units with the state of their processes"))
    listing.set_defaults(run=list_units)
    restart = subcommands.add_parser(
        "restart", help="end the process of a unit and start it again; the other units continue"
    )
    restart.add_argument("name", metavar="NAME")
    _with_server(restart).set_defaults(run=restart_unit)


def _with_server(parser: argparse.ArgumentParser) -> argparse.ArgumentParser:
    parser.add_argument(
        "--address", default="", help="address of the server (default: GSS_ADDRESS, or http://localhost:8181)"
    )
    parser.epilog = "The API token is read from the environment variable GSS_TOKEN."
    return parser


def list_units(arguments: argparse.Namespace) -> int:
    """Print name, instrument, state of the process and number of restarts of each unit."""
    with _server(arguments) as server:
        units = server.get("/fleet")["units"]
    for unit in units:
        cause = f", last ended by {unit['last_end']}" if unit["last_end"] else ""
        print(f"{unit['name']:<24} {unit['instrument']:<16} {unit['process']:<9} {unit['restarts']} restarts{cause}")
    return 0


def restart_unit(arguments: argparse.Namespace) -> int:
    """Restart the process of a unit. Its line is closed until the new process has started."""
    with _server(arguments) as server:
        server.post(f"/fleet/units/{quote(arguments.name, safe='')}/restart")
    print(f"{arguments.name} is restarted")
    return 0


@contextmanager
def _server(arguments: argparse.Namespace) -> Iterator[ServerConnection]:
    """Connection to the server. Raises Conflict with the text of an error of the client."""
    address = arguments.address or os.environ.get("GSS_ADDRESS", "http://localhost:8181")
    connection = ServerConnection(address, os.environ.get("GSS_TOKEN", ""), TIMEOUT_S, reconnect_s=0.0)
    try:
        yield connection
    except ClientError as error:
        raise Conflict(str(error).rstrip(".")) from error
    finally:
        connection.close()
