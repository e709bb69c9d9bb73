"""``gss experiments``: rerun the documents' tables and print theirs beside ours."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gss import __version__
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Subparsers


def register(subparsers: Subparsers) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("experiments", help="rerun the documents' own tables")
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listing = kinds.add_parser("list", help="names and titles")
    listing.set_defaults(run=list_experiments)
    p = kinds.add_parser(
        "run", help="run some, or all", description="The documents' figures beside ours, with conditions."
    )
    p.add_argument("names", nargs="*", metavar="NAME", help="experiments; `gss experiments list` shows them")
    p.add_argument("--all", action="store_true", help="every experiment")
    p.add_argument("--trials", type=int, metavar="N", help="number of trials (default: the experiment's own)")
    p.add_argument(
        "--share", type=float, default=1.0, metavar="S", help="run this share of each experiment's own number of trials"
    )
    p.add_argument("--seed", type=int, default=1, help="of every random number (default 1)")
    p.add_argument("--json", action="store_true", help="one JSON object per experiment and line")
    p.add_argument("--page", type=Path, metavar="FILE", help="write a Markdown page with every table")
    p.set_defaults(run=run)


def list_experiments(_: argparse.Namespace) -> int:
    """One line each."""
    from gss.operations.experiments import ENTRIES

    for e in ENTRIES.values():
        print(f"{e.name:24} {e.title}; {e.trials} trials")
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Run and print in the order asked for."""
    from gss.operations.experiments import ENTRIES, as_page, as_record, as_text, entry, run_experiment

    if not 0 < arguments.share <= 100:
        raise BadInput("share of trials is out of range", expected="above 0, at most 100", got=f"{arguments.share:g}")
    names = list(ENTRIES) if arguments.all else arguments.names
    if not names:
        raise BadInput("no experiment named", expected="NAME … or --all", hint="gss experiments list")
    for name in names:
        entry(name)
    done = []
    for name in names:
        if sys.stderr.isatty():
            print(f"… {name}", file=sys.stderr, flush=True)
        trials = max(1, round(arguments.share * entry(name).trials)) if arguments.trials is None else arguments.trials
        done.append(run_experiment(name, trials=trials, seed=arguments.seed))
        if arguments.json:
            print(json.dumps(as_record(done[-1]), ensure_ascii=False, allow_nan=False), flush=True)
        elif arguments.page is None:
            print(as_text(done[-1]) + "\n", flush=True)
    if arguments.page is not None:
        arguments.page.write_text(as_page(done, __version__, arguments.share), "utf-8")
    return 0
