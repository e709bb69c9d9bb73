"""Long "never wrong" campaign: many random attitudes per camera, each with one fault and mode, for the camera's chain
and the reference chain.

The work is divided into shards that any process can run in any order and repeatedly. The verdicts of a shard depend
only on camera, chain, seed and shard number. Both chains of a camera get the same centroid lists.
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
from validation.never_wrong.faults import FAULTS
from validation.never_wrong.sky import SETTINGS, Setting, Subject, subject
from validation.never_wrong.table import MODES, judge_with

SHARD = 250
"""Number of attitudes per shard."""
OWN = "own"
CHAINS = (OWN, reference.NAME)
CAMERAS = tuple(s.camera for s in SETTINGS if s.chain != reference.NAME)
_STREAM = 910
_WEIGHT = np.array([f.share for f in FAULTS]) / sum(f.share for f in FAULTS)


@dataclass(frozen=True)
class Shard:
    """A block of attitudes for one camera and one of its two chains."""

    camera: str
    chain: str
    seed: int
    number: int


@dataclass(frozen=True)
class Verdicts:
    """Results of a shard: counts by (fault index, mode index, verdict), and a text for every wrong result."""

    counts: dict[tuple[int, int, str], int]
    wrong: tuple[str, ...]


@dataclass(frozen=True)
class ListCase:
    """What one attitude number stands for: indices of its fault and mode, and the generator of its other random numbers, whose
    seed is ``key``."""

    key: tuple[int, ...]
    fault: int
    mode: int
    rng: np.random.Generator


def list_case(seed: int, camera: str, attitude: int) -> ListCase:
    """Return the case of an attitude number of a campaign."""
    key = seed, _STREAM, CAMERAS.index(camera), attitude
    rng = np.random.default_rng(key)
    return ListCase(key, int(rng.choice(len(FAULTS), p=_WEIGHT)), attitude % len(MODES), rng)


def shards(
    attitudes: int, seed: int, cameras: tuple[str, ...] = CAMERAS, chains: tuple[str, ...] = CHAINS
) -> list[Shard]:
    """Return all shards of a campaign in an order in which all cameras and chains advance evenly."""
    numbers = range(-(-attitudes // SHARD))
    return [Shard(camera, chain, seed, n) for n in numbers for camera in cameras for chain in chains]


def setting_of(camera: str, chain: str) -> Setting:
    """Return the camera's setting for the given chain."""
    match = next((s for s in SETTINGS if s.camera == camera and s.chain != reference.NAME), None)
    if match is None:
        raise NotFound("unknown camera of the campaign", expected=" | ".join(CAMERAS), got=camera)
    return match if chain == OWN else replace(match, chain=reference.NAME)


class Campaign:
    """Runs shards and caches the chains, because building their tables takes longer than running them."""

    def __init__(self, stars: StarTable) -> None:
        self._made = lru_cache(maxsize=None)(lambda camera, chain: subject(setting_of(camera, chain), stars))

    def subject(self, camera: str, chain: str) -> Subject:
        """Return the cached chain with that camera."""
        return self._made(camera, chain)

    def run(self, shard: Shard, faults: tuple[str, ...] = ()) -> Verdicts:
        """Score every attitude of a shard, or only those with one of the ``faults``."""
        subject = self.subject(shard.camera, shard.chain)
        counts: Counter[tuple[int, int, str]] = Counter()
        wrong = []
        for attitude in range(shard.number * SHARD, (shard.number + 1) * SHARD):
            case = list_case(shard.seed, shard.camera, attitude)
            fault, mode = FAULTS[case.fault], MODES[case.mode]
            if faults and fault.title not in faults:
                continue
            judged = judge_with(subject, fault, mode, case.rng)
            counts[case.fault, case.mode, str(judged.verdict)] += 1
            if judged.verdict is Verdict.WRONG:
                off_px = judged.cross_rad / subject.camera.pixel_rad
                wrong.append(
                    f"{shard.camera}, {subject.setting.chain}, {fault.title}, {mode.value}: {judged.false_matches} false "
                    f"of {judged.false_matches + judged.matched} matches, boresight error {off_px:.1f} px; "
                    f"generator {list(case.key)}"
                )
        return Verdicts(dict(counts), tuple(wrong))
