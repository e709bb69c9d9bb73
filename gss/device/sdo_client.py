"""Client of CANopen's service data objects (CiA 301 §7.2.4): reads and writes one object at a time. No I/O.

A read can request a block transfer. If the server does not support block transfers, the client accepts a segmented
answer. The owner sends the messages that ``start_read``, ``start_write``, ``feed`` and ``nudge`` return, and reads
``result`` when it is set.
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from enum import Enum, auto

from canopen.sdo.exceptions import SdoAbortedError

HEAD = struct.Struct("<BHB4s")
ABORT = struct.Struct("<BHBI")
NUMBER = struct.Struct("<I")
SEGMENT = 7
BLOCK_SEGMENTS = 127
MAX_BYTES = 1 << 24
NUDGES = 4
"""Number of requests to continue a silent block transfer before the client aborts it."""
TIMED_OUT, INVALID_COMMAND, WRONG_CRC, OUT_OF_MEMORY = 0x0504_0000, 0x0504_0001, 0x0504_0004, 0x0504_0005
TOGGLE_ERROR, NO_DATA, CANCELLED = 0x0503_0000, 0x0800_0024, 0x0800_0020


@dataclass(frozen=True)
class SdoResult:
    """Outcome of a transfer. ``abort``: abort code of CiA 301, 0 on success. ``by_server``: False if the client aborted
    the transfer."""

    index: int
    subindex: int
    data: bytes = b""
    abort: int = 0
    by_server: bool = True

    @property
    def text(self) -> str:
        """Abort code as text."""
        meaning = SdoAbortedError.CODES.get(self.abort, "Unknown abort code")
        return f"{meaning} (0x{self.abort:08X})"


class _TransferStep(Enum):
    IDLE = auto()
    READING = auto()
    SEGMENTS = auto()
    BLOCK_OFFERED = auto()
    BLOCK = auto()
    BLOCK_END = auto()
    WRITING = auto()
    WRITING_SEGMENTS = auto()


class SdoClient:
    """Client for one transfer at a time; see the module docstring. ``received``: data of the current transfer;
    ``size``: size stated by the server, 0 if not stated; ``number``: number of transfers begun."""

    def __init__(self) -> None:
        self.result: SdoResult | None = None
        self.received = bytearray()
        self.size = self.repeated = self.number = 0
        self._step, self._index, self._subindex = _TransferStep.IDLE, 0, 0
        self._toggle, self._sequence, self._nudges, self._ended = 0, 0, 0, False
        self._to_write, self._has_crc = b"", True

    @property
    def busy(self) -> bool:
        """True while a transfer is in progress."""
        return self._step is not _TransferStep.IDLE

    def restart(self) -> None:
        """Discard the transfer after the line was opened again."""
        self._step, self.result = _TransferStep.IDLE, None

    def start_read(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Begin to read an object. Returns the message to send."""
        self._begin(_TransferStep.BLOCK_OFFERED if block else _TransferStep.READING, index, subindex)
        if block:
            return HEAD.pack(0xA4, index, subindex, bytes([BLOCK_SEGMENTS, 0, 0, 0]))
        return HEAD.pack(0x40, index, subindex, bytes(4))

    def start_write(self, index: int, subindex: int, data: bytes) -> bytes:
        """Begin to write an object. Returns the message to send."""
        self._begin(_TransferStep.WRITING, index, subindex)
        if 0 < len(data) <= 4:
            self._to_write = b""
            return HEAD.pack(0x23 | (4 - len(data)) << 2, index, subindex, data)
        self._to_write = data
        return HEAD.pack(0x21, index, subindex, NUMBER.pack(len(data)))

    def _begin(self, step: _TransferStep, index: int, subindex: int) -> None:
        self._step, self._index, self._subindex, self.result = step, index, subindex, None
        self.received, self.size, self.repeated = bytearray(), 0, 0
        self.number += 1
        self._toggle, self._sequence, self._nudges, self._ended = 0, 0, 0, False

    def give_up(self, code: int = TIMED_OUT) -> bytes:
        """Abort the transfer. Returns the message to send."""
        self._finish(SdoResult(self._index, self._subindex, abort=code, by_server=False))
        return ABORT.pack(0x80, self._index, self._subindex, code)

    def nudge(self) -> bytes:
        """Continue a block transfer after a silence; abort any other transfer. Returns the message to send."""
        if self._step is _TransferStep.BLOCK and self._nudges < NUDGES:
            self._nudges += 1
            return self._acknowledged()
        return self.give_up()

    def feed(self, message: bytes) -> bytes:
        """Process a message of the server. Returns the message to send, b"" if none. Unexpected messages are
        ignored."""
        if len(message) != 8 or not self.busy:
            return b""
        if message[0] == 0x80 and self._step is not _TransferStep.BLOCK:
            return self._aborted(message)
        if self._step is _TransferStep.BLOCK:
            return self._block_segment(message)
        handlers = {
            _TransferStep.READING: self._read_begun,
            _TransferStep.SEGMENTS: self._segment,
            _TransferStep.BLOCK_OFFERED: self._block_offered,
            _TransferStep.BLOCK_END: self._block_ended,
            _TransferStep.WRITING: self._write_begun,
            _TransferStep.WRITING_SEGMENTS: self._segment_written,
        }
        return handlers[self._step](message)

    def _aborted(self, message: bytes) -> bytes:
        _, index, subindex, code = ABORT.unpack(message)
        if (index, subindex) in ((self._index, self._subindex), (0, 0)):
            self._finish(SdoResult(self._index, self._subindex, abort=code))
        return b""

    def _finish(self, result: SdoResult) -> None:
        self._step, self.result = _TransferStep.IDLE, result

    def _done(self) -> None:
        self._finish(SdoResult(self._index, self._subindex, bytes(self.received)))

    def _names_current_object(self, message: bytes) -> bool:
        """True if a message names the object of the transfer."""
        _, index, subindex, _ = HEAD.unpack(message)
        return (index, subindex) == (self._index, self._subindex)

    # --- reading ------------------------------------------------------------------------------------------------

    def _read_begun(self, message: bytes) -> bytes:
        command, _, _, data = HEAD.unpack(message)
        if command & 0xE0 != 0x40 or not self._names_current_object(message):
            return b""
        if command & 0x02:
            self.received += data[: 4 - (command >> 2 & 3) if command & 0x01 else 4]
            self._done()
            return b""
        if not self._store_size(command & 0x01, data):
            return self.give_up(OUT_OF_MEMORY)
        self._step = _TransferStep.SEGMENTS
        return self._next_segment()

    def _store_size(self, stated: int, data: bytes) -> bool:
        """Store the size that the server states. Returns False if it is too large."""
        self.size = NUMBER.unpack(data)[0] if stated else 0
        return self.size <= MAX_BYTES

    def _next_segment(self) -> bytes:
        return bytes([0x60 | self._toggle]) + bytes(7)

    def _segment(self, message: bytes) -> bytes:
        command = message[0]
        if command & 0xE0:
            return b""
        if command & 0x10 != self._toggle:
            self.repeated += 1
            return b""  # the segment was repeated on the bus
        self.received += message[1 : 8 - (command >> 1 & 7)]
        if len(self.received) > MAX_BYTES:
            return self.give_up(OUT_OF_MEMORY)
        self._toggle ^= 0x10
        if not command & 0x01:
            return self._next_segment()
        if self.size and self.size != len(self.received):
            return self.give_up(INVALID_COMMAND)
        self._done()
        return b""

    # --- reading in blocks --------------------------------------------------------------------------------------

    def _block_offered(self, message: bytes) -> bytes:
        command, _, _, data = HEAD.unpack(message)
        if command & 0xE1 == 0xC0 and self._names_current_object(message):
            if not self._store_size(command & 0x02, data):
                return self.give_up(OUT_OF_MEMORY)
            self._step, self._has_crc = _TransferStep.BLOCK, bool(command & 0x04)
            return bytes([0xA3]) + bytes(7)
        return self._read_begun(message)

    def _block_segment(self, message: bytes) -> bytes:
        number, last = message[0] & 0x7F, bool(message[0] & 0x80)
        if number == 0:
            return self._aborted(message) if last else b""
        if number == self._sequence + 1 and not self._ended:
            self._sequence, self._ended, self._nudges = number, last, 0
            self.received += message[1:]
            if len(self.received) > MAX_BYTES + SEGMENT:
                return self.give_up(OUT_OF_MEMORY)
        else:
            self.repeated += 1
        return self._acknowledged() if last or number == BLOCK_SEGMENTS else b""

    def _acknowledged(self) -> bytes:
        """Return the message that acknowledges the segments received in order. The server repeats all later segments in
        the next block."""
        answer = bytes([0xA2, self._sequence, BLOCK_SEGMENTS]) + bytes(5)
        if self._ended:
            self._step = _TransferStep.BLOCK_END
        self._sequence = 0
        return answer

    def _block_ended(self, message: bytes) -> bytes:
        if message[0] & 0xE3 != 0xC1:
            return b""
        unused = message[0] >> 2 & 7
        if unused:
            del self.received[-unused:]
        if self.size and self.size != len(self.received):
            return self.give_up(INVALID_COMMAND)
        if self._has_crc and binascii.crc_hqx(self.received, 0) != int.from_bytes(message[1:3], "little"):
            return self.give_up(WRONG_CRC)
        self._done()
        return bytes([0xA1]) + bytes(7)

    # --- writing ------------------------------------------------------------------------------------------------

    def _write_begun(self, message: bytes) -> bytes:
        if message[0] & 0xE0 != 0x60 or not self._names_current_object(message):
            return b""
        if not self._to_write:
            self._done()
            return b""
        self._step = _TransferStep.WRITING_SEGMENTS
        return self._written_segment()

    def _written_segment(self) -> bytes:
        data, remaining = self._to_write[:SEGMENT], self._to_write[SEGMENT:]
        command = self._toggle | (SEGMENT - len(data)) << 1 | (not remaining)
        return bytes([command]) + data.ljust(SEGMENT, b"\0")

    def _segment_written(self, message: bytes) -> bytes:
        if message[0] & 0xEF != 0x20 or message[0] & 0x10 != self._toggle:
            return b""
        self._to_write = self._to_write[SEGMENT:]
        self._toggle ^= 0x10
        if self._to_write:
            return self._written_segment()
        self._done()
        return b""
