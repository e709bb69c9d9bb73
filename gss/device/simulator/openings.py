"""Opening of transfers on the device: checks, and chunks stored by earlier attempts."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping

from gss.device.protocol.chunk_size import regrid
from gss.device.protocol.transfer import ChunkReceiver, ChunkSender, chunk_count, request_patience_s
from gss.device.simulator.bank_writer import FLASH_KINDS, BankWriter
from gss.device.simulator.downloads import DownloadSource
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.images import SLOTS
from gss.device.simulator.memory import Memory
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.sessions import WINDOW_CHUNKS, Session
from gss.instruments.dictionary.definitions import Value

CHUNK_RANGE = (16, 1536)


class Openings:
    """Creates sessions. Raises Rejection if the transfer cannot be opened.

    ``parts``: unfinished images by kind and slot. ``reserved``: flash areas that a command uses. ``image_memory``: returns
    True if image memory has power.
    """

    def __init__(
        self,
        memory: Memory,
        tracker: StarTracker,
        writer: BankWriter,
        bytes_per_s: float,
        image_memory: Callable[[], bool],
    ) -> None:
        self._memory, self._tracker, self._writer = memory, tracker, writer
        self._downloads = DownloadSource(memory, tracker, writer)
        self._bytes_per_s = bytes_per_s
        self.parts: dict[tuple[str, int], Session] = {}
        self.reserved: set[str] = set()
        self._image_memory = image_memory

    def _new_id(self) -> int:
        record = self._memory.record
        session_id = record.next_session
        record.next_session = session_id % 0xFFFF + 1
        return session_id

    @staticmethod
    def _checked_chunk(values: Mapping[str, Value]) -> int:
        low, high = CHUNK_RANGE
        size = int(values["chunk_bytes"])
        if not low <= size <= high:
            raise Rejection("out_of_range", f"chunk size {low} – {high}, got {size}")
        return size

    def upload(self, request_id: int, request: Mapping[str, Value], now_s: float) -> Session:
        """Create the session for an OPEN_UPLOAD, with the chunks stored by an earlier attempt."""
        kind, target, size = str(request["kind"]), int(request["target"]), int(request["size_bytes"])
        chunk_bytes, digest = self._checked_chunk(request), bytes(request["sha256"])  # type: ignore[arg-type]  # bytes decode to bytes
        if kind in FLASH_KINDS:
            area = self._writer.check(request, target, size)
            if area in self.reserved:
                raise Rejection("busy", f"a command uses {area}")
            session = self._open_area(request_id, kind, target, area, size, chunk_bytes, digest, now_s)
            session.offered = self._writer.offered(request)
            return session
        if kind != "image" or target >= SLOTS:
            raise Rejection("not_found", f"there is no place to write: {kind} {target}")
        self._check_image_memory()
        expected = self._tracker.imager.upload_size
        if size != expected:
            raise Rejection("too_large" if size > expected else "bad_length", f"an image has {expected} B, got {size}")
        return self._open_image(request_id, target, size, chunk_bytes, digest, now_s)

    def _check_image_memory(self) -> None:
        if not self._image_memory():
            raise Rejection("powered_off", "sram has no power")

    def _open_area(
        self,
        request_id: int,
        kind: str,
        target: int,
        area: str,
        size: int,
        chunk_bytes: int,
        digest: bytes,
        now_s: float,
    ) -> Session:
        receiver, resumed = self._writer.open(area, size, chunk_bytes, digest)
        session = Session(
            self._new_id(), request_id, kind, target, size, chunk_bytes, digest, bytearray(), now_s, resumed, area=area
        )
        session.receiver = receiver
        self._memory.save()
        return session

    def _open_image(
        self, request_id: int, target: int, size: int, chunk_bytes: int, digest: bytes, now_s: float
    ) -> Session:
        part, stored_frame = self.parts.get(("image", target)), self._tracker.slots.get(target)
        data, stored, resumed, number = bytearray(size), [], False, 0
        if part is not None and part.sha256 == digest and part.size == size and part.receiver is not None:
            data, resumed = part.data, True
            stored = regrid(part.receiver.stored.ranges()[0], size, part.chunk_bytes, chunk_bytes)
        elif (
            stored_frame is not None
            and stored_frame.source == "uploaded"
            and hashlib.sha256(stored_frame.data).digest() == digest
        ):
            # The image is already committed, but the ground has not received COMMITTED.
            data, resumed, number = bytearray(stored_frame.data), True, stored_frame.number
            stored = list(range(chunk_count(size, chunk_bytes)))
        session = Session(self._new_id(), request_id, "image", target, size, chunk_bytes, digest, data, now_s, resumed)
        session.receiver = ChunkReceiver(size, chunk_bytes, WINDOW_CHUNKS, stored)
        session.frame_number = number
        session.committed = number > 0
        if not number:
            self.parts["image", target] = session
        return session

    def download(self, request_id: int, request: Mapping[str, Value], now_s: float) -> Session:
        """Create the session for an OPEN_DOWNLOAD."""
        kind, target, chunk_bytes = str(request["kind"]), int(request["target"]), self._checked_chunk(request)
        data, number = self._downloads.content(request)
        digest = hashlib.sha256(data).digest()
        session = Session(
            self._new_id(),
            request_id,
            kind,
            target,
            len(data),
            chunk_bytes,
            digest,
            bytearray(data),
            now_s,
            request["held_sha256"] == digest,
            number,
        )
        patience_s = request_patience_s(WINDOW_CHUNKS, chunk_bytes, self._bytes_per_s)
        # The ground may have stored chunks; its STATUS pages report them before the first chunk is sent.
        session.sender = ChunkSender(chunk_count(len(data), chunk_bytes), WINDOW_CHUNKS, patience_s, resumed=True)
        return session
