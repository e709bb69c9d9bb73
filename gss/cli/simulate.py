"""``gss simulate``: run the simulated star tracker as a separate process."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.cli import Commands

MODULE = "gss.device.simulator"
NAMES = ("--instrument", "--profile")


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
    options = with_instrument(arguments.options)
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", MODULE, *options])  # noqa: S606 - our own program


def with_instrument(options: Sequence[str]) -> list[str]:
    """Return the simulator's options with the folder of the instrument that they name; without a name, of GSS_INSTRUMENT.

    The simulator itself knows shipped instruments and folders only; those of the data folder are looked up here.
    """
    from gss.cli.instruments import registry
    from gss.settings import Settings

    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument(*NAMES, dest="instrument")
    parsed, others = parser.parse_known_args(list(options))
    name = parsed.instrument or Settings().unit_instrument
    instruments = registry()
    return ["--instrument", str(instruments.folder(name)) if name in instruments.names() else name, *others]
