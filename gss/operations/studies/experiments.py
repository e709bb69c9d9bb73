"""Access to the package ``validation``, which contains the documents' experiments and is installed with the extra
``validation``. Only this module imports the package. If it is not installed, the functions of this module raise
Conflict."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from gss.domain.errors import Conflict
from gss.domain.experiment import ExperimentEntry, Progress
from gss.domain.json_object import JsonObject
from gss.operations.studies.executor import Executor


@contextmanager
def _package() -> Iterator[None]:
    """Convert a failed import of the package into a Conflict that names the command to install it."""
    try:
        yield
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "validation":
            raise
        raise Conflict(
            "the experiments are not installed",
            expected="the package gss-startracker-validation",
            hint="run pip install 'gss-startracker[validation]'",
        ) from None


def entries() -> list[ExperimentEntry]:
    """Return all experiments."""
    with _package():
        from validation.entries import ENTRIES
    return list(ENTRIES.values())


def check(name: str, trials: int | None, seed: int) -> int:
    """Return the number of trials of a run. Raises NotFound or BadInput if the experiment cannot run."""
    with _package():
        from validation import run
    return run.check(name, trials, seed)


def run_item(request: tuple[str, int | None, int], report: Progress) -> JsonObject:
    """Run (name, trials, seed) for an executor and return the record of the run."""
    with _package():
        from validation import run
    name, trials, seed = request
    return run.as_record(run.run_experiment(name, trials=trials, seed=seed, progress=report))


def add_commands(parser: argparse.ArgumentParser, make_executor: Callable[[str | None, int], Executor]) -> None:
    """Add the subcommands of ``gss experiments``. ``make_executor``: function that returns an executor for the
    URL of a cluster (None: as in the settings) and a number of local processes."""
    with _package():
        from validation import cli
    cli.add_commands(parser, make_executor)
