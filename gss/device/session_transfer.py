"""One transfer on the host: content, progress and state, with the request ids and messages that it uses."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from gss.device.protocol.chunk_size import smaller_chunk_bytes
from gss.device.protocol.transfer import ChunkReceiver, ChunkSender, Compatibility, chunk_count
from gss.device.session_events import Direction, Ranges, TransferState, TransferUpdate
from gss.domain.errors import BadInput
from gss.instruments.dictionary.definitions import Value

RATE_SPAN_S = 4.0
ENDED = (
    TransferState.VERIFIED,
    TransferState.COMMITTED,
    TransferState.ACTIVE,
    TransferState.FAILED,
    TransferState.ABORTED,
)
MOVING = (TransferState.OPENING, TransferState.TRANSFERRING, TransferState.VERIFYING, TransferState.LINK_LOST)
NO_HASH = bytes(32)


class RequestIds:
    """Returns consecutive request ids, skipping 0 (unsolicited)."""

    def __init__(self, following: int) -> None:
        self.following = following

    def __call__(self) -> int:
        request_id = self.following
        self.following = request_id % 0xFFFF_FFFF + 1
        return request_id


@dataclass(frozen=True)
class ServiceMessage:
    """A service message to send."""

    service: str
    request_id: int
    values: Mapping[str, Value]
    lists: Mapping[str, list[Mapping[str, Value]]] = field(default_factory=dict)


@dataclass(frozen=True)
class HeldPart:
    """Data of an interrupted download: hash and chunk size (from its last update), bytes, and the valid ranges."""

    sha256: str
    chunk_bytes: int
    data: bytes
    ranges: Ranges


@dataclass(frozen=True)
class Part:
    """Requested part of an image, in pixels.

    "region": a rectangle. "star_windows": ``columns`` is the side of the squares, the other fields are 0. All fields 0:
    the complete content.
    """

    col_px: int = 0
    row_px: int = 0
    columns: int = 0
    rows: int = 0


def checked_target(target: int) -> int:
    """Return the slot or bank number. Raises BadInput unless it fits in one byte."""
    if not 0 <= target <= 0xFF:
        raise BadInput("the target is out of range", expected="0 – 255", got=str(target))
    return target


@dataclass
class SessionTransfer:
    """One transfer.

    ``chunk_bytes``: current chunk size; ``wanted_chunk_bytes``: size that the next opening requests. ``grid_is_fixed``:
    True if the chunk size is not adapted to the line, because the owner set it or the device uses a size that differs
    from the requested size. ``waits_for_device``: True if the transfer is paused only until the device has identified
    itself. ``unit``: serial number of the unit to which the transfer belongs, "" before a unit has answered. ``note``:
    reason text shown while transferring.
    """

    id: int
    direction: Direction
    kind: str
    target: int
    chunk_bytes: int
    compatibility: Compatibility = field(default_factory=Compatibility)
    part: Part = field(default_factory=Part)
    data: bytearray = field(default_factory=bytearray)
    size: int = 0
    sha256: bytes = NO_HASH
    state: TransferState = TransferState.QUEUED
    reason: str = ""
    request_id: int = 0
    session: int | None = None
    sender: ChunkSender | None = None
    receiver: ChunkReceiver | None = None
    due_s: float = 0.0
    tries: int = 0
    resent_before: int = 0
    frame_number: int = 0
    resumed: bool = False
    committing: bool = False
    waits_for_device: bool = False
    unit: str = ""
    wanted_chunk_bytes: int = 0
    grid_is_fixed: bool = False
    note: str = ""
    history: deque[tuple[float, int]] = field(default_factory=deque)
    reported_s: float = -1e9
    changed: bool = True

    def __post_init__(self) -> None:
        self.wanted_chunk_bytes = self.wanted_chunk_bytes or self.chunk_bytes

    def take_held(self, partial: HeldPart) -> None:
        """Continue an earlier download: only missing chunks are requested if the content is unchanged."""
        self.data, self.size = bytearray(partial.data), len(partial.data)
        self.chunk_bytes, self.sha256 = partial.chunk_bytes, bytes.fromhex(partial.sha256)
        numbers = [i for first, last in partial.ranges for i in range(first, last + 1)]
        self.receiver = ChunkReceiver(self.size, self.chunk_bytes, 1, numbers)

    def take_content(self, data: bytes) -> None:
        """Set the content of an upload."""
        self.data, self.size, self.sha256 = bytearray(data), len(data), hashlib.sha256(data).digest()

    @property
    def chunks(self) -> int:
        """Number of chunks, 0 until the size is known."""
        return chunk_count(self.size, self.chunk_bytes) if self.size else 0

    def stored(self) -> tuple[Ranges, int]:
        """Return the chunk ranges and the number of bytes that the receiving end has stored."""
        chunks = self.sender.stored if self.sender else self.receiver.stored if self.receiver else None
        if chunks is None:
            return (), 0
        return chunks.ranges()[0], chunks.stored_bytes(self.size, self.chunk_bytes)

    @property
    def holds_any(self) -> bool:
        """True if the receiving end has stored any data."""
        return self.stored()[1] > 0

    def smaller_chunks(self) -> int | None:
        """Return a smaller chunk size if this session's losses justify reopening with it, otherwise None."""
        if self.grid_is_fixed:
            return None
        if self.sender is not None:
            return smaller_chunk_bytes(self.chunk_bytes, self.sender.lost, self.sender.settled)
        if self.receiver is not None:
            return smaller_chunk_bytes(self.chunk_bytes, self.receiver.requested_again, self.receiver.settled)
        return None

    @property
    def resent(self) -> int:
        """Number of chunks sent again (uplink) or requested again (downlink)."""
        now = self.sender.resent if self.sender else self.receiver.requested_again if self.receiver else 0
        return self.resent_before + now

    def to(self, state: TransferState, reason: str = "") -> None:
        """Change the state; the next poll reports it."""
        self.state, self.reason, self.changed = state, reason, True

    def update(self, now_s: float, line_bytes_s: float | None) -> TransferUpdate:
        """Return the current state as an event."""
        ranges, stored_bytes = self.stored()
        rate = self._rate_bytes_s(stored_bytes, now_s)
        return TransferUpdate(
            transfer_id=self.id,
            direction=self.direction,
            kind=self.kind,
            target=self.target,
            state=self.state,
            reason=self.reason,
            size=self.size,
            chunk_size=self.chunk_bytes,
            chunks=self.chunks,
            stored=ranges,
            stored_bytes=stored_bytes,
            in_flight=self.sender.in_flight if self.sender else 0,
            resent=self.resent,
            rate_bytes_s=rate,
            line_share=rate / line_bytes_s if line_bytes_s else None,
            left_s=(self.size - stored_bytes) / rate if rate > 0 else None,
            sha256=self.sha256.hex() if self.sha256 != NO_HASH else "",
            frame_number=self.frame_number,
            resumed=self.resumed,
        )

    def _rate_bytes_s(self, stored_bytes: int, now_s: float) -> float:
        if self.state is not TransferState.TRANSFERRING:
            self.history.clear()
            return 0.0
        self.history.append((now_s, stored_bytes))
        while now_s - self.history[0][0] > RATE_SPAN_S:
            self.history.popleft()
        first_s, first_bytes = self.history[0]
        return (stored_bytes - first_bytes) / (now_s - first_s) if now_s > first_s else 0.0
