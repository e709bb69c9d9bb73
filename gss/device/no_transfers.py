"""Transfers of a sensor that moves no content: every request is refused with one sentence."""

from __future__ import annotations

from typing import NoReturn

from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Ranges, TransferDone, TransferUpdate
from gss.device.session_transfer import HeldPart, Part
from gss.domain.errors import Conflict, NotFound


class NoTransfers:
    """See the module docstring."""

    def start_download(
        self,
        kind: str,
        slot: int,
        *,
        held: HeldPart | None = None,
        chunk_bytes: int | None = None,
        part: Part | None = None,
        paused: str = "",
    ) -> int:
        """Raise Conflict."""
        raise Conflict(f"This sensor cannot send content of the kind {kind}.")

    def start_upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        *,
        chunk_bytes: int | None = None,
        paused: str = "",
    ) -> int:
        """Raise Conflict."""
        raise Conflict(f"This sensor cannot take content of the kind {kind}.")

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """Raise NotFound, as all that follow."""
        self._none(transfer_id)

    def pause(self, transfer_id: int) -> None:
        """See ``partial``."""
        self._none(transfer_id)

    def resume(self, transfer_id: int) -> None:
        """See ``partial``."""
        self._none(transfer_id)

    def abort(self, transfer_id: int) -> None:
        """See ``partial``."""
        self._none(transfer_id)

    def forget(self, transfer_id: int) -> None:
        """Do nothing."""

    def update(self, transfer_id: int) -> TransferUpdate:
        """See ``partial``."""
        self._none(transfer_id)

    def news(self) -> list[TransferUpdate | TransferDone]:
        """Return nothing."""
        return []

    @staticmethod
    def _none(transfer_id: int) -> NoReturn:
        raise NotFound("unknown transfer id", got=str(transfer_id))
