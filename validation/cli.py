"""``gss experiments``: rerun experiments from the documents and print both results side by side."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gss import __version__
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from validation.never_wrong.campaign import CampaignSettings, OrderedExecutor


def add_commands(parser: argparse.ArgumentParser, make_executor: Callable[[str | None, int], OrderedExecutor]) -> None:
    """Add the subcommands. ``make_executor``: function from the URL of the cluster (None: the URL in the settings) and
    the number of local processes to an executor."""
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listing = kinds.add_parser("list", help="list names and titles")
    listing.set_defaults(run=list_experiments)
    p = kinds.add_parser(
        "run",
        help="run some or all experiments",
        description="Show published figures next to the results of GSS, with the conditions.",
    )
    p.add_argument("names", nargs="*", metavar="NAME", help="names of experiments; see `gss experiments list`")
    p.add_argument("--all", action="store_true", help="every experiment")
    p.add_argument("--trials", type=int, metavar="N", help="number of trials (default: the number of the experiment)")
    p.add_argument(
        "--share",
        type=float,
        default=1.0,
        metavar="S",
        help="run this share of each experiment's default number of trials",
    )
    p.add_argument("--seed", type=int, default=1, help="seed of all random numbers (default 1)")
    p.add_argument("--json", action="store_true", help="print one JSON object per experiment and line")
    p.add_argument("--page", type=Path, metavar="FILE", help="write a Markdown page with every table")
    p.add_argument(
        "--keep",
        type=Path,
        metavar="FILE",
        help="store each run in FILE; a stored run is reused if it has the number of --trials, or without it at least the "
        "number that would run",
    )
    p.set_defaults(run=run)
    p = kinds.add_parser(
        "never-wrong",
        help="run the campaign that searches for false attitudes",
        description="Solve random attitudes with faults, using the chain of every camera and the reference chain. "
        "Results are stored in FILE, and the next run continues with the remaining cases. Exit code 0: no wrong "
        "result; 3: at least one.",
    )
    p.add_argument("--attitudes", type=int, default=10_000, metavar="N", help="centroid lists per camera and chain")
    p.add_argument("--frames", type=int, default=130, metavar="N", help="rendered frames per camera and chain")
    _add_selection(p)
    p.add_argument("--keep", type=Path, default=Path("never-wrong.json"), metavar="FILE", help="file of stored results")
    p.add_argument(
        "--again",
        action="store_true",
        help="rerun the selected cameras and chains; the results replace those in FILE; rejected if FILE has more of their "
        "lists or frames than --attitudes and --frames select",
    )
    p.add_argument(
        "--page", type=Path, metavar="FILE", help="write a Markdown page of the stored results without further runs"
    )
    p.set_defaults(run=partial(never_wrong, make_executor))
    p = kinds.add_parser(
        "search-wrong",
        help="search for false attitudes among the lists with selected faults",
        description="Solve only the centroid lists of the campaign that have selected faults. The default is mirrored and "
        "random lists and lists of another camera, which cause most false attitudes. Nothing is stored. Exit code 0: no "
        "wrong result; 3: at least one.",
    )
    p.add_argument("--fault", action="append", metavar="TITLE", help="lists with this fault; can be repeated")
    p.add_argument("--first", type=int, default=0, metavar="N", help="first attitude (default 0)")
    p.add_argument("--attitudes", type=int, default=100_000, metavar="N", help="end of the attitudes (default 100 000)")
    _add_selection(p)
    p.set_defaults(run=partial(search_wrong, make_executor))


def _add_selection(p: argparse.ArgumentParser) -> None:
    """Add the options that select cases and the processes that run them."""
    p.add_argument("--seed", type=int, default=1, help="seed of all random numbers (default 1)")
    p.add_argument("--camera", action="append", metavar="NAME", help="restrict to this camera; can be repeated")
    p.add_argument("--chain", action="append", metavar="own|reference", help="restrict to this chain; can be repeated")
    p.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default 2)")
    p.add_argument(
        "--cluster", metavar="URL", help="Dask scheduler that runs the cases instead of local processes (GSS_CLUSTER)"
    )


def list_experiments(_: argparse.Namespace) -> int:
    """Print one line per experiment."""
    from validation.entries import ENTRIES

    for e in ENTRIES.values():
        print(f"{e.name:24} {e.title}; {e.trials} trials")
    return 0


def run(arguments: argparse.Namespace) -> int:
    """Run experiments and print them in the requested order."""
    from validation.entries import ENTRIES
    from validation.fingerprint import fingerprint
    from validation.result_store import ResultStore, StoredRun, as_page, as_text
    from validation.run import as_record, default_trials, entry, run_experiment

    if not 0 < arguments.share <= 100:
        raise BadInput("share of trials is out of range", expected="above 0, at most 100", got=f"{arguments.share:g}")
    names = list(ENTRIES) if arguments.all else arguments.names
    if not names:
        raise BadInput("no experiment named", expected="NAME … or --all", hint="gss experiments list")
    for name in names:
        entry(name)
    _check_different(arguments.page, arguments.keep)
    for file in (arguments.page, arguments.keep):
        if file is not None:
            _check_writable(file)
    shelf = None if arguments.keep is None else ResultStore(arguments.keep)
    done: list[StoredRun] = []
    for name in names:
        if sys.stderr.isatty():
            print(f"… {name}", file=sys.stderr, flush=True)
        trials = default_trials(name, arguments.share) if arguments.trials is None else arguments.trials
        stored_run = None
        if shelf is not None:
            exact = arguments.trials is not None
            seed = arguments.seed
            stored_run = shelf.get(name, trials, seed) if exact else shelf.best(name, trials, seed, fingerprint())
        if stored_run is None:
            began_s = time.process_time()
            experiment = run_experiment(name, trials=trials, seed=arguments.seed)
            stored_run = StoredRun(experiment, trials, round(time.process_time() - began_s, 1), fingerprint())
            if shelf is not None:
                shelf.keep(stored_run)
        done.append(stored_run)
        if arguments.json:
            print(json.dumps(as_record(stored_run.experiment), ensure_ascii=False, allow_nan=False), flush=True)
        elif arguments.page is None:
            print(as_text(stored_run.experiment) + "\n", flush=True)
    if arguments.page is not None:
        arguments.page.write_text(as_page(done, __version__, arguments.share), "utf-8")
    return 0


def _check_different(page: Path | None, keep: Path | None) -> None:
    """Raise BadInput if the page would replace the stored results, also through a link."""
    if page is None or keep is None:
        return
    if page.resolve() == keep.resolve() or (page.exists() and keep.exists() and page.samefile(keep)):
        raise BadInput("--page and --keep name the same file", expected="two files", got=str(page))


def _check_writable(file: Path) -> None:
    """Raise BadInput if a file cannot be written, before the runs whose results it receives."""
    if file.is_dir() or not os.access(file if file.exists() else file.parent, os.W_OK):
        raise BadInput(
            "the file cannot be written", expected="a file in an existing folder, with write permission", got=str(file)
        )


def never_wrong(make_executor: Callable[[str | None, int], OrderedExecutor], arguments: argparse.Namespace) -> int:
    """Run the remaining trials of the campaign, or write a page of the completed trials."""
    from validation.never_wrong.campaign import keys, run_campaign
    from validation.never_wrong.page import page
    from validation.never_wrong.record import CampaignRecord

    settings = _settings(arguments, arguments.frames)
    _check_different(arguments.page, arguments.keep)
    record = CampaignRecord(arguments.keep)
    if arguments.page is not None:
        blocks = record.blocks(arguments.seed)
        if not blocks:
            raise BadInput(
                "no stored results",
                expected="the file of an earlier run",
                got=f"{arguments.keep}, seed {arguments.seed}",
            )
        arguments.page.write_text(page(blocks, arguments.seed, arguments.keep.name), "utf-8")
    else:
        if arguments.again:
            record.remove(set(keys(settings)))
        executor = make_executor(arguments.cluster, arguments.workers)
        try:
            run_campaign(settings, record, executor=executor, progress=_progress())
        finally:
            executor.stop()
    wrong = sorted(text for block in record.blocks(arguments.seed) for text in block.wrong)
    print("\n".join(wrong) if wrong else "no wrong result")
    return 3 if wrong else 0


def search_wrong(make_executor: Callable[[str | None, int], OrderedExecutor], arguments: argparse.Namespace) -> int:
    """Run the lists with selected faults, and print each wrong result at once."""
    from validation.never_wrong.search import DEFAULT_FAULTS, search

    settings, faults = _settings(arguments, 0), tuple(arguments.fault or DEFAULT_FAULTS)
    executor = make_executor(arguments.cluster, arguments.workers)
    try:
        verdicts = search(
            settings,
            faults,
            arguments.first,
            executor=executor,
            progress=_progress(),
            report=partial(print, flush=True),
        )
    finally:
        executor.stop()
    print(f"{sum(verdicts.counts.values())} lists, {len(verdicts.wrong) or 'no'} wrong")
    return 3 if verdicts.wrong else 0


def _settings(arguments: argparse.Namespace, frames: int) -> CampaignSettings:
    """Return the settings of a campaign. Raises BadInput if a number or name is not valid."""
    from validation.never_wrong.campaign import CampaignSettings
    from validation.never_wrong.lists import CAMERAS, CHAINS

    if not 1 <= arguments.workers <= 64:
        raise BadInput("number of processes is out of range", expected="1 – 64", got=str(arguments.workers))
    cameras, chains = tuple(arguments.camera or CAMERAS), tuple(arguments.chain or CHAINS)
    return CampaignSettings(arguments.attitudes, frames, arguments.seed, cameras, chains)


def _progress() -> Callable[[int, int], None]:
    """Return a function that shows the completed parts and the time left on a terminal."""
    began_s = time.monotonic()

    def show(count: int, total: int) -> None:
        if sys.stderr.isatty():
            left = timedelta(seconds=round((time.monotonic() - began_s) * (total - count) / count))
            print(f"\r{count} of {total} parts, about {left} left ", end="", file=sys.stderr, flush=True)

    return show
