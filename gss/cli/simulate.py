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
    """Add the command. The simulator parses the options; ``gss simulate --help`` shows them."""
    parser = subparsers.add_parser(
        "simulate",
        add_help=False,
        prefix_chars="\0",
    )
    parser.add_argument("options", nargs=argparse.REMAINDER, help="options of the simulator")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replace this process with the simulator. The simulator then receives signals directly, sets the exit code and
    cannot become an orphan."""
    options = with_instrument(arguments.options)
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", MODULE, *options])  # noqa: S606 - a module of this package


def with_instrument(options: Sequence[str]) -> list[str]:
    """Return the simulator's options with the instrument replaced by its folder, by default the instrument of
    GSS_INSTRUMENT.

    The simulator accepts only shipped instruments and folders, so instruments in the data folder are resolved here.
    """
    from gss.cli.instruments import registry
    from gss.settings import Settings

    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument(*NAMES, dest="instrument")
    parsed, others = parser.parse_known_args(list(options))
    name = parsed.instrument or Settings().unit_instrument
    instruments = registry()
    return ["--instrument", str(instruments.folder(name)) if name in instruments.names() else name, *others]
