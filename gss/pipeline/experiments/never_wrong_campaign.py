"""Never wrong, at length: so many random attitudes per camera, each with a fault and a mode of its own, before its chain and ours.

The work falls into shards that can be done in any order, by any process, and again: a shard's verdicts depend on camera, chain,
seed and its own number alone. Both chains of a camera see the same lists.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gss.domain.errors import NotFound
from gss.domain.results import Verdict
from gss.domain.stars import StarTable
from gss.pipeline.chains import reference
from gss.pipeline.experiments.never_wrong import MODES, judge_with
from gss.pipeline.experiments.never_wrong_faults import FAULTS
from gss.pipeline.experiments.never_wrong_sky import SETTINGS, Setting, Subject, subject

SHARD = 250
"""Attitudes in a shard."""
OWN = "own"
CHAINS = (OWN, reference.NAME)
CAMERAS = tuple(s.camera for s in SETTINGS if s.chain != reference.NAME)
_STREAM = 910
_WEIGHT = np.array([f.share for f in FAULTS]) / sum(f.share for f in FAULTS)


@dataclass(frozen=True)
class Shard:
    """Which attitudes of which camera, before which of its two chains."""

    camera: str
    chain: str
    seed: int
    number: int


@dataclass(frozen=True)
class Verdicts:
    """What a shard gave: counts by (fault's number, mode's number, verdict), and every wrong answer in words."""

    counts: dict[tuple[int, int, str], int]
    wrong: tuple[str, ...]


def shards(
    attitudes: int, seed: int, cameras: tuple[str, ...] = CAMERAS, chains: tuple[str, ...] = CHAINS
) -> list[Shard]:
    """All shards of a campaign, ordered so that every camera and chain advances evenly."""
    numbers = range(-(-attitudes // SHARD))
    return [Shard(camera, chain, seed, n) for n in numbers for camera in cameras for chain in chains]


def setting_of(camera: str, chain: str) -> Setting:
    """The camera's setting, with the chain that is asked."""
    found = next((s for s in SETTINGS if s.camera == camera and s.chain != reference.NAME), None)
    if found is None:
        raise NotFound("unknown camera of the campaign", expected=" | ".join(CAMERAS), got=camera)
    return found if chain == OWN else replace(found, chain=reference.NAME)


class Campaign:
    """Keeps the chains that were asked, because making their tables takes longer than asking them."""

    def __init__(self, stars: StarTable) -> None:
        self._made = lru_cache(maxsize=None)(lambda camera, chain: subject(setting_of(camera, chain), stars))

    def subject(self, camera: str, chain: str) -> Subject:
        """That chain with that camera."""
        return self._made(camera, chain)

    def run(self, shard: Shard) -> Verdicts:
        """Judge every attitude of a shard."""
        asked = self.subject(shard.camera, shard.chain)
        counts: Counter[tuple[int, int, str]] = Counter()
        wrong = []
        for attitude in range(shard.number * SHARD, (shard.number + 1) * SHARD):
            key = [shard.seed, _STREAM, CAMERAS.index(shard.camera), attitude]
            rng = np.random.default_rng(key)
            j, k = int(rng.choice(len(FAULTS), p=_WEIGHT)), attitude % len(MODES)
            judged = judge_with(asked, FAULTS[j], MODES[k], rng)
            counts[j, k, str(judged.verdict)] += 1
            if judged.verdict is Verdict.WRONG:
                off_px = judged.cross_rad / asked.camera.pixel_rad
                wrong.append(
                    f"{shard.camera}, {asked.setting.chain}, {FAULTS[j].title}, {MODES[k].value}: {judged.false_matches} false "
                    f"of {judged.false_matches + judged.matched} names, {off_px:.1f} px off; generator {key}"
                )
        return Verdicts(dict(counts), tuple(wrong))
