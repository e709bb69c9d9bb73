"""Interface for transfers in an exchange session, and its implementation for a sensor without transfers, which rejects
every request."""

from __future__ import annotations

from typing import NoReturn, Protocol

from gss.device.driver import DriverTransfers
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Ranges, TransferDone, TransferUpdate
from gss.device.session_transfer import HeldPart, Part
from gss.domain.errors import Conflict, NotFound


class ExchangeTransfers(DriverTransfers, Protocol):
    """Transfers that share the line with the requests of a session. ``begin`` returns the bytes that start the next
    transfer while the line is free; ``poll`` returns the bytes that continue the current transfer. While
    ``holds_channel`` is true, no request is sent."""

    @property
    def holds_channel(self) -> bool: ...

    def begin(self, now_s: float) -> bytes: ...

    def poll(self, now_s: float) -> bytes: ...

    def lose(self) -> None: ...

    def update(self, transfer_id: int) -> TransferUpdate: ...

    def news(self) -> list[TransferUpdate | TransferDone]: ...


class NoTransfers:
    """The :class:`ExchangeTransfers` of a sensor without transfers."""

    def start_download(
        self,
        kind: str,
        slot: int,
        *,
        partial: HeldPart | None = None,
        chunk_bytes: int | None = None,
        part: Part | None = None,
        paused: str = "",
        unit: str = "",
    ) -> int:
        """Raise Conflict."""
        raise Conflict(f"This sensor cannot send content of type {kind}.")

    def start_upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        *,
        chunk_bytes: int | None = None,
        paused: str = "",
        unit: str = "",
    ) -> int:
        """Raise Conflict."""
        raise Conflict(f"This sensor cannot receive content of type {kind}.")

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """Raise NotFound: no transfer exists."""
        self._none(transfer_id)

    def pause(self, transfer_id: int) -> None:
        """Raise NotFound: no transfer exists."""
        self._none(transfer_id)

    def resume(self, transfer_id: int) -> None:
        """Raise NotFound: no transfer exists."""
        self._none(transfer_id)

    def abort(self, transfer_id: int) -> None:
        """Raise NotFound: no transfer exists."""
        self._none(transfer_id)

    def forget(self, transfer_id: int) -> None:
        """Do nothing."""

    def update(self, transfer_id: int) -> TransferUpdate:
        """Raise NotFound: no transfer exists."""
        self._none(transfer_id)

    holds_channel = False
    """True while a transfer uses the line and requests must wait."""

    def begin(self, now_s: float) -> bytes:
        """Return b"": there is nothing to send."""
        return b""

    def poll(self, now_s: float) -> bytes:
        """Return b"": there is nothing to send."""
        return b""

    def lose(self) -> None:
        """Do nothing."""

    def news(self) -> list[TransferUpdate | TransferDone]:
        """Return an empty list: there are no updates."""
        return []

    @staticmethod
    def _none(transfer_id: int) -> NoReturn:
        raise NotFound("unknown transfer id", got=str(transfer_id))
