"""``gss experiments``: commands of the package ``validation``, or a message how to install it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from gss.domain.errors import Conflict
from gss.operations.studies import experiments

if TYPE_CHECKING:
    from gss.cli import Commands
    from gss.operations.studies.executor import Executor


def register(subparsers: Commands) -> None:
    """Add the ``experiments`` commands, or a placeholder if ``validation`` is not installed."""
    parser = subparsers.add_parser("experiments")
    try:
        experiments.add_commands(parser, _executor)
    except Conflict:
        parser.add_argument("words", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
        parser.set_defaults(run=_not_installed)


def _not_installed(_: argparse.Namespace) -> int:
    """Raise Conflict with the command that installs the experiments."""
    return len(experiments.entries())


def _executor(cluster: str | None, workers: int) -> Executor:
    from gss.operations.studies.dask_executor import make_executor
    from gss.settings import Settings

    return make_executor(Settings().cluster if cluster is None else cluster, workers)
