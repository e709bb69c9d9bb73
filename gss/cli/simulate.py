"""``gss simulate``: start the simulated star tracker as a process of its own."""

from __future__ import annotations

import argparse
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli import Commands

MODULE = "gss.device.simulator"


def register(subparsers: Commands) -> None:
    """Add the command. Its options are the simulator's own: ``gss simulate --help`` shows them."""
    parser = subparsers.add_parser(
        "simulate",
        add_help=False,
        prefix_chars="\0",
    )
    parser.add_argument("options", nargs=argparse.REMAINDER, help="options of the simulator")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replace this process by the simulator: its signals, output and exit code are ours, and no orphan can stay."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", MODULE, *arguments.options])  # noqa: S606 - our own program
