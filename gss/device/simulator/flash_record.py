"""Small non-volatile record of the device: bank contents, active banks, processed requests, schedule."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

BANK_BYTES = 192 * 1024
BANKS = ("A", "B", "C", "golden")
GOLDEN = "golden"
TABLES = ("triplets", "calibration", "parameters", "bad_pixels")
TABLE_BANKS = ("A", "B", "factory")
FACTORY = "factory"
TRIPLET_BYTES = 1536 * 1024


@dataclass(frozen=True)
class BankRecord:
    """Properties of a bank's content; ``sha256`` of the first ``size`` bytes, hexadecimal."""

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
    """An unfinished upload into a bank; ``held``: ranges of the chunks stored in flash."""

    size: int
    chunk_bytes: int
    sha256: str
    held: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class StoredRequest:
    """A processed command: digest of code and arguments, and the payload of its last report, hexadecimal."""

    request_id: int
    code: int
    digest: str
    report: str


@dataclass(frozen=True)
class ScheduleEntry:
    """A scheduled command.

    ``payload``: its arguments, hexadecimal. ``at_s``: device time. ``request_id``: of its SCHEDULE. ``running``: True if it
    has started and not ended; ``state`` and ``reason`` are then those after a reset.
    """

    schedule_id: int
    at_s: float
    command_code: int
    payload: str
    request_id: int
    state: str = "waiting"
    reason: str = "none"
    running: bool = False


@dataclass(frozen=True)
class InUse:
    """Active and previous bank of a table. ``unconfirmed``: True if the active bank still needs confirmation."""

    active: str = FACTORY
    previous: str = FACTORY
    unconfirmed: bool = False


def area_name(table: str, bank: str) -> str:
    """Return the name of a table's bank as a flash area."""
    return f"{table}.{bank}"


TABLE_AREAS = tuple(area_name(t, b) for t in TABLES for b in TABLE_BANKS)


@dataclass
class NonVolatileRecord:
    """Non-volatile record, which survives resets and restarts."""

    boots: int = 0
    resets: int = 0
    reset_cause: str = "power_on"
    time_base_s: float = 0.0
    frames: int = 0
    next_session: int = 1
    last_request_id: int = 0
    accepted_counter: int = 0
    """Highest packet counter accepted by the authentication."""
    forgotten_request_id: int = 0
    """Highest request id whose report is no longer stored; ids up to this value are rejected."""
    active: str = GOLDEN
    previous: str = GOLDEN
    unconfirmed: bool = False
    utc_offset_s: float | None = None
    banks: dict[str, BankRecord] = field(default_factory=lambda: {b: BankRecord() for b in (*BANKS, *TABLE_AREAS)})
    tables: dict[str, InUse] = field(default_factory=lambda: {t: InUse() for t in TABLES})
    next_schedule: int = 1
    schedule: list[ScheduleEntry] = field(default_factory=list)
    uploads: dict[str, SuspendedUpload] = field(default_factory=dict)
    requests: list[StoredRequest] = field(default_factory=list)


def record_from_json(text: str) -> NonVolatileRecord:
    """Return the record that :meth:`Memory.save` wrote."""
    raw = json.loads(text)
    raw["banks"] = {name: BankRecord(**value) for name, value in raw["banks"].items()}
    raw["uploads"] = {
        name: SuspendedUpload(**(value | {"held": tuple(map(tuple, value["held"]))}))
        for name, value in raw["uploads"].items()
    }
    raw["tables"] = {name: InUse(**value) for name, value in raw["tables"].items()}
    raw["schedule"] = [ScheduleEntry(**value) for value in raw["schedule"]]
    raw["requests"] = [StoredRequest(**value) for value in raw["requests"]]
    return NonVolatileRecord(**raw)
