"""The driver ``sagitta``: arcsec's Sagitta, from public sources (ut-issl/c2a-aobc and s2e-aobc, both MIT). Not tested
on a unit.

SLIP frames of address, type, number, content and XXH32 (seed 1425), little-endian. The dictionary code of a command is
``64 · type + number``, that of a parameter packet is 64 + its number, and that of a telemetry packet is its number.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import xxhash

from gss.device.driver import UnitSetup
from gss.device.exchange_session import Answer, ExchangeSession, SensorRequest
from gss.device.link_framing import DelimitedFramer
from gss.device.protocol.codec import LITTLE, Decoded, EncodedCommand, decode, encode_command
from gss.device.session_events import DirectionCounters, Stage
from gss.domain.errors import CorruptData
from gss.instruments.dictionary.definitions import Layout, Value
from gss.instruments.link_file import Poll

ADDRESS, SEED = 0x21, 1425
SET_PARAMETER, READ_PARAMETER, REQUEST_TELEMETRY, ACTION, ASYNCHRONOUS = 0, 1, 2, 3, 4
REPLY = 0x80
PARAMETER_CODES = 64
HEAD = struct.Struct("<BBB")
STAMP = struct.Struct("<BIQ")
"""Status, counter and Unix time in microseconds, which precede the content of telemetry."""
HASH_BYTES = 4
NOT_IMPLEMENTED = 1
POLLS = (Poll(command="REQUEST_SOLUTION", every_s=1.0), Poll(command="REQUEST_TEMPERATURE", every_s=1.0))

GREETING = "PING"
"""The sensor answers this command even in its bootloader, which does not send telemetry."""


def open_session(setup: UnitSetup) -> ExchangeSession:
    """Return the session of the driver ``sagitta``."""
    return ExchangeSession(setup, SagittaWire(setup), POLLS, greeting=GREETING)


def packet(kind: int, number: int, content: bytes) -> bytes:
    """Return a packet with its hash, before framing."""
    body = HEAD.pack(ADDRESS, kind, number) + content
    return body + xxhash.xxh32_intdigest(body, SEED).to_bytes(HASH_BYTES, "little")


def unpacked(data: bytes) -> tuple[int, int, bytes] | None:
    """Return the type, number and content of a packet; None if the packet is too short or its hash is wrong."""
    if len(data) < HEAD.size + HASH_BYTES:
        return None
    body, received_hash = data[:-HASH_BYTES], data[-HASH_BYTES:]
    if xxhash.xxh32_intdigest(body, SEED).to_bytes(HASH_BYTES, "little") != received_hash:
        return None
    return body[1], body[2], body[HEAD.size :]


class SagittaWire:
    """A :class:`gss.device.exchange_session.ExchangeWire`; see the module docstring."""

    def __init__(self, setup: UnitSetup) -> None:
        self._dictionary, self._framer = setup.dictionary, DelimitedFramer("slip")
        self._request: SensorRequest | None = None
        self.good = self.bad_hash = self.unknown = self.undecodable = 0

    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand:
        """Validate and encode a command. Raises BadInput, NotFound."""
        return encode_command(self._dictionary.command(name), arguments, LITTLE)

    def parts(self, request: SensorRequest) -> list[tuple[str, bytes]]:
        """Return the packet before framing as labelled groups."""
        code = request.order.command.code
        encoded = packet(code >> 6, code & 0x3F, request.order.payload)
        head = list(zip(("address", "type", "number"), (encoded[k : k + 1] for k in range(HEAD.size)), strict=True))
        return [*head, *request.order.groups, ("XXH32", encoded[-HASH_BYTES:])]

    def frame(self, request: SensorRequest) -> bytes:
        """Return the frame of a request."""
        return self._framer.encode(b"".join(data for _, data in self.parts(request)))

    def sent(self, request: SensorRequest) -> None:
        """Expect the response to this request."""
        self._request = request

    def restart(self) -> None:
        """Reset the decoder for a newly opened line."""
        self._framer.restart()
        self._request = None

    def feed(self, data: bytes) -> list[Answer]:
        """Return the answers in the frames that ``data`` completes."""
        answers = []
        for frame in self._framer.feed(data):
            message = unpacked(frame)
            if message is None:
                self.bad_hash += 1
                continue
            try:
                answers.append(self._read(*message))
            except CorruptData:
                continue
            self.good += 1
        return answers

    def _read(self, kind: int, number: int, content: bytes) -> Answer:
        """Return the answer in a packet. Counts and raises CorruptData if the packet is not valid or not expected."""
        expected_code = self._request.order.command.code if self._request is not None else -1
        is_reply = kind & ~REPLY == expected_code >> 6 and number == expected_code & 0x3F
        stage = Stage.COMPLETED if is_reply else None
        if kind == REPLY | READ_PARAMETER:
            return self._packet(PARAMETER_CODES + number, content, stage)
        if kind in (REPLY | REQUEST_TELEMETRY, REPLY | ASYNCHRONOUS):
            return self._stamped(number, content, stage)
        if kind in (REPLY | SET_PARAMETER, REPLY | ACTION) and is_reply and self._request is not None:
            return self._status(self._request, content)
        self.unknown += 1
        raise CorruptData("the response belongs to no request", got=f"type {kind:#04x}, number {number}")

    def _status(self, request: SensorRequest, content: bytes) -> Answer:
        if not content:
            self.undecodable += 1
            raise CorruptData("a response has no status")
        self._request = None
        if content[0]:
            return _rejected(content[0])
        return Answer(Stage.COMPLETED, values=self._decoded(request.order.command.returns, content[1:]).values)

    def _stamped(self, number: int, content: bytes, stage: Stage | None) -> Answer:
        if content and content[0] and stage is not None:
            self._request = None
            return _rejected(content[0])
        if len(content) < STAMP.size or content[0]:
            self.undecodable += 1
            raise CorruptData("telemetry lacks its time or reports an error")
        _, _, time_us = STAMP.unpack_from(content)
        return self._packet(number, content[STAMP.size :], stage, time_us / 1e6)

    def _packet(self, code: int, content: bytes, stage: Stage | None, time_s: float | None = None) -> Answer:
        row = self._dictionary.packet_of_code(code)
        if row is None:
            self.unknown += 1
            raise CorruptData("no such packet", got=str(code))
        decoded = self._decoded(row.fields, content)
        if stage is not None:
            self._request = None
        return Answer(stage, packet=row.name, content=decoded, time_s=time_s)

    def _decoded(self, layout: Layout, content: bytes) -> Decoded:
        try:
            return decode(layout, content, LITTLE)
        except CorruptData:
            self.undecodable += 1
            raise

    @property
    def received(self) -> DirectionCounters:
        """Counters of the received bytes and packets."""
        framer = self._framer
        return DirectionCounters(
            bytes=framer.bytes,
            good=self.good,
            bad_crc=self.bad_hash + framer.broken,
            too_long=framer.too_long,
            unframed=framer.unframed,
            unknown=self.unknown,
            undecodable=self.undecodable,
        )


def _rejected(status: int) -> Answer:
    reason = "not_implemented" if status == NOT_IMPLEMENTED else f"error_{status}"
    return Answer(Stage.REJECTED, reason=reason, detail=f"The sensor answered with status {status}.")
