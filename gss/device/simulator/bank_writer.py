"""Uploads into catalogue banks: what may be written, what flash still holds of an earlier attempt, and the commit."""

from __future__ import annotations

from collections.abc import Mapping

from gss.catalogue_tools.onboard import FORMATS, decode, read_header
from gss.device.dictionary import Dictionary, Value
from gss.device.protocol.transfer import ChunkReceiver, chunk_count
from gss.device.simulator.firmware import Refusal
from gss.device.simulator.memory import BANKS, GOLDEN, BankRecord, Memory, SuspendedUpload
from gss.device.simulator.sessions import WINDOW_CHUNKS, Session
from gss.domain.errors import BadInput, CorruptData


def _short(value: Value) -> str:
    return value.hex()[:8] if isinstance(value, bytes) else str(value)


class BankWriter:
    """Writes the banks of one device. Refusal where something may not be; saving the record after ``open`` is the caller's."""

    def __init__(self, dictionary: Dictionary, memory: Memory, profile_name: str) -> None:
        self._dictionary, self._memory, self._profile_name = dictionary, memory, profile_name

    def check(self, v: Mapping[str, Value], target: int, size: int) -> None:
        """May this content go into this bank?"""
        if target >= len(BANKS):
            raise Refusal("not_found", f"banks are 0 – {len(BANKS) - 1}, got {target}")
        bank, record = BANKS[target], self._memory.record
        if bank == GOLDEN:
            raise Refusal("write_protected", "the golden bank cannot be written")
        if bank == record.active or (record.unconfirmed and bank == record.previous):
            raise Refusal("bank_active", f"bank {bank} is in use")
        if not 0 < size <= self._memory.bank_bytes:
            raise Refusal("too_large", f"a bank has {self._memory.bank_bytes} B, got {size}")
        own: dict[str, Value] = {
            "device_model": self._dictionary.device_model,
            "profile": self._profile_name,
            "dictionary_hash": self._dictionary.hash,
            "format_version": FORMATS["cubestar"],
        }
        for name, wanted in own.items():
            if v[name] != wanted:
                raise Refusal("incompatible", f"{name}: expected {_short(wanted)}, got {_short(v[name])}")

    def open(self, target: int, size: int, chunk_bytes: int, digest: bytes) -> tuple[ChunkReceiver, int, bool]:
        """Prepare a bank: the receiver with the chunks that are there already, the chunk size, and whether any attempt goes on.

        An attempt that was broken off keeps its chunk size; another content starts from an erased bank.
        """
        bank, record = BANKS[target], self._memory.record
        upload = record.uploads.get(bank)
        same = upload is not None and (upload.size, upload.sha256) == (size, digest.hex())
        complete = record.banks[bank].sha256 == digest.hex() and self._memory.intact(bank)
        if complete:
            held = range(chunk_count(size, chunk_bytes))
            receiver = ChunkReceiver(size, chunk_bytes, WINDOW_CHUNKS, held)
        elif same and upload is not None:
            chunk_bytes = upload.chunk_bytes
            numbers = [i for first, last in upload.held for i in range(first, last + 1)]
            receiver = ChunkReceiver(size, chunk_bytes, WINDOW_CHUNKS, numbers)
        else:
            self._memory.erase_bank(bank)
            receiver = ChunkReceiver(size, chunk_bytes, WINDOW_CHUNKS)
        if not complete:
            record.banks[bank] = BankRecord("loading", size=size)
            record.uploads[bank] = SuspendedUpload(size, chunk_bytes, digest.hex(), receiver.held.ranges()[0])
        return receiver, chunk_bytes, complete or same

    def program(self, session: Session, at: int, data: bytes) -> None:
        """Write a chunk; FlashError when the flash cannot."""
        self._memory.flash.program(self._memory.offset(session.bank) + at, data)

    def read(self, session: Session) -> bytes:
        """What flash holds."""
        return self._memory.flash.read(self._memory.offset(session.bank), session.size)

    def erase(self, session: Session) -> None:
        """Nothing of this attempt is worth keeping."""
        self._memory.erase_bank(session.bank)

    def keep_progress(self, session: Session) -> None:
        """Note which chunks flash holds, for an attempt after a reset."""
        upload = self._memory.record.uploads.get(session.bank)
        if session.receiver is not None and upload is not None:
            held = session.receiver.held.ranges()[0]
            kept = SuspendedUpload(session.size, session.chunk_bytes, session.sha256.hex(), held)
            self._memory.record.uploads[session.bank] = kept
            self._memory.save()

    def commit(self, session: Session, content: bytes) -> None:
        """The bank holds a catalogue from now on; Refusal when it is none, or another camera's."""
        try:
            header, catalogue = read_header(content), decode(content)
        except (CorruptData, BadInput) as error:
            raise Refusal("incompatible", str(error)) from error
        if header.profile_name != self._profile_name:
            text = f"catalogue is for {header.profile_name}, this is {self._profile_name}"
            raise Refusal("incompatible", text)
        self._memory.record.uploads.pop(session.bank, None)
        self._memory.record.banks[session.bank] = BankRecord(
            "committed",
            session.size,
            session.sha256.hex(),
            len(catalogue),
            len(catalogue.distances),
            header.epoch_jyear,
            FORMATS[header.format_name],
            header.profile_name,
        )
        self._memory.save()
