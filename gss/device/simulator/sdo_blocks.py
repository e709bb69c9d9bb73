"""Server for SDO block uploads (CiA 301 §7.2.4.2.10), which the CANopen library of the simulated card does not support.
No I/O."""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable

from canopen.sdo.exceptions import SdoAbortedError

HEAD = struct.Struct("<BHB")
SEGMENT = 7
BAD_SIZE, BAD_NUMBER, NO_OBJECT, NO_DATA = 0x0504_0002, 0x0504_0003, 0x0602_0000, 0x0800_0024


class BlockServer:
    """Responds to the messages of an SDO client. ``read``: returns the content of an object by index and subindex; it
    raises SdoAbortedError, or KeyError for an unknown object."""

    def __init__(self, read: Callable[[int, int], bytes]) -> None:
        self._read = read
        self._object: tuple[int, int] | None = None
        self._data, self._at, self._size = b"", 0, 0

    @staticmethod
    def is_block_upload(message: bytes) -> bool:
        """True if a message is part of a block upload."""
        return len(message) == 8 and message[0] & 0xE0 == 0xA0

    def stop(self) -> None:
        """Discard the transfer, because the client has aborted it or started another one."""
        self._object = None

    def respond(self, message: bytes) -> list[bytes]:
        """Return the responses to a message."""
        step = message[0] & 0x03
        if step == 0:
            return self._begin(message)
        if self._object is None:
            return []
        if step == 3:
            return self._block()
        if step == 2:
            return self._acknowledged(message[1], message[2])
        self.stop()
        return []

    def _begin(self, message: bytes) -> list[bytes]:
        _, index, subindex = HEAD.unpack_from(message)
        self._object = index, subindex
        try:
            self._data = bytes(self._read(index, subindex))
        except SdoAbortedError as error:
            return [self._abort(error.code)]
        except KeyError:
            return [self._abort(NO_OBJECT)]
        if not self._data:
            return [self._abort(NO_DATA)]
        if not 1 <= message[4] <= 127:
            return [self._abort(BAD_SIZE)]
        self._at, self._size = 0, message[4]
        return [HEAD.pack(0xC6, index, subindex) + struct.pack("<I", len(self._data))]

    def _abort(self, code: int) -> bytes:
        index, subindex = self._object or (0, 0)
        self.stop()
        return HEAD.pack(0x80, index, subindex) + struct.pack("<I", code)

    def _block(self) -> list[bytes]:
        messages = []
        for number in range(1, self._size + 1):
            start = self._at + SEGMENT * (number - 1)
            last = start + SEGMENT >= len(self._data)
            messages.append(bytes([number | 0x80 * last]) + self._data[start : start + SEGMENT].ljust(SEGMENT, b"\0"))
            if last:
                break
        return messages

    def _acknowledged(self, number: int, size: int) -> list[bytes]:
        if number > self._size:
            return [self._abort(BAD_NUMBER)]
        if not 1 <= size <= 127:
            return [self._abort(BAD_SIZE)]
        self._at += SEGMENT * number
        self._size = size
        if self._at < len(self._data):
            return self._block()
        unused = -len(self._data) % SEGMENT
        crc = binascii.crc_hqx(self._data, 0)
        return [bytes([0xC1 | unused << 2]) + crc.to_bytes(2, "little") + bytes(5)]
