"""``gss simulate``: run the simulated star tracker as a separate process."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli import Commands

MODULE = "gss.device.simulator"


def register(subparsers: Commands) -> None:
    """Add the command. The simulator parses its own options: ``gss simulate --help`` shows them."""
    parser = subparsers.add_parser(
        "simulate",
        add_help=False,
        prefix_chars="\0",
    )
    parser.add_argument("options", nargs=argparse.REMAINDER, help="options of the simulator")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replace this process with the simulator: signals, output and exit code pass directly, and no orphan can remain."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", MODULE, *arguments.options])  # noqa: S606 - our own program
