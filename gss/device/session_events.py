"""Events that a host session reports to its owner. They contain only data from the line; the owner adds UTC times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypedDict

from gss.device.protocol.packet import Arrival
from gss.instruments.dictionary.definitions import Value

Ranges = tuple[tuple[int, int], ...]
"""Ranges of chunk numbers, first and last inclusive, ascending and disjoint."""


class Stage(StrEnum):
    """Stage of a command. REJECTED, COMPLETED and FAILED are final. UNKNOWN can still change after a late report or a
    retry."""

    QUEUED = "queued"
    RELEASED = "released"
    SENT = "sent"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    STARTED = "started"
    PROGRESS = "progress"
    COMPLETED = "completed"
    FAILED = "failed"
    UNKNOWN = "unknown"


FINAL_STAGES = (Stage.REJECTED, Stage.COMPLETED, Stage.FAILED)


class TransferState(StrEnum):
    """State of a transfer. A download ends VERIFIED, an upload COMMITTED and later ACTIVE."""

    QUEUED = "queued"
    OPENING = "opening"
    TRANSFERRING = "transferring"
    PAUSED = "paused"
    LINK_LOST = "link_lost"
    VERIFYING = "verifying"
    VERIFIED = "verified"
    COMMITTED = "committed"
    ACTIVE = "active"
    FAILED = "failed"
    ABORTED = "aborted"


class Direction(StrEnum):
    """Direction as seen from the ground."""

    UP = "up"
    DOWN = "down"


class ReportFacts(TypedDict, total=False):
    """Fields of a :class:`CommandUpdate` that a report of the device sets."""

    device_time_s: float
    reason: str
    detail: str
    progress: int
    replayed: bool
    values: Mapping[str, Value]


LONGEST_UNIT_NAME = 80
"""Characters of a unit's name that are stored."""


@dataclass(frozen=True)
class CommandUpdate:
    """Event: a command reached a stage.

    ``device_time_s``: device time in the report, None for stages that the host sets. ``reason``: name of a rejection or
    failure in the dictionary, "" otherwise. ``detail``: a sentence. ``values``: the command's returned values, at
    COMPLETED. ``progress``: percent, at PROGRESS. ``late``: received after the timeout. ``replayed``: the device
    repeated a stored report. ``attempt``: 1 for the first sending. ``arguments``: all arguments of the command. ``unit``:
    name of the unit to which it was sent, "" if not known, as for ABORT.
    """

    request_id: int
    name: str
    stage: Stage
    device_time_s: float | None = None
    reason: str = ""
    detail: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    progress: int = 0
    late: bool = False
    replayed: bool = False
    attempt: int = 1
    arguments: Mapping[str, Value] = field(default_factory=dict)
    unit: str = ""


@dataclass(frozen=True)
class Telemetry:
    """One telemetry packet.

    ``device_time_s``: time of the device's clock, 0 = not reported. ``request_id``: id of the command that caused the
    packet, 0 = unsolicited. ``raw``: values as on the wire; ``values``: in engineering units, enumerations by name.
    ``lists``: rows of each list, by the list's name. ``arrival``: latest packet of its type, delayed, or repeated on the
    line.
    """

    packet: str
    device_time_s: float
    request_id: int
    raw: Mapping[str, Value]
    values: Mapping[str, Value]
    lists: Mapping[str, tuple[Mapping[str, Value], ...]] = field(default_factory=dict)
    simulator_only: bool = False
    arrival: Arrival = Arrival.CURRENT


@dataclass(frozen=True)
class DeviceEvent:
    """An event reported by the device. ``severity``: ok, watch, warning, critical. ``device_time_s``: time of the device's
    clock, 0 = not reported."""

    name: str
    severity: str
    text: str
    device_time_s: float
    request_id: int = 0


@dataclass(frozen=True)
class TransferUpdate:
    """Current state of a transfer.

    ``stored``, ``stored_bytes``: chunks and bytes that the *receiving* end has stored. ``rate_bytes_s``: stored bytes
    per second over the last seconds, 0 while unknown. ``line_share``: rate as a fraction of the line's rate, None if
    the line has no rate. ``resent``: chunks sent again (uplink) or requested again (downlink).
    """

    transfer_id: int
    direction: Direction
    kind: str
    target: int
    state: TransferState
    reason: str
    size: int
    chunk_size: int
    chunks: int
    stored: Ranges
    stored_bytes: int
    in_flight: int
    resent: int
    rate_bytes_s: float
    line_share: float | None
    left_s: float | None
    sha256: str
    frame_number: int
    resumed: bool


@dataclass(frozen=True)
class TransferDone:
    """Event: a download is complete and its hash is correct, or an upload is committed. ``data``: the transferred
    content."""

    transfer_id: int
    direction: Direction
    kind: str
    target: int
    frame_number: int
    data: bytes
    sha256: str


@dataclass(frozen=True)
class HelloReceived:
    """Event: the device identified itself. If ``dictionary_match`` is False, commanding is blocked until a user
    acknowledges the mismatch. ``simulated``: None if the protocol does not report it."""

    device_model: str
    profile: str
    firmware: str
    serial: str
    simulated: bool | None
    dictionary_hash: str
    dictionary_match: bool
    line_baud: int
    columns: int
    rows: int
    bits: int
    image_slots: int
    bank_bytes: int
    boot_count: int
    last_request_id: int
    device_time_s: float

    @property
    def unit_name(self) -> str:
        """Name under which the unit is stored: its serial number, or instrument and model if it has none."""
        return (self.serial or f"{self.profile} {self.device_model}")[:LONGEST_UNIT_NAME]


@dataclass(frozen=True)
class DirectionCounters:
    """Counters of one direction. For sent packets only ``bytes`` and ``good`` are counted; the device counts the
    damage.

    ``unknown``: undefined APID, packet type or direction. ``undecodable``: intact packets whose code or content the
    dictionary does not define. ``gaps``, ``duplicates``: packets missing and repeated according to their sequence
    counts. ``repeated_ids``: reports that add no information about a request id, including replays.
    """

    bytes: int = 0
    good: int = 0
    bad_crc: int = 0
    too_long: int = 0
    too_short: int = 0
    unframed: int = 0
    unknown: int = 0
    gaps: int = 0
    duplicates: int = 0
    undecodable: int = 0
    repeated_ids: int = 0

    @property
    def bad(self) -> int:
        """Number of packets that could not be used."""
        return self.bad_crc + self.too_long + self.too_short


@dataclass(frozen=True)
class LinkCounters:
    """Counters of both directions, and the time of the last intact packet on the clock of the session's caller."""

    sent: DirectionCounters
    received: DirectionCounters
    last_good_s: float | None


SessionEvent = CommandUpdate | Telemetry | DeviceEvent | TransferUpdate | TransferDone | HelloReceived | LinkCounters
