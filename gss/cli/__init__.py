"""The command line: parse, call, print. One file per group of commands, each with ``register(subparsers)``.

A command's function takes the parsed arguments and returns the exit code: 0 done, 2 bad input, 3 no solution.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gss import __version__
from gss.domain.errors import BadInput, Conflict, GssError, NotFound

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

GROUPS = (
    "serve",
    "simulate",
    "catalogue",
    "design",
    "solve",
    "night",
    "bench",
    "export",
    "check",
    "upkeep",
    "experiments",
    "replay",
    "user",
    "token",
    "audit",
)
BAD_INPUT_EXIT = 2
FAILED_EXIT = 1


def whole_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = argparse.ArgumentParser(prog="gss", description="Ground-support system for star trackers.")
    parser.add_argument("--version", action="version", version=f"gss {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for group in GROUPS:
        importlib.import_module(f"gss.cli.{group}").register(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    arguments = whole_parser().parse_args(argv)
    try:
        return int(arguments.run(arguments))
    except GssError as error:
        print(f"gss: {error}", file=sys.stderr)
        return BAD_INPUT_EXIT if isinstance(error, BadInput | NotFound | Conflict) else FAILED_EXIT
    except ValueError as error:
        if getattr(error, "title", "") != "Settings":
            raise
        words = " ".join(str(error).split())
        print(f"gss: a setting cannot be used: {words}. Try: docs/settings.md, gss serve --help", file=sys.stderr)
        return BAD_INPUT_EXIT
    except BrokenPipeError:
        # The reader has gone, as `| head` does. Nothing may be written any more, not even at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED_EXIT
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        print(f"gss: {error.strerror or error}{where}", file=sys.stderr)
        return FAILED_EXIT
    except KeyboardInterrupt:
        print("gss: interrupted", file=sys.stderr)
        return 130
