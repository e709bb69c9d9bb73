"""What the device remembers: flash with erase-before-write, catalogue banks in it, and a small non-volatile record."""

from __future__ import annotations

import hashlib
import json
import mmap
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

SECTOR_BYTES = 4096
BANK_BYTES = 192 * 1024
BANKS = ("A", "B", "C", "golden")
GOLDEN = "golden"
KEPT_REQUESTS = 64


class FlashError(Exception):
    """A cell was to be set from 0 to 1 without erasing its sector."""


class Flash:
    """Bytes whose bits programming can only clear. ``cells`` is a bytearray, or a file mapped into memory."""

    def __init__(self, cells: bytearray | mmap.mmap) -> None:
        self._cells: Any = cells

    def __len__(self) -> int:
        return len(self._cells)

    def read(self, offset: int, count: int) -> bytes:
        """Bytes as they are."""
        return bytes(self._cells[offset : offset + count])

    def erase(self, offset: int, count: int) -> None:
        """All sectors that the range touches become FF."""
        first = offset // SECTOR_BYTES * SECTOR_BYTES
        last = -(-(offset + count) // SECTOR_BYTES) * SECTOR_BYTES
        self._cells[first:last] = b"\xff" * (last - first)

    def program(self, offset: int, data: bytes) -> None:
        """Clear bits; writing the same data twice is harmless, other data over old is a FlashError."""
        old = np.frombuffer(self.read(offset, len(data)), np.uint8)
        new = old & np.frombuffer(data, np.uint8)
        self._cells[offset : offset + len(data)] = new.tobytes()
        if new.tobytes() != data:
            raise FlashError(f"flash at {offset} was not erased")

    def flip(self, offset: int, bit: int = 0) -> None:
        """Radiation: one bit changes."""
        self._cells[offset] = self._cells[offset] ^ (1 << bit)


@dataclass(frozen=True)
class BankRecord:
    """What is known about a bank's content; ``sha256`` of the first ``size`` bytes, hexadecimal."""

    state: str = "empty"
    size: int = 0
    sha256: str = ""
    stars: int = 0
    pairs: int = 0
    epoch_jyear: float = 0.0
    format_version: int = 0
    profile: str = ""


@dataclass(frozen=True)
class SuspendedUpload:
    """A write into a bank that is not finished; ``held``: chunk ranges that are surely in flash."""

    size: int
    chunk_bytes: int
    sha256: str
    held: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class StoredRequest:
    """A command that was seen: digest of code and arguments, and its last report, hexadecimal payload."""

    request_id: int
    code: int
    digest: str
    report: str


@dataclass
class Record:
    """The non-volatile record; survives resets and restarts."""

    boots: int = 0
    resets: int = 0
    reset_cause: str = "power_on"
    time_base_s: float = 0.0
    frames: int = 0
    next_session: int = 1
    last_request_id: int = 0
    active: str = GOLDEN
    previous: str = GOLDEN
    unconfirmed: bool = False
    banks: dict[str, BankRecord] = field(default_factory=lambda: {b: BankRecord() for b in BANKS})
    uploads: dict[str, SuspendedUpload] = field(default_factory=dict)
    requests: list[StoredRequest] = field(default_factory=list)


class Memory:
    """Banks and record over flash. ``save``: called with the record as JSON text whenever it must last."""

    def __init__(self, flash: Flash, record: Record, save: Callable[[str], None], bank_bytes: int = BANK_BYTES) -> None:
        self.flash, self.record, self._save, self.bank_bytes = flash, record, save, bank_bytes

    @classmethod
    def in_ram(cls, bank_bytes: int = BANK_BYTES) -> Memory:
        """Fresh memory for tests."""
        return cls(Flash(bytearray(b"\xff" * (len(BANKS) * bank_bytes))), Record(), lambda _: None, bank_bytes)

    @classmethod
    def in_directory(cls, directory: Path, bank_bytes: int = BANK_BYTES) -> Memory:
        """Memory in two files, made where they are missing."""
        directory.mkdir(parents=True, exist_ok=True)
        image, notes = directory / "flash.bin", directory / "record.json"
        size = len(BANKS) * bank_bytes
        if not image.exists() or image.stat().st_size != size:
            image.write_bytes(b"\xff" * size)
            notes.unlink(missing_ok=True)
        with image.open("r+b") as file:
            cells = mmap.mmap(file.fileno(), size)
        record = record_from_json(notes.read_text()) if notes.exists() else Record()

        def save(text: str) -> None:
            part = notes.with_suffix(".part")
            part.write_text(text)
            part.replace(notes)

        return cls(Flash(cells), record, save, bank_bytes)

    def save(self) -> None:
        """Make the record last."""
        self._save(json.dumps(asdict(self.record)))

    def offset(self, bank: str) -> int:
        """Where a bank begins."""
        return BANKS.index(bank) * self.bank_bytes

    def content(self, bank: str) -> bytes:
        """What a bank holds now, at the length its record says."""
        return self.flash.read(self.offset(bank), self.record.banks[bank].size)

    def hash_of(self, bank: str) -> str:
        """SHA-256 of a bank's content as it reads now."""
        return hashlib.sha256(self.content(bank)).hexdigest()

    def intact(self, bank: str) -> bool:
        """Does the content match its record?"""
        held = self.record.banks[bank]
        return held.state == "committed" and self.hash_of(bank) == held.sha256

    def set_state(self, bank: str, state: str) -> None:
        """Note what a read-back found."""
        self.record.banks[bank] = replace(self.record.banks[bank], state=state)
        self.save()

    def erase_bank(self, bank: str) -> None:
        """Empty a bank, its record and its unfinished upload."""
        self.flash.erase(self.offset(bank), self.bank_bytes)
        self.record.banks[bank] = BankRecord()
        self.record.uploads.pop(bank, None)
        self.save()

    def burn(self, bank: str, image: bytes, record: BankRecord) -> None:
        """Factory programming."""
        self.erase_bank(bank)
        self.flash.program(self.offset(bank), image)
        digest = hashlib.sha256(image).hexdigest()
        self.record.banks[bank] = replace(record, state="committed", size=len(image), sha256=digest)
        self.save()

    def activate(self, bank: str) -> None:
        """Use another bank from now on, on trial."""
        self.record.previous = self.record.active
        self.record.active, self.record.unconfirmed = bank, True
        self.save()

    def confirm(self) -> None:
        """Keep the active bank."""
        self.record.unconfirmed = False
        self.save()

    def fall_back(self) -> str:
        """Return to the bank before and say which; the factory bank where that one is damaged."""
        bank = self.record.previous if self.intact(self.record.previous) else GOLDEN
        self.record.active, self.record.previous, self.record.unconfirmed = bank, self.record.active, False
        self.save()
        return bank

    def remember(self, request: StoredRequest) -> None:
        """Keep the last requests with their reports."""
        kept = [r for r in self.record.requests if r.request_id != request.request_id]
        self.record.requests = [*kept, request][-KEPT_REQUESTS:]

    def request(self, request_id: int) -> StoredRequest | None:
        """A request that was seen before."""
        return next((r for r in self.record.requests if r.request_id == request_id), None)

    @property
    def used_bytes(self) -> int:
        """Flash in use by catalogues."""
        return sum(b.size for b in self.record.banks.values())


def record_from_json(text: str) -> Record:
    """The record as :meth:`Memory.save` wrote it."""
    raw = json.loads(text)
    raw["banks"] = {name: BankRecord(**value) for name, value in raw["banks"].items()}
    raw["uploads"] = {
        name: SuspendedUpload(**(value | {"held": tuple(map(tuple, value["held"]))}))
        for name, value in raw["uploads"].items()
    }
    raw["requests"] = [StoredRequest(**value) for value in raw["requests"]]
    return Record(**raw)
