"""Image downloads from a CANopen sensor. Each download reads one object, with the SDO client that commands also use. No
I/O.

The SDO server of the sensor cannot continue an interrupted transfer, so a resumed download starts from the
beginning. During a download, commands and repeated requests wait. The object with the image number is read before
and after the image, to detect an image that the sensor replaced during the download. A download does not start
while the sensor takes images faster than they can be read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

from gss.device.protocol.transfer import Compatibility
from gss.device.sdo_client import CANCELLED, NO_DATA, TIMED_OUT, SdoClient, SdoResult
from gss.device.session_events import Direction, Ranges, TransferDone, TransferState, TransferUpdate
from gss.device.session_transfer import ENDED, HeldPart, Part
from gss.domain.errors import Conflict, NotFound

Object = tuple[int, int]
SILENT_S = 0.5
TRIES = 3
"""Maximum number of attempts for an image. A further attempt follows if the image arrives damaged, if the sensor replaces
it, or if the download stops at the same position as before."""
SILENT_AGAIN_S = 4.0
REPORT_EVERY_S = 0.5
NO_IMAGE = "the sensor has no image: take an image first"
REPLACED = "the sensor took another image during the download"
AGAIN, STOP_CAPTURE = "; the download starts again", "; stop the capture, then download"


@dataclass
class _Download:
    """One download. ``received``, ``furthest``: bytes that the current attempt and the best attempt received;
    ``number``: number of the image, 0 while unknown; ``image``: received image whose number is being verified;
    ``data``: verified image. ``waits_for_device``: True if the download is paused only until the sensor has answered."""

    id: int
    kind: str
    slot: int
    state: TransferState = TransferState.QUEUED
    reason: str = ""
    tries: int = 0
    data: bytes = b""
    received: int = 0
    furthest: int = 0
    number: int = 0
    image: bytes = b""
    size: int = 0
    resent: int = 0
    since_s: float = 0.0
    due_s: float = 0.0
    rate_bytes_s: float = 0.0
    waits_for_device: bool = False
    changed: bool = True

    @property
    def can_begin(self) -> bool:
        """True if the download waits for the line."""
        return self.state in (TransferState.QUEUED, TransferState.LINK_LOST) or self.waits_for_device

    def to(self, state: TransferState, reason: str = "") -> None:
        """Change the state; the next update reports it."""
        self.state, self.reason, self.changed = state, reason, True

    def update(self) -> TransferUpdate:
        """Return the state as an event. Chunks are reported as stored only at the end, because a partial download
        cannot be resumed."""
        done = self.state is TransferState.VERIFIED
        left_s = (self.size - self.received) / self.rate_bytes_s if self.rate_bytes_s and self.size else None
        return TransferUpdate(
            transfer_id=self.id,
            direction=Direction.DOWN,
            kind=self.kind,
            target=self.slot,
            state=self.state,
            reason=self.reason,
            size=self.size,
            chunk_size=max(1, self.size),
            chunks=1 if self.size else 0,
            stored=((0, 0),) if done else (),
            stored_bytes=self.received,
            in_flight=0,
            resent=self.resent,
            rate_bytes_s=self.rate_bytes_s,
            line_share=None,
            left_s=left_s,
            sha256=hashlib.sha256(self.data).hexdigest() if done else "",
            frame_number=self.number,
            resumed=False,
        )


class SdoDownloads:
    """Implements :class:`gss.device.no_transfers.ExchangeTransfers`. ``objects``: object by kind of content;
    ``numbering``: object with the number of the latest image. ``send``: converts a message for the server to bytes for
    the line. ``wait_reason``: called with the time; returns why no download can start now, "" if one can."""

    def __init__(
        self,
        client: SdoClient,
        objects: dict[str, Object],
        numbering: Object,
        send: Callable[[bytes], bytes],
        wait_reason: Callable[[float], str],
    ) -> None:
        self._client, self._objects, self._numbering, self._send = client, objects, numbering, send
        self._wait_reason = wait_reason
        self._downloads: dict[int, _Download] = {}
        self._next_id = 1
        self._active: _Download | None = None
        self._out = b""
        self._done: list[TransferDone] = []
        self._moved: tuple[int, float] = (-1, 0.0)
        self._report_s = 0.0

    # --- requests -----------------------------------------------------------------------------------------------

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
        """Queue a download. ``paused``: reason to wait until the sensor has answered. Raises Conflict for a kind of
        content that the sensor cannot send, or for a part of an image."""
        if kind not in self._objects or (part is not None and part != Part()):
            raise Conflict(f"This sensor cannot send content of type {kind}.")
        download = _Download(self._next_id, kind, slot)
        if paused:
            download.waits_for_device = True
            download.to(TransferState.PAUSED, paused)
        self._downloads[download.id] = download
        self._next_id += 1
        return download.id

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
        """Raise Conflict: uploads are not supported."""
        raise Conflict(f"This sensor cannot receive content of type {kind}.")

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """Return the content and its chunk range; both are empty until the download is complete."""
        download = self._one(transfer_id)
        return download.data, ((0, 0),) if download.data else ()

    def pause(self, transfer_id: int) -> None:
        """Pause a download. Raises Conflict if it has ended."""
        self._stop(transfer_id, TransferState.PAUSED)

    def resume(self, transfer_id: int) -> None:
        """Queue a download again. Raises Conflict if it has succeeded."""
        download = self._one(transfer_id)
        if download.state is TransferState.VERIFIED:
            self._raise_ended(download)
        if download is not self._active:
            download.tries = download.furthest = 0
            download.waits_for_device = False
            download.to(TransferState.QUEUED)

    def abort(self, transfer_id: int) -> None:
        """Abort a download. Raises Conflict if it has ended."""
        self._stop(transfer_id, TransferState.ABORTED)

    def _stop(self, transfer_id: int, state: TransferState) -> None:
        download = self._one(transfer_id)
        if download.state in ENDED:
            self._raise_ended(download)
        if download is self._active:
            self._active = None
            if self._client.busy:
                self._out += self._send(self._client.give_up(CANCELLED))
        download.waits_for_device = False
        download.to(state)

    @staticmethod
    def _raise_ended(download: _Download) -> NoReturn:
        raise Conflict("the transfer has ended", got=download.state.value)

    def forget(self, transfer_id: int) -> None:
        """Discard a download that has ended."""
        if transfer_id in self._downloads and self._downloads[transfer_id].state in ENDED:
            del self._downloads[transfer_id]

    def update(self, transfer_id: int) -> TransferUpdate:
        """Return the state of a download. Raises NotFound."""
        return self._one(transfer_id).update()

    def _one(self, transfer_id: int) -> _Download:
        if transfer_id not in self._downloads:
            raise NotFound("unknown transfer id", got=str(transfer_id))
        return self._downloads[transfer_id]

    # --- line ---------------------------------------------------------------------------------------------------

    @property
    def holds_channel(self) -> bool:
        """True while a download uses the client."""
        return self._active is not None

    def lose(self) -> None:
        """Handle the loss of the line: the current download starts again when the sensor answers."""
        for download in self._downloads.values():
            if download is self._active:
                download.to(TransferState.LINK_LOST, "the line was lost; the download starts again")
        self._active, self._out = None, b""

    def begin(self, now_s: float) -> bytes:
        """Start the next waiting download. Returns its first message, b"" if none can start. Called only while the
        client is free and after the sensor has answered."""
        download = next((d for d in self._downloads.values() if d.can_begin and now_s >= d.due_s), None)
        if download is None:
            return b""
        reason = self._wait_reason(now_s)
        if reason:
            if download.reason != reason:
                download.to(TransferState.QUEUED, reason)
            return b""
        self._active, self._moved, download.since_s = download, (-1, now_s), now_s
        download.tries += 1
        download.waits_for_device = False
        download.received = download.size = download.number = 0
        download.image = b""
        download.to(TransferState.TRANSFERRING, download.reason if download.tries > 1 else "")
        return self._read_number()

    def _read_number(self) -> bytes:
        return self._send(self._client.start_read(*self._numbering))

    def poll(self, now_s: float) -> bytes:
        """Return the messages that continue the current download."""
        out, self._out, download = self._out, b"", self._active
        if download is None:
            return out
        if self._client.result is not None:
            return out + self._continue(download, self._client.result, now_s)
        received = len(self._client.received)
        if received != self._moved[0]:
            self._moved = received, now_s
        elif now_s - self._moved[1] >= SILENT_S:
            self._moved = received, now_s
            out += self._send(self._client.nudge())
        if download.number and not download.image:
            download.received, download.size = received, self._client.size
        download.resent = self._client.repeated
        download.rate_bytes_s = received / (now_s - download.since_s) if now_s > download.since_s else 0.0
        if now_s >= self._report_s:
            self._report_s, download.changed = now_s + REPORT_EVERY_S, True
        return out

    def _continue(self, download: _Download, result: SdoResult, now_s: float) -> bytes:
        """Begin the step that follows the completed step. The steps are: read the number, read the image, read the
        number again."""
        is_number = (result.index, result.subindex) == self._numbering
        if result.abort or not result.data or (is_number and download.image):
            self._finish(download, result, now_s)
            return b""
        self._client.result, self._moved = None, (-1, now_s)
        if not is_number:
            download.image, download.received = result.data, len(result.data)
            return self._read_number()
        download.number = int.from_bytes(result.data, "little")
        if not download.number:
            self._active = None
            download.to(TransferState.FAILED, NO_IMAGE)
            return b""
        return self._send(self._client.start_read(*self._objects[download.kind], block=True))

    def _finish(self, download: _Download, result: SdoResult, now_s: float) -> None:
        self._active, self._client.result = None, None
        if result.abort == TIMED_OUT and not result.by_server:
            self._stalled(download, now_s)
        elif result.abort and not result.by_server and download.tries < TRIES:
            download.to(TransferState.QUEUED, f"interrupted, starts again: {result.text}")
        elif result.abort == NO_DATA or not (result.abort or result.data):
            download.to(TransferState.FAILED, NO_IMAGE)
        elif result.abort:
            download.to(TransferState.FAILED, result.text)
        elif int.from_bytes(result.data, "little") != download.number:
            again = download.tries < TRIES
            download.to(
                TransferState.QUEUED if again else TransferState.FAILED, REPLACED + (AGAIN if again else STOP_CAPTURE)
            )
        else:
            download.data, download.received, download.size = download.image, len(download.image), len(download.image)
            download.image = b""
            download.to(TransferState.VERIFIED)
            sha256 = hashlib.sha256(download.data).hexdigest()
            self._done.append(
                TransferDone(
                    download.id, Direction.DOWN, download.kind, download.slot, download.number, download.data, sha256
                )
            )

    @staticmethod
    def _stalled(download: _Download, now_s: float) -> None:
        """Wait for a silent sensor. If all attempts stopped at the same position, fail, because a further attempt would
        stop there too."""
        if download.received == 0 or download.received > download.furthest:
            download.tries = 1 if download.received else 0
        download.furthest, download.due_s = max(download.furthest, download.received), now_s + SILENT_AGAIN_S
        if download.tries >= TRIES:
            download.to(
                TransferState.FAILED, f"the download stopped {TRIES} times after at most {download.furthest} bytes"
            )
        else:
            download.to(TransferState.LINK_LOST, "the sensor is silent; the download starts again when it answers")

    def news(self) -> list[TransferUpdate | TransferDone]:
        """Return updates since the last call."""
        events: list[TransferUpdate | TransferDone] = []
        for download in self._downloads.values():
            if download.changed:
                events.append(download.update())
                download.changed = False
        done, self._done = self._done, []
        return [*events, *done]
