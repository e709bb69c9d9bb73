"""Command line. Each module contains one group of commands and a function ``register(subparsers)``.

The function of a command receives the parsed arguments and returns the exit code: 0 success, 1 failure, 2 bad input,
3 no solution.
"""

from __future__ import annotations

import argparse
import importlib
import io
import os
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gss import __version__
from gss.domain.errors import BadInput, Conflict, GssError, NotFound

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

COMMANDS = {
    "serve": ("serve", "start the server and print its address"),
    "simulate": ("simulate", "start a simulated star tracker on a pseudo-terminal or TCP port"),
    "catalogue": ("catalogue", "build star catalogues for a sensor's flash banks"),
    "design": ("design", "calculate limits, stars in view, accuracy, baffle and lens trade-off of a camera"),
    "instrument": ("instrument", "list, check, add and compare instrument packages"),
    "solve": ("solve", "find the attitude of images of the sky"),
    "compile": ("compile", "compile the solver's loops in advance, so that the first frame is not delayed"),
    "rate": ("rate", "measure angular rates between images from their stars, without a catalogue"),
    "render": ("render", "render a test image of the sky at a pointing"),
    "solve-lists": ("solve_lists", "find the attitudes of lists of measured stars"),
    "calibrate": ("night", "calibrate a camera's geometry, photometry and detector from its frames"),
    "analyse": ("night", "measure accuracy, rates, sensitivity and noise from the frames of a night"),
    "sheet": ("sheet", "create the performance sheet of a unit from its frames, or of a simulated unit"),
    "moving": ("moving", "detect satellites, debris and planets in a sequence of frames"),
    "health": ("health", "monitor lens, focus, sensitivity, warm pixels and radiation over the frames of a mission"),
    "bench": ("bench", "measure optical centre, tilt, focal length, distortion, dark current or focus on the bench"),
    "export": ("export", "write recordings and documents"),
    "check": ("check", "test a device against the interface document, or a record for gaps"),
    "link-keys": ("link_keys", "create and change the keys that authenticate packets to the sensor"),
    "passes": ("passes", "list coming passes; import the orbit of the spacecraft; manage ground stations"),
    "attitude": ("attitude", "export attitudes of frames as CCSDS AEM or ACM; compare them with another system"),
    "heads": ("heads", "compare the heads of one spacecraft: mountings, fused attitude, misalignment and drift"),
    "fleet": ("fleet", "list the units of a running server, and restart one of them"),
    "rehearse": ("rehearse", "execute a pass plan on a simulated unit, faster than real time"),
    "notify": ("notify", "check the notification file, or send a test message"),
    "backup": ("upkeep", "create a backup; the server can be running"),
    "restore": ("upkeep", "restore a backup into a new data folder"),
    "retention": ("upkeep", "list data that retention would delete; the server deletes it once a day"),
    "experiments": ("experiments", "reproduce published tables"),
    "replay": ("replay", "decode and print a raw capture, or rerun the sensor's chain on a stored frame"),
    "user": ("user", "manage users"),
    "token": ("token", "manage API tokens for programs"),
    "audit": ("audit", "export or verify the audit log"),
}
"""Module and summary of each command. A module is imported only when its command is used."""
BAD_INPUT_EXIT = 2
FAILED_EXIT = 1
NEGATIVE = re.compile(r"-[\d.]+[eE,:]")
"""Beginning of a list (``-33.9,18.4,20``), a range (``-5:5``) or a number with an exponent (``-1e-3``)."""


class Commands:
    """Subparsers of the commands. Each command is added with its summary."""

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self._subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add_parser(self, name: str, **options: Any) -> argparse.ArgumentParser:
        """Return the parser of a command of ``COMMANDS``."""
        return self._subparsers.add_parser(name, help=COMMANDS[name][1], **options)


def parser_of(*modules: str) -> argparse.ArgumentParser:
    """Return a parser for the commands of these modules. If no module is given, return a parser with the names and
    summaries of all commands but without their arguments."""
    parser = argparse.ArgumentParser(prog="gss", description="Ground software for star trackers.")
    parser.add_argument("--version", action="version", version=f"gss {__version__}")
    commands = Commands(parser)
    for module in modules:
        importlib.import_module(f"gss.cli.{module}").register(commands)
    if not modules:
        for name in COMMANDS:
            commands.add_parser(name)
    return parser


def full_parser() -> argparse.ArgumentParser:
    """Return the parser of all commands, in the order of ``COMMANDS``."""
    return parser_of(*dict.fromkeys(module for module, _ in COMMANDS.values()))


def _parser_for(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for the command in the first argument."""
    first = argv[0] if argv else ""
    return parser_of(COMMANDS[first][0]) if first in COMMANDS else parser_of()


def join_negatives(words: Sequence[str]) -> list[str]:
    """Join an option and a list, range or number that begins with a minus (``--site -33.9,18.4,20``). argparse accepts only
    plain negative numbers as values, and takes others for options."""
    joined: list[str] = []
    for word in words:
        if joined and NEGATIVE.match(word) and joined[-1].startswith("--") and "=" not in joined[-1]:
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = join_negatives(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a file name or "°" must not end the command with any encoding
            stream.reconfigure(errors="backslashreplace")
    try:
        arguments = _parser_for(words).parse_args(words)
        return int(arguments.run(arguments))
    except GssError as error:
        print(f"gss: {error.sentences()}", file=sys.stderr)
        return BAD_INPUT_EXIT if isinstance(error, BadInput | NotFound | Conflict) else FAILED_EXIT
    except ValueError as error:
        if getattr(error, "title", "") != "Settings":
            raise
        problem = " ".join(str(error).split())
        print(f"gss: A setting cannot be used: {problem}. See docs/settings.md or gss serve --help.", file=sys.stderr)
        return BAD_INPUT_EXIT
    except BrokenPipeError:
        # The reader has closed the pipe, for example `| head`. The output is redirected, because otherwise the flush at
        # exit would fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED_EXIT
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        print(f"gss: {error.strerror or error}{where}", file=sys.stderr)
        return FAILED_EXIT
    except KeyboardInterrupt:
        print("gss: Interrupted.", file=sys.stderr)
        return 130
