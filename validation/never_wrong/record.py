"""Results of a campaign in one small file, so that the campaign continues on any machine that has the file."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gss.domain.errors import BadInput, Conflict
from validation.never_wrong.frames import FRAME_SHARD, FrameShard
from validation.never_wrong.lists import SHARD, Shard, Verdicts

VERSION = 1
BlockKey = tuple[type[Shard | FrameShard], str, str, int, str]
"""Kind, camera, chain, seed, and fingerprint of the sources."""


@dataclass
class CampaignBlock:
    """Sum of completed shards of one camera, chain, seed and state of the sources. ``shards``: ranges (first, last) of shard
    numbers in ascending order. ``counts``: by (fault index, mode index, verdict). ``wrong``: a text for every wrong result."""

    kind: type[Shard | FrameShard]
    camera: str
    chain: str
    seed: int
    code: str
    shards: list[tuple[int, int]] = field(default_factory=list)
    counts: Counter[tuple[int, int, str]] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Return ``lists`` or ``frames``."""
        return KINDS[self.kind]

    @property
    def key(self) -> BlockKey:
        """Return what distinguishes the block from the others of a file."""
        return self.kind, self.camera, self.chain, self.seed, self.code

    @property
    def title(self) -> str:
        """Return the key for messages."""
        return f"{self.name} of {self.camera}, {self.chain}, seed {self.seed}, sources {self.code}"

    @property
    def cases(self) -> int:
        """Return the number of lists or frames."""
        return self.counts.total()

    def completed(self) -> Iterator[Shard | FrameShard]:
        """Yield the completed shards."""
        for first, last in self.shards:
            for number in range(first, last + 1):
                yield self.kind(self.camera, self.chain, self.seed, number)

    def contains(self, number: int) -> bool:
        """Return whether the shard with this number is completed."""
        return any(first <= number <= last for first, last in self.shards)

    def add(self, number: int, verdicts: Verdicts) -> None:
        """Add a shard that is not in the results."""
        self.counts.update(verdicts.counts)
        self.wrong += verdicts.wrong
        merged: list[tuple[int, int]] = []
        for first, last in sorted([*self.shards, (number, number)]):
            if merged and first == merged[-1][1] + 1:
                merged[-1] = (merged[-1][0], last)
            else:
                merged.append((first, last))
        self.shards = merged


KINDS: dict[type[Shard | FrameShard], str] = {Shard: "lists", FrameShard: "frames"}
SIZES = {"lists": SHARD, "frames": FRAME_SHARD}
"""Cases per shard. The numbers of a file are valid only for the same sizes."""


