"""The long never-wrong campaign. Worker processes or a cluster run its shards. Each completed shard is added to a file, so
a run can be resumed."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput
from validation.fingerprint import fingerprint
from validation.never_wrong.frames import FrameCampaign, FrameShard, frame_shards
from validation.never_wrong.lists import CAMERAS, CHAINS, Campaign, Shard, Verdicts, shards
from validation.never_wrong.record import CampaignRecord

FAINTEST_MAG = 8.0
EPOCH_JYEAR = 2000.0
MAX_ATTITUDES = 1_000_000
ProgressReport = Callable[[int, int], None]


class OrderedExecutor(Protocol):
    """Executor that runs a module-level function on items, in this process or in others, and returns the results in the
    order of the items."""

    def in_order(
        self, work: Callable[[Any, Callable[[float], None]], Any], items: Iterable[Any]
    ) -> Generator[Any, None, None]:
        """Yield the result of each item."""

    def stop(self) -> None:
        """Stop the workers started by this executor."""


@dataclass(frozen=True)
class CampaignSettings:
    """Size of a campaign. ``attitudes``: centroid lists per camera and chain. ``frames``: rendered frames per camera
    and chain."""

    attitudes: int = 10_000
    frames: int = 130
    seed: int = 1
    cameras: tuple[str, ...] = CAMERAS
    chains: tuple[str, ...] = CHAINS

    def __post_init__(self) -> None:
        for text, value in (("attitudes", self.attitudes), ("frames", self.frames)):
            if not 0 <= value <= MAX_ATTITUDES:
                raise BadInput(f"number of {text} is out of range", expected=f"0 – {MAX_ATTITUDES}", got=str(value))
        if self.seed < 0:
            raise BadInput("the seed is negative", expected="0 or more", got=str(self.seed))
        for dimension, choices, selected in (("camera", CAMERAS, self.cameras), ("chain", CHAINS, self.chains)):
            unknown = [name for name in selected if name not in choices]
            if unknown:
                raise BadInput(f"unknown {dimension}", expected=" | ".join(choices), got=", ".join(unknown))
            if len(set(selected)) < len(selected):
                raise BadInput(f"a {dimension} is selected twice", expected="each once", got=", ".join(selected))


def keys(run_campaign: CampaignSettings) -> list[Shard | FrameShard]:
    """Return every shard of a campaign. Frame shards are first, because they are few."""
    return [
        *frame_shards(run_campaign.frames, run_campaign.seed, run_campaign.cameras, run_campaign.chains),
        *shards(run_campaign.attitudes, run_campaign.seed, run_campaign.cameras, run_campaign.chains),
    ]


def run_campaign(
    settings: CampaignSettings,
    record: CampaignRecord,
    *,
    executor: OrderedExecutor,
    progress: ProgressReport = lambda _, __: None,
) -> int:
    """Run the shards that ``record`` does not contain, and add them. Return the number of shards run."""
    completed = record.completed()
    missing = [key for key in keys(settings) if key not in completed]
    if not missing:
        return 0
    code = fingerprint()
    with closing(executor.in_order(_run, missing)) as answers:
        for count, (key, verdicts) in enumerate(zip(missing, answers, strict=True), 1):
            record.add(key, code, verdicts)
            progress(count, len(missing))
    return len(missing)


@lru_cache(maxsize=1)
def campaigns() -> tuple[Campaign, FrameCampaign]:
    """Build the state that a process keeps between shards."""
    stars = propagate(load_stars(FAINTEST_MAG), EPOCH_JYEAR)
    return Campaign(stars), FrameCampaign(stars)


def _run(key: Shard | FrameShard, _progress: Callable[[float], None]) -> Verdicts:
    lists, frames = campaigns()
    return frames.run(key) if isinstance(key, FrameShard) else lists.run(key)
