"""The ground's half of a contact, without any input or output: bytes and a clock in, bytes and events out.

``HostSession`` keeps commands (queue, windows, retries), transfers and counters. It owns no thread and no port: an owner
calls ``feed`` with what arrived and ``poll`` often (10–50 ms) and writes what poll returns. All times are ``now_s`` of
the owner's monotonic clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gss.device.dictionary import Dictionary, Value
from gss.device.session_events import (
    CommandStage,
    DeviceEvent,
    Direction,
    DirectionCounters,
    HelloReceived,
    LinkCounters,
    Ranges,
    SessionEvent,
    Stage,
    Telemetry,
    TransferDone,
    TransferState,
    TransferUpdate,
)
from gss.device.protocol.transfer import Compatibility

__all__ = [
    "CommandStage",
    "Compatibility",
    "DeviceEvent",
    "Direction",
    "DirectionCounters",
    "HelloReceived",
    "HostSession",
    "InFlight",
    "LinkCounters",
    "Ranges",
    "SessionEvent",
    "Stage",
    "Telemetry",
    "TransferDone",
    "TransferState",
    "TransferUpdate",
]


class HostSession:
    """One device on one line. See the module's text; methods raise BadInput, NotFound or Conflict and then change nothing."""

    def __init__(self, dictionary: Dictionary, *, next_request_id: int = 1, next_transfer_id: int = 1) -> None: ...

    # --- commands -----------------------------------------------------------------------------------------------

    def submit(self, name: str, arguments: Mapping[str, Value], now_s: float) -> int:
        """Queue a command and return its request id. Missing arguments take their default.

        BadInput "0 – 255, got 300" out of range; Conflict while the dictionaries differ and nobody acknowledged it.
        """

    def preview(self, name: str, arguments: Mapping[str, Value]) -> list[tuple[str, bytes]]:
        """Dry run: the packet before framing as labelled groups; an argument's group has its name as label.

        The request id shown is the one the next submit would take.
        """

    def retry(self, request_id: int, now_s: float) -> None:
        """Send the same bytes with the same id once more; Conflict unless the command is unknown."""

    def abort(self, now_s: float) -> int:
        """ABORT ahead of everything, never blocked. Returns its request id."""

    def acknowledge_mismatch(self) -> None:
        """The operator accepts that the device has another dictionary; commands go out with the device's prefix."""

    def restore(
        self, next_request_id: int, in_flight: Sequence[tuple[int, str, Mapping[str, Value]]], next_transfer_id: int = 1
    ) -> None:
        """After a restart: seed the ids; (request id, name, arguments) come back as unknown and may be retried."""

    # --- transfers ----------------------------------------------------------------------------------------------

    def start_download(
        self, kind: str, slot: int, now_s: float, *, held: tuple[str, Mapping[int, bytes]] | None = None
    ) -> int:
        """Queue a download ("frame", "thumbnail", "catalogue") and return its transfer id.

        ``held``: (sha256, chunks by number) of an earlier, broken attempt; only the rest is asked for if the content is
        still the same.
        """

    def start_upload(self, kind: str, target: int, data: bytes, compatibility: Compatibility, now_s: float) -> int:
        """Queue an upload ("catalogue" to a bank number, "image" to a slot); verify and commit follow by themselves.

        The same data to the same target after a break resumes with what the device still holds.
        """

    def pause_transfer(self, transfer_id: int, now_s: float) -> None:
        """Stop sending; Conflict unless it is queued, opening, transferring or link_lost."""

    def resume_transfer(self, transfer_id: int, now_s: float) -> None:
        """Go on with a paused, link_lost or failed transfer."""

    def abort_transfer(self, transfer_id: int, now_s: float) -> None:
        """Give a transfer up on both sides; what was received stays readable with ``partial``."""

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """What a download holds: (size,) bytes with zeros where chunks miss, and the held chunk ranges."""

    def transfer(self, transfer_id: int) -> TransferUpdate:
        """The transfer as it stands; NotFound otherwise."""

    def forget_transfer(self, transfer_id: int) -> None:
        """Free the memory of a transfer that has ended."""

    # --- line ---------------------------------------------------------------------------------------------------

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        """Take bytes from the line. Never raises, whatever they are."""

    def poll(self, now_s: float) -> tuple[bytes, list[SessionEvent]]:
        """Bytes to write now, and what time alone brought (windows closed, transfers suspended, progress)."""

    def link_lost(self, now_s: float) -> list[SessionEvent]:
        """The owner lost the port: commands under way become unknown, transfers link_lost."""

    def link_up(self, now_s: float) -> None:
        """The owner has a port (again): parsers start clean, HELLO is queued, suspended transfers resume after it."""

    @property
    def counters(self) -> LinkCounters:
        """Counters since the session was made."""

    @property
    def housekeeping(self) -> Mapping[str, Value] | None:
        """Latest housekeeping in engineering units, for preconditions."""

    @property
    def device_dictionary_hash(self) -> str | None:
        """As the last HELLO said."""
