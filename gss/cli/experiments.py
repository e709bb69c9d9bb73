"""``gss experiments``: rerun experiments from the documents and print both results side by side."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from gss import __version__
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from gss.cli import Commands


def register(subparsers: Commands) -> None:
    """Add the commands."""
    parser = subparsers.add_parser("experiments")
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
    p.add_argument("--keep", type=Path, metavar="FILE", help="keep each run here, and take from here what is kept")
    p.set_defaults(run=run)
    p = kinds.add_parser(
        "never-wrong",
        help="hunt for false attitudes at length",
        description="Random attitudes with faults before every camera's chain and the reference. What is done is kept in FILE, and "
        "the next run does the rest. Exit code 0: no wrong answer; 3: some.",
    )
    p.add_argument("--attitudes", type=int, default=10_000, metavar="N", help="per camera and chain, as lists")
    p.add_argument("--frames", type=int, default=130, metavar="N", help="per camera and chain, rendered")
    p.add_argument("--seed", type=int, default=1, help="of every random number (default 1)")
    p.add_argument("--camera", action="append", metavar="NAME", help="only this one; may be repeated")
    p.add_argument("--chain", action="append", metavar="own|reference", help="only this one; may be repeated")
    p.add_argument("--keep", type=Path, default=Path("never-wrong.jsonl"), metavar="FILE", help="what is done")
    p.add_argument("--again", action="store_true", help="also what FILE holds; the newer counts")
    p.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default 2)")
    p.add_argument("--cluster", metavar="URL", help="a Dask scheduler instead of own processes (GSS_CLUSTER)")
    p.add_argument(
        "--page", type=Path, metavar="FILE", help="write a Markdown page of what is done, and run nothing more"
    )
    p.set_defaults(run=never_wrong)


def list_experiments(_: argparse.Namespace) -> int:
    """Print one line per experiment."""
    from gss.operations.studies.experiments import ENTRIES

    for e in ENTRIES.values():
        print(f"{e.name:24} {e.title}; {e.trials} trials")
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Run experiments and print them in the requested order."""
    from gss.operations.studies.experiments import (
        ENTRIES,
        Done,
        Shelf,
        as_page,
        as_record,
        as_text,
        entry,
        run_experiment,
    )
    from gss.operations.studies.never_wrong import fingerprint

    if not 0 < arguments.share <= 100:
        raise BadInput("share of trials is out of range", expected="above 0, at most 100", got=f"{arguments.share:g}")
    names = list(ENTRIES) if arguments.all else arguments.names
    if not names:
        raise BadInput("no experiment named", expected="NAME … or --all", hint="gss experiments list")
    for name in names:
        entry(name)
    shelf = None if arguments.keep is None else Shelf(arguments.keep)
    done, took = [], {}
    for name in names:
        if sys.stderr.isatty():
            print(f"… {name}", file=sys.stderr, flush=True)
        trials = max(1, round(arguments.share * entry(name).trials)) if arguments.trials is None else arguments.trials
        found = None if shelf is None else shelf.get(name, trials, arguments.seed)
        if found is None:
            began_s = time.process_time()
            experiment = run_experiment(name, trials=trials, seed=arguments.seed)
            found = Done(experiment, trials, round(time.process_time() - began_s, 1), fingerprint())
            if shelf is not None:
                shelf.keep(found)
        done.append(found.experiment)
        took[name] = found.processor_s
        if arguments.json:
            print(json.dumps(as_record(done[-1]), ensure_ascii=False, allow_nan=False), flush=True)
        elif arguments.page is None:
            print(as_text(done[-1]) + "\n", flush=True)
    if arguments.page is not None:
        arguments.page.write_text(as_page(done, __version__, arguments.share, took), "utf-8")
    return 0


def never_wrong(arguments: argparse.Namespace) -> int:
    """Run the remaining trials of the campaign, or write a page of the completed ones."""
    from gss.operations.studies.dask_executor import make_executor
    from gss.operations.studies.never_wrong import Hunt, hunt, read, selected
    from gss.operations.studies.never_wrong_page import page
    from gss.pipeline.experiments.never_wrong_campaign import CAMERAS, CHAINS
    from gss.settings import Settings

    if not 1 <= arguments.workers <= 64:
        raise BadInput("number of processes is out of range", expected="1 – 64", got=str(arguments.workers))
    wanted = Hunt(
        arguments.attitudes,
        arguments.frames,
        arguments.seed,
        tuple(arguments.camera or CAMERAS),
        tuple(arguments.chain or CHAINS),
    )

    def told(count: int, total: int) -> None:
        if sys.stderr.isatty():
            print(f"\r{count} of {total}", end="", file=sys.stderr, flush=True)

    if arguments.page is not None:
        arguments.page.write_text(page(wanted, read(arguments.keep)), "utf-8")
    else:
        cluster = Settings().cluster if arguments.cluster is None else arguments.cluster
        executor = make_executor(cluster, arguments.workers)
        try:
            hunt(wanted, arguments.keep, executor=executor, again=arguments.again, told=told)
        finally:
            executor.stop()
    done = read(arguments.keep)
    wrong = sorted(text for key in selected(done, wanted) for text in done[key]["wrong"])
    print("\n".join(wrong) if wrong else "no wrong answer")
    return 3 if wrong else 0
