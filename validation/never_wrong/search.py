"""Search for wrong results among the centroid lists with selected faults.

Mirrored, random and foreign lists are 7.5 % of the campaign, but cause most of its wrong results. The search solves only these
lists, of the same attitudes as the campaign, and stores nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import closing

from gss.domain.errors import BadInput
from validation.never_wrong.campaign import CampaignSettings, OrderedExecutor, ProgressReport, campaigns
from validation.never_wrong.faults import FAULTS
from validation.never_wrong.lists import SHARD, Shard, Verdicts, shards

DEFAULT_FAULTS = ("mirrored", "mirrored, 10 false stars", "20 false stars alone", "another camera")
Task = tuple[Shard, tuple[str, ...]]


def search(
    settings: CampaignSettings,
    faults: tuple[str, ...],
    first: int,
    *,
    executor: OrderedExecutor,
    progress: ProgressReport = lambda _, __: None,
    report: Callable[[str], None] = lambda _: None,
) -> Verdicts:
    """Solve the lists with ``faults`` of the attitudes from ``first``, in whole shards. ``report`` receives each wrong result
    at once. Raises BadInput if a fault is unknown or no attitude is left."""
    titles = [fault.title for fault in FAULTS]
    unknown = [title for title in faults if title not in titles]
    if unknown:
        raise BadInput("unknown fault", expected=" | ".join(titles), got=", ".join(unknown))
    tasks = [
        (shard, faults)
        for shard in shards(settings.attitudes, settings.seed, settings.cameras, settings.chains)
        if shard.number >= first // SHARD
    ]
    if not tasks or first < 0:
        raise BadInput(
            "no attitude to solve", expected=f"a first attitude from 0, below {settings.attitudes}", got=str(first)
        )
    counts: Counter[tuple[int, int, str]] = Counter()
    wrong: list[str] = []
    with closing(executor.in_order(_run, tasks)) as results:
        for count, verdicts in enumerate(results, 1):
            counts.update(verdicts.counts)
            wrong += verdicts.wrong
            for text in verdicts.wrong:
                report(text)
            progress(count, len(tasks))
    return Verdicts(dict(counts), tuple(wrong))


def _run(task: Task, _progress: Callable[[float], None]) -> Verdicts:
    shard, faults = task
    return campaigns()[0].run(shard, faults)