class CampaignRecord:
    """Completed shards of a campaign, stored in ``file``. A missing file is an empty record. Raises BadInput if the file is
    not a record, or if it contains a shard or the key of a block twice."""

    def __init__(self, file: Path) -> None:
        self._file, self._state = file, _state(file)
        self._blocks: dict[BlockKey, CampaignBlock] = {}
        if file.is_file():
            for block in _read(file):
                self._blocks[block.key] = block

    def blocks(self, seed: int) -> list[CampaignBlock]:
        """Return the blocks of a seed."""
        return [block for block in self._blocks.values() if block.seed == seed]

    def completed(self) -> set[Shard | FrameShard]:
        """Return the completed shards."""
        return {key for block in self._blocks.values() for key in block.completed()}

    def add(self, key: Shard | FrameShard, code: str, verdicts: Verdicts) -> None:
        """Add the verdicts of a shard, and write the file. ``code``: fingerprint of the sources. Raises Conflict if
        another program has changed the file since it was read, or if the record contains the shard, also from other sources.
        """
        if _state(self._file) != self._state:
            raise Conflict(
                "another run has changed the results of the campaign",
                got=str(self._file),
                hint="run one campaign per file",
            )
        block_key = (type(key), key.camera, key.chain, key.seed, code)
        for block in self._blocks.values():
            if block.key[:-1] == block_key[:-1] and block.contains(key.number):
                raise Conflict(f"shard {key.number} is already in the results", got=block.title)
        self._blocks.setdefault(block_key, CampaignBlock(*block_key)).add(key.number, verdicts)
        self._file.parent.mkdir(parents=True, exist_ok=True)
        part = self._file.with_name(self._file.name + ".part")
        part.write_text(self._text(), "utf-8")
        part.replace(self._file)
        self._state = _state(self._file)

    def remove(self, keys: set[Shard | FrameShard]) -> None:
        """Remove the blocks that contain a shard of ``keys``. The file changes when a shard is added. Raises Conflict if they
        also contain other shards, because a sum cannot be divided."""
        kept = {k: block for k, block in self._blocks.items() if keys.isdisjoint(block.completed())}
        lost: Counter[str] = Counter()
        for block in (block for k, block in self._blocks.items() if k not in kept):
            lost[block.name] += SIZES[block.name] * sum(key not in keys for key in block.completed())
        if lost.total():
            raise Conflict(
                "stored results that are not rerun would be lost",
                got=", ".join(f"{count} {name}" for name, count in lost.items() if count),
                hint="store the rerun in another file with --keep",
            )
        self._blocks = kept

    def _text(self) -> str:
        """Return JSON with a line per block."""
        lines = [json.dumps(_as_record(block), ensure_ascii=False) for block in self._blocks.values()]
        head = json.dumps({"version": VERSION, "cases_per_shard": SIZES})
        return f'{head[:-1]}, "blocks": [\n' + ",\n".join(lines) + "\n]}\n"


def _state(file: Path) -> tuple[int, int, int] | None:
    """Return inode, time of modification and size of a file; None if it does not exist."""
    if not file.is_file():
        return None
    stat = file.stat()
    return stat.st_ino, stat.st_mtime_ns, stat.st_size


def _as_record(block: CampaignBlock) -> dict[str, Any]:
    return {
        "kind": block.name,
        "camera": block.camera,
        "chain": block.chain,
        "seed": block.seed,
        "code": block.code,
        "shards": block.shards,
        "counts": [[*cell, number] for cell, number in sorted(block.counts.items())],
        "wrong": block.wrong,
    }


def _read(file: Path) -> list[CampaignBlock]:
    try:
        content = json.loads(file.read_text("utf-8"))
        found = (content["version"], content["cases_per_shard"])
        if found == (VERSION, SIZES):
            return _checked(file, [_from_record(record) for record in content["blocks"]])
    except (ValueError, KeyError, TypeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise BadInput(
            f"{file} is not a file of campaign results", expected="the file of an earlier run", got=reason
        ) from None
    raise BadInput(f"{file} is from another version of the campaign", expected=str((VERSION, SIZES)), got=str(found))


def _checked(file: Path, blocks: list[CampaignBlock]) -> list[CampaignBlock]:
    """Return the blocks. Raises BadInput if a key or a shard is repeated: sums cannot be divided, so that the shard would count
    twice, or a block would replace another one."""
    keys, shards = set[BlockKey](), set[Shard | FrameShard]()
    for block in blocks:
        if block.key in keys:
            raise BadInput(f"{file} contains a block twice", expected="different blocks", got=block.title)
        keys.add(block.key)
        for shard in block.completed():
            if shard in shards:
                raise BadInput(
                    f"{file} contains shard {shard.number} twice", expected="each shard in one block", got=block.title
                )
            shards.add(shard)
    return blocks


def _from_record(record: dict[str, Any]) -> CampaignBlock:
    kinds = {name: kind for kind, name in KINDS.items()}
    return CampaignBlock(
        kinds[record["kind"]],
        record["camera"],
        record["chain"],
        record["seed"],
        record["code"],
        [(first, last) for first, last in record["shards"]],
        Counter({(fault, mode, verdict): number for fault, mode, verdict, number in record["counts"]}),
        list(record["wrong"]),
    )
