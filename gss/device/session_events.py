"""What a host session tells its owner. Every record carries only facts from the line; wall-clock times are the owner's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from gss.device.dictionary import Value

Ranges = tuple[tuple[int, int], ...]
"""Chunk numbers, first and last inclusive, ascending and apart."""


class Stage(StrEnum):
    """Where a command is. REJECTED, COMPLETED and FAILED are final; UNKNOWN may still be resolved by a late report or a retry."""

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
    """Where a transfer is. A download ends VERIFIED, an upload COMMITTED and later ACTIVE."""

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
    """Seen from the ground."""

    UP = "up"
    DOWN = "down"


@dataclass(frozen=True)
class CommandStage:
    """A command reached a stage.

    ``device_time_s``: the device's clock in the report, None for stages that the host sets itself. ``reason``: the
    dictionary's word for a rejection or failure, "" otherwise. ``detail``: a sentence. ``values``: the command's returns,
    at COMPLETED. ``progress``: percent at PROGRESS. ``late``: it came after the window had closed. ``replayed``: the device
    repeated a stored report. ``attempt``: 1 for the first sending.
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


@dataclass(frozen=True)
class Telemetry:
    """One telemetry packet. ``request_id`` 0 = sent by itself, otherwise caused by that command. ``raw``: as on the wire;
    ``values``: in engineering units, enumerations by name. ``lists``: rows of each list, by the list's name."""

    packet: str
    device_time_s: float
    request_id: int
    raw: Mapping[str, Value]
    values: Mapping[str, Value]
    lists: Mapping[str, tuple[Mapping[str, Value], ...]] = field(default_factory=dict)
    simulator_only: bool = False


@dataclass(frozen=True)
class DeviceEvent:
    """Something happened on board. ``severity``: ok, watch, warning, critical."""

    name: str
    severity: str
    text: str
    device_time_s: float
    request_id: int = 0


@dataclass(frozen=True)
class TransferUpdate:
    """A transfer as it stands. ``stored``: what the *receiving* side says it stored. ``stored_bytes`` likewise.
    ``rate_bytes_s``: stored bytes over the last seconds, 0 until known. ``line_share``: of the line's payload rate, None on a
    line without a rate. ``resent``: chunks sent again (up) or asked for again (down)."""

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
    """A download is complete and its hash is right, or an upload is committed (then ``data`` is what was sent)."""

    transfer_id: int
    direction: Direction
    kind: str
    target: int
    frame_number: int
    data: bytes
    sha256: str


@dataclass(frozen=True)
class HelloReceived:
    """The device introduced itself. ``dictionary_match`` False blocks commanding until acknowledged."""

    device_model: str
    profile: str
    firmware: str
    serial: str
    simulated: bool
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


@dataclass(frozen=True)
class DirectionCounters:
    """Counters of one direction. For what is sent only bytes and good move; the device counts its own side.

    ``unknown``: APID, packet type or direction that do not exist. ``undecodable``: good packets whose code or content the
    dictionary does not know. ``gaps``, ``duplicates``: packets missing and packets twice by their sequence counts.
    ``repeated_ids``: reports that brought nothing new of a request id, replays included.
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
        """Packets that could not be used."""
        return self.bad_crc + self.too_long + self.too_short


@dataclass(frozen=True)
class LinkCounters:
    """Both directions, and when something good last came (the owner's ``now_s``)."""

    sent: DirectionCounters
    received: DirectionCounters
    last_good_s: float | None


SessionEvent = CommandStage | Telemetry | DeviceEvent | TransferUpdate | TransferDone | HelloReceived | LinkCounters
