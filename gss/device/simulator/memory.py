"""Persistent memory of the device: catalogue and table banks in flash, and a small non-volatile record."""

from __future__ import annotations

import hashlib
import json
import mmap
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path

from gss.device.simulator.flash import SECTOR_BYTES, Flash, FlashError
from gss.device.simulator.flash_record import (
    BANK_BYTES,
    BANKS,
    FACTORY,
    GOLDEN,
    TABLE_BANKS,
    TABLES,
    TRIPLET_BYTES,
    BankRecord,
    InUse,
    NonVolatileRecord,
    StoredRequest,
    SuspendedUpload,
    area_name,
    record_from_json,
)
from gss.device.tables import BAD_PIXEL_BYTES, TABLE_BYTES

__all__ = [
    "BANKS",
    "BANK_BYTES",
    "FACTORY",
    "GOLDEN",
    "SECTOR_BYTES",
    "TABLES",
    "TABLE_BANKS",
    "BankRecord",
    "Flash",
    "FlashError",
    "Memory",
    "StoredRequest",
    "SuspendedUpload",
]


KEPT_REQUESTS = 64


@lru_cache(maxsize=8)
def _layout(bank_bytes: int) -> dict[str, tuple[int, int]]:
    """Return offset and capacity of every bank by name: catalogues, then tables."""
    capacities = {**dict.fromkeys(BANKS, bank_bytes)}
    larger = {"triplets": TRIPLET_BYTES, "bad_pixels": BAD_PIXEL_BYTES}
    capacities |= {area_name(t, b): larger.get(t, TABLE_BYTES) for t in TABLES for b in TABLE_BANKS}
    offsets, at = {}, 0
    for name, size in capacities.items():
        offsets[name] = (at, size)
        at += -(-size // SECTOR_BYTES) * SECTOR_BYTES
    return offsets


def flash_bytes(bank_bytes: int) -> int:
    """Return the size of the flash in bytes."""
    return max(offset + -(-size // SECTOR_BYTES) * SECTOR_BYTES for offset, size in _layout(bank_bytes).values())


class Memory:
    """Banks and record in flash. ``save``: stores the record's JSON text persistently."""

    def __init__(
        self, flash: Flash, record: NonVolatileRecord, save: Callable[[str], None], bank_bytes: int = BANK_BYTES
    ) -> None:
        self.flash, self.record, self._save, self.bank_bytes = flash, record, save, bank_bytes

    @classmethod
    def in_ram(cls, bank_bytes: int = BANK_BYTES) -> Memory:
        """Return a new memory in RAM."""
        return cls(
            Flash(bytearray(b"\xff" * (flash_bytes(bank_bytes)))), NonVolatileRecord(), lambda _: None, bank_bytes
        )

    @classmethod
    def in_directory(cls, directory: Path, bank_bytes: int = BANK_BYTES) -> Memory:
        """Return a memory stored in two files, which are created if missing."""
        directory.mkdir(parents=True, exist_ok=True)
        image, notes = directory / "flash.bin", directory / "record.json"
        size = flash_bytes(bank_bytes)
        if not image.exists() or image.stat().st_size != size:
            image.write_bytes(b"\xff" * size)
            notes.unlink(missing_ok=True)
        with image.open("r+b") as file:
            cells = mmap.mmap(file.fileno(), size)
        record = record_from_json(notes.read_text()) if notes.exists() else NonVolatileRecord()

        def save(text: str) -> None:
            part = notes.with_suffix(".part")
            part.write_text(text)
            part.replace(notes)

        return cls(Flash(cells), record, save, bank_bytes)

    def save(self) -> None:
        """Save the record persistently."""
        self._save(json.dumps(asdict(self.record)))

    def offset(self, bank: str) -> int:
        """Return the offset of a catalogue bank or table bank."""
        return _layout(self.bank_bytes)[bank][0]

    def capacity(self, bank: str) -> int:
        """Return the capacity of a bank in bytes."""
        return _layout(self.bank_bytes)[bank][1]

    def content(self, bank: str) -> bytes:
        """Return the content of a bank; its record states the length."""
        return self.flash.read(self.offset(bank), self.record.banks[bank].size)

    def hash_of(self, bank: str) -> str:
        """Return the SHA-256 of a bank's current content, hexadecimal."""
        return hashlib.sha256(self.content(bank)).hexdigest()

    def intact(self, bank: str) -> bool:
        """True if a bank is committed and its content matches its record."""
        content = self.record.banks[bank]
        return content.state == "committed" and self.hash_of(bank) == content.sha256

    def set_state(self, bank: str, state: str) -> None:
        """Store the state of a bank after a read-back."""
        self.record.banks[bank] = replace(self.record.banks[bank], state=state)
        self.save()

    def erase_bank(self, bank: str) -> None:
        """Erase a bank, its record and its unfinished upload."""
        self.flash.erase(self.offset(bank), self.capacity(bank))
        self.record.banks[bank] = BankRecord()
        self.record.uploads.pop(bank, None)
        self.save()

    def burn(self, bank: str, image: bytes, record: BankRecord) -> None:
        """Program a bank as at the factory."""
        self.erase_bank(bank)
        self.flash.program(self.offset(bank), image)
        digest = hashlib.sha256(image).hexdigest()
        self.record.banks[bank] = replace(record, state="committed", size=len(image), sha256=digest)
        self.save()

    def activate(self, bank: str) -> None:
        """Activate another bank on trial."""
        self.record.previous = self.record.active
        self.record.active, self.record.unconfirmed = bank, True
        self.save()

    def confirm(self) -> None:
        """Keep the active bank."""
        self.record.unconfirmed = False
        self.save()

    def fall_back(self) -> str:
        """Activate the previous bank, or the golden bank if the previous one is damaged. Returns the name of the
        bank."""
        bank = self.record.previous if self.intact(self.record.previous) else GOLDEN
        self.record.active, self.record.previous, self.record.unconfirmed = bank, self.record.active, False
        self.save()
        return bank

    def activate_table(self, table: str, bank: str) -> None:
        """Activate another bank of a table on trial."""
        self.record.tables[table] = InUse(bank, self.record.tables[table].active, True)
        self.save()

    def confirm_table(self, table: str) -> None:
        """Keep the active table."""
        self.record.tables[table] = replace(self.record.tables[table], unconfirmed=False)
        self.save()

    def fall_back_table(self, table: str) -> str:
        """Activate the table's previous bank, or the factory bank if the previous one is damaged. Returns the name of
        the bank."""
        used = self.record.tables[table]
        bank = used.previous if self.intact(area_name(table, used.previous)) else FACTORY
        self.record.tables[table] = InUse(bank, used.active, False)
        self.save()
        return bank

    def remember(self, request: StoredRequest) -> None:
        """Store a request with its report; only the ``KEPT_REQUESTS`` with the highest ids are kept."""
        record = self.record
        requests = [r for r in record.requests if r.request_id != request.request_id]
        requests = sorted([*requests, request], key=lambda r: r.request_id)
        dropped, record.requests = requests[:-KEPT_REQUESTS], requests[-KEPT_REQUESTS:]
        if dropped:
            record.forgotten_request_id = max(record.forgotten_request_id, dropped[-1].request_id)

    def request(self, request_id: int) -> StoredRequest | None:
        """Return a stored request, or None."""
        return next((r for r in self.record.requests if r.request_id == request_id), None)

    @property
    def used_bytes(self) -> int:
        """Number of flash bytes that catalogues and tables occupy."""
        return sum(b.size for b in self.record.banks.values())
