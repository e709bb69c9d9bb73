"""``gss compile``: compile the solver's loops once after installation."""

from __future__ import annotations

import argparse
import os
import shutil
from typing import TYPE_CHECKING

from gss.cli.instruments import CAMERA_HELP, registry
from gss.domain.errors import GssError

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "compile",
        description="Compile the loops of the solver and keep them on disk, so that the first frame is not delayed by "
        "more than a minute. A server does it in the background at its first start; without a server, run it once after every "
        "installation.",
    )
    parser.add_argument(
        "--camera",
        metavar="INSTRUMENT",
        help=f"camera of the test frames: {CAMERA_HELP} (default: the first that solves them)",
    )
    parser.add_argument("--background", action="store_true", help="compute at the lowest priority")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compile the loops, and print a line for each case."""
    from gss.operations.clock import stopwatch_s
    from gss.operations.folder_lock import named_lock
    from gss.operations.frames.compile_ahead import compile_ahead
    from gss.operations.frames.solve import Solver
    from gss.operations.frames.solver_cache import SolverCache
    from gss.pipeline.kernels import FOLDER, are_compiled, compiled_mark, kernels

    kernels(fast=True)  # raises BadInput if numba is not installed
    if arguments.background:
        os.nice(19)
    began_s = stopwatch_s()

    def report(done: int, total: int, case: str) -> None:
        text = f"compiling for: {case}" if case else f"compiled in {stopwatch_s() - began_s:.0f} s"
        print(f"{done} of {total}, {text}", flush=True)

    cameras, mark = registry(), compiled_mark()
    with named_lock(mark.with_suffix(".lock"), "the loops are being compiled", wait=True):
        if are_compiled():
            print("The loops are compiled already")
            return 0
        solver = Solver(cameras.camera, SolverCache(), stopwatch_s)
        names = [arguments.camera] if arguments.camera else [instrument.name for instrument in cameras.all()]
        for name in names:
            try:
                compile_ahead(solver, cameras.camera(name), report)
                break
            except GssError:  # with a camera that detects few stars, not every frame can be solved
                if name == names[-1]:
                    raise
        mark.touch()
        for outdated in set(mark.parent.parent.glob(f"{FOLDER}*")) - {mark.parent}:
            shutil.rmtree(outdated, ignore_errors=True)
    return 0
