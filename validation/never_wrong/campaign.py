"""The long never-wrong campaign. Worker processes or a cluster run its shards. Each shard is stored as a line of a
file, so a run can be resumed, and shards affected by a change can be rerun."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput
from validation.fingerprint import fingerprint
from validation.never_wrong.frames import FRAME_SHARD, FrameCampaign, FrameShard, frame_shards
from validation.never_wrong.lists import CAMERAS, CHAINS, SHARD, Campaign, Shard, shards

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
        for dimension, choices, selected in (("camera", CAMERAS, self.cameras), ("chain", CHAINS, self.chains)):
            unknown = [name for name in selected if name not in choices]
            if unknown:
                raise BadInput(f"unknown {dimension}", expected=" | ".join(choices), got=", ".join(unknown))


def keys(run_campaign: CampaignSettings) -> list[Shard | FrameShard]:
    """Return every shard of a campaign. Frame shards are first, because they are few."""
    return [
        *frame_shards(run_campaign.frames, run_campaign.seed, run_campaign.cameras, run_campaign.chains),
        *shards(run_campaign.attitudes, run_campaign.seed, run_campaign.cameras, run_campaign.chains),
    ]


def read(file: Path) -> dict[Shard | FrameShard, dict[str, Any]]:
    """Return the completed shards. If a shard has two records, the newer record is returned. A line that a crash has
    truncated is ignored."""
    done: dict[Shard | FrameShard, dict[str, Any]] = {}
    if not file.is_file():
        return done
    for line in file.read_text("utf-8").splitlines():
        try:
            record = json.loads(line)
        except ValueError:
            continue
        shard_type = FrameShard if record["kind"] == "frames" else Shard
        done[shard_type(**record["shard"])] = record
    return done


def run_campaign(
    settings: CampaignSettings,
    file: Path,
    *,
    executor: OrderedExecutor,
    again: bool = False,
    progress: ProgressReport = lambda _, __: None,
) -> int:
    """Run the shards that ``file`` does not contain, or all shards if ``again`` is True. Return the number of shards
    run."""
    completed = {} if again else read(file)
    missing = [key for key in keys(settings) if key not in completed]
    if not missing:
        return 0
    code = fingerprint()
    file.parent.mkdir(parents=True, exist_ok=True)
    with closing(executor.in_order(_run, missing)) as answers, file.open("a", encoding="utf-8") as out:
        for count, (key, answer) in enumerate(zip(missing, answers, strict=True), 1):
            kind = "frames" if isinstance(key, FrameShard) else "lists"
            record = {"kind": kind, "shard": asdict(key), "code": code} | answer
            out.write(json.dumps(record, ensure_ascii=False) + "\n")
            out.flush()
            progress(count, len(missing))
    return len(missing)


def selected(done: Iterable[Any], settings: CampaignSettings) -> set[Any]:
    """Return the completed shards that belong to a campaign."""
    return set(keys(settings)) & set(done)


@lru_cache(maxsize=1)
def _campaigns() -> tuple[Campaign, FrameCampaign]:
    """Build the state that a process keeps between shards."""
    stars = propagate(load_stars(FAINTEST_MAG), EPOCH_JYEAR)
    return Campaign(stars), FrameCampaign(stars)


def _run(key: Shard | FrameShard, _progress: Callable[[float], None]) -> dict[str, Any]:
    lists, frames = _campaigns()
    verdicts = frames.run(key) if isinstance(key, FrameShard) else lists.run(key)
    of = FRAME_SHARD if isinstance(key, FrameShard) else SHARD
    counts = [[*cell, number] for cell, number in sorted(verdicts.counts.items())]
    return {"of": of, "counts": counts, "wrong": list(verdicts.wrong)}
