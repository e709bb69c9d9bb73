"""The driver ``oresat``: OreSat's star tracker on CANopen, from public sources (oresat-configs,
oresat-star-tracker-software). Not tested on a unit.

Frames are records of :mod:`gss.device.can_frames`. Each command reads or writes one object
(:mod:`gss.device.oresat_objects`). The sensor sends attitudes unsolicited, as process data objects. Frames of other
nodes are ignored.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

from gss.device.can_frames import CanFrame, CanReader
from gss.device.driver import UnitSetup
from gss.device.exchange_session import Answer, ExchangeSession, SensorRequest
from gss.device.oresat_objects import (
    EMERGENCY,
    HEARTBEAT,
    HEARTBEATS,
    LAST_CAPTURE,
    NODE,
    OBJECTS,
    PDO,
    PREVIEW,
    SDO_ANSWER,
    SDO_REQUEST,
    STATUS,
    object_of,
)
from gss.device.oresat_state import SensorClock, SensorImages, SolveParts
from gss.device.protocol.codec import LITTLE, Decoded, EncodedCommand, decode, encode_command
from gss.device.sdo_client import SdoClient, SdoResult
from gss.device.sdo_downloads import SdoDownloads
from gss.device.session_events import DirectionCounters, SessionEvent, Stage
from gss.domain.errors import BadInput, CorruptData, NotFound
from gss.instruments.dictionary.definitions import Dictionary, Value
from gss.instruments.link_file import Poll

GREETING = "READ_TIME"
POLLS = (
    Poll(command="READ_TIME", every_s=1.0),
    Poll(command="READ_STATUS", every_s=1.0),
    Poll(command="READ_LAST_CAPTURE", every_s=2.0),
)
HOUSEKEEPING = "housekeeping"
CAPTURE = "capture"
PACKETS = {"READ_TIME": "clock", "READ_STATUS": HOUSEKEEPING, "READ_LAST_CAPTURE": CAPTURE}
"""Telemetry packet that a command returns, by command. Other read commands return their object as return values."""
CARD, UPDATER, ATTITUDE, DEGREES = "card", "updater", "attitude", "attitude_degrees"
DEGREES_BYTES = 7
"""Size of the third process data object in the older dictionary."""
MAX_ERROR = 1e-3
"""Largest accepted deviation of a quaternion's length from 1."""
SILENT_S = 5.0
EMERGENCY_LAYOUT = struct.Struct("<HB5s")
STARTED, FAULT, FAULT_OVER, OTHER_NODES = "CARD_STARTED", "EMERGENCY", "EMERGENCY_OVER", "OTHER_NODES_ONLY"
FIELDS = {
    "clock": {"seconds", "microseconds"},
    HOUSEKEEPING: {"status"},
    CAPTURE: {"last_capture_s"},
    ATTITUDE: {"known", "quaternion_real", "quaternion_i", "quaternion_j", "quaternion_k"},
}
"""Fields that the driver uses, by packet."""
NOT_READ_BACK = "The sensor accepted the status, but reading it back failed"
IGNORED = "The sensor ignores a status that cannot follow the current one, and returns to standby after a capture."


def open_session(setup: UnitSetup) -> OresatSession:
    """Return the session of the driver ``oresat``. Raises BadInput if the dictionary does not fit this sensor."""
    _check(setup.dictionary)
    return OresatSession(setup)


def _check(dictionary: Dictionary) -> None:
    """Raise BadInput if the dictionary lacks a name that the driver uses, before any frame is received."""
    packets = {*PACKETS.values(), CARD, UPDATER, ATTITUDE, DEGREES}
    missing: list[str] = []
    for kind, names, get in (
        ("packet", packets, dictionary.packet),
        ("event", (STARTED, FAULT, FAULT_OVER, OTHER_NODES), dictionary.event_named),
        ("command", [poll.command for poll in POLLS], dictionary.command),
    ):
        for name in sorted(names):
            try:
                get(name)
            except NotFound:
                missing.append(f"{kind} {name}")
    if not missing:
        missing = [
            f"field {packet}.{name}"
            for packet, names in FIELDS.items()
            for name in sorted(names - {f.name for f in dictionary.packet(packet).fields})
        ]
    if not missing:
        commands = [command.name for command in dictionary.commands]
        missing = [f"object of the command {c}" for c in commands if c.split("_", 1)[-1] not in OBJECTS]
    if missing:
        raise BadInput(
            "the dictionary does not fit the driver oresat",
            got="without " + ", ".join(missing),
            hint="use the dictionary of the package oresat, or another driver",
        )


class OresatSession(ExchangeSession):
    """Exchange session that passes the time to its wire, because frames of the sensor have no time stamp."""

    def __init__(self, setup: UnitSetup) -> None:
        self._clock = SensorClock()
        client, images = SdoClient(), SensorImages()
        wire = OresatWire(setup, client, self._clock, images)
        downloads = SdoDownloads(client, {"frame": PREVIEW}, LAST_CAPTURE, message, images.wait_reason)
        super().__init__(setup, wire, POLLS, greeting=GREETING, transfers=downloads)

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        """Process received bytes and return the resulting events. Invalid bytes raise no exception."""
        self._clock.now_s = now_s
        return super().feed(data, now_s)


class OresatWire:
    """A :class:`gss.device.exchange_session.ExchangeWire`; see the module docstring."""

    def __init__(self, setup: UnitSetup, client: SdoClient, clock: SensorClock, images: SensorImages) -> None:
        self._dictionary, self._client, self._clock, self._images = setup.dictionary, client, clock, images
        self._reader, self._solve = CanReader(), SolveParts()
        self._request: SensorRequest | None = None
        self._transfer = 0
        self._written: bytes | None = None
        self._others: set[int] = set()
        self._others_since_s: float | None = None
        self._received_any = False
        self.good = self.undecodable = self.unknown = 0

    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand:
        """Validate and encode a command. Raises BadInput, NotFound."""
        return encode_command(self._dictionary.command(name), arguments, LITTLE)

    def parts(self, request: SensorRequest) -> list[tuple[str, bytes]]:
        """Return the first message of a request as labelled groups."""
        first_message = self._first(SdoClient(), request)
        labels = (("command", 1), ("index", 2), ("subindex", 1), ("data", 4))
        groups, at = [], 0
        for label, size in labels:
            groups.append((label, first_message[at : at + size]))
            at += size
        return groups

    @staticmethod
    def _first(client: SdoClient, request: SensorRequest) -> bytes:
        (index, subindex), writes = object_of(request.order.command.name)
        if writes:
            return client.start_write(index, subindex, request.order.payload)
        return client.start_read(index, subindex)

    def frame(self, request: SensorRequest) -> bytes:
        """Begin the transfer of a request and return its first frame."""
        return message(self._first(self._client, request))

    def sent(self, request: SensorRequest) -> None:
        """Expect the answer to this request."""
        self._request, self._written, self._transfer = request, None, self._client.number

    def restart(self) -> None:
        """Reset the decoder for a newly opened line."""
        self._reader.restart()
        self._client.restart()
        self._request, self._solve, self._clock.ahead_s, self._images.status = None, SolveParts(), None, ""
        self._others, self._others_since_s, self._received_any = set(), None, False

    def feed(self, data: bytes) -> list[Answer]:
        """Return the answers in the frames that ``data`` completes."""
        answers = []
        for frame in self._reader.feed(data):
            if frame.extended or frame.remote:
                continue
            try:
                answer = self._read(frame)
            except CorruptData:
                self.undecodable += 1
                continue
            if answer is not None:
                answers.append(answer)
        return answers

    def _read(self, frame: CanFrame) -> Answer | None:
        """Return the answer in a frame; None if the frame is not for the ground. Raises CorruptData."""
        if frame.id == SDO_ANSWER:
            self._received_any = True
            return self._answered(frame.data)
        if frame.id == HEARTBEAT:
            self._received_any = True
            self.good += 1
            return Answer(event=STARTED, detail="The card started.") if frame.data == b"\0" else Answer()
        if frame.id in PDO:
            self._received_any = True
            return self._process_data(PDO[frame.id], frame.data)
        if frame.id == EMERGENCY:
            return self._emergency(frame.data)
        return self._other(frame) if frame.id in HEARTBEATS and not self._received_any else None

    def _other(self, frame: CanFrame) -> Answer | None:
        """Report once that only other nodes send. The node number can be wrong, or the sensor has no power."""
        self._others.add(frame.id & 0x7F)
        if self._others_since_s is None:
            self._others_since_s = self._clock.now_s
        if not self._clock.now_s - self._others_since_s >= SILENT_S:
            return None
        self._others_since_s = math.inf
        nodes = ", ".join(f"0x{node:02X}" for node in sorted(self._others))
        detail = (
            f"Only other nodes send on the bus ({nodes}). Check power and node number of the sensor (0x{NODE:02X})."
        )
        return Answer(event=OTHER_NODES, detail=detail, of_unit=False)

    def _emergency(self, data: bytes) -> Answer:
        if len(data) != EMERGENCY_LAYOUT.size:
            raise CorruptData("an emergency message has the wrong size")
        self.good += 1
        code, register, details = EMERGENCY_LAYOUT.unpack(data)
        if not code:
            return Answer(event=FAULT_OVER, detail="The fault is over.", time_s=self._clock.time_s())
        detail = f"Fault 0x{code:04X}, error register 0x{register:02X}, {details.hex()}."
        return Answer(event=FAULT, detail=detail, time_s=self._clock.time_s())

    # --- service data -------------------------------------------------------------------------------------------

    def _answered(self, data: bytes) -> Answer | None:
        if len(data) != 8:
            raise CorruptData("a service data object has the wrong size")
        if not self._client.busy:
            self.unknown += 1
            return None
        self.good += 1
        reply = self._client.feed(data)
        out = message(reply) if reply else b""
        result, request = self._client.result, self._request
        if result is None or request is None or self._transfer != self._client.number:
            return Answer(reply=out)
        self._client.result = None
        return self._result(request, result, out)

    def _result(self, request: SensorRequest, result: SdoResult, out: bytes) -> Answer:
        command = request.order.command
        if result.abort and self._written is not None:
            self._request = None
            return Answer(Stage.FAILED, reason="not_read_back", detail=f"{NOT_READ_BACK}: {result.text}.", reply=out)
        if result.abort:
            self._request = None
            return Answer(Stage.REJECTED, reason=f"abort_{result.abort:08x}", detail=f"{result.text}.", reply=out)
        (index, subindex), writes = object_of(command.name)
        if writes and (index, subindex) == STATUS and self._written is None:
            self._written, check = request.order.payload, message(self._client.start_read(index, subindex))
            self._transfer = self._client.number
            return Answer(reply=out + check)
        self._request = None
        if self._written is not None:
            return self._verified(request, self._written, result.data)
        if writes:
            return Answer(Stage.COMPLETED, reply=out)
        if command.name in PACKETS:
            return self._packet(PACKETS[command.name], result.data, Stage.COMPLETED, out)
        return Answer(Stage.COMPLETED, values=decode(command.returns, result.data, LITTLE).values, reply=out)

    def _verified(self, request: SensorRequest, written: bytes, read: bytes) -> Answer:
        values = decode(request.order.command.returns, read, LITTLE).values
        if read != written:
            status = str(next(iter(values.values()), ""))
            return Answer(Stage.REJECTED, reason="ignored", detail=f"The sensor reports {status}. {IGNORED}")
        return Answer(Stage.COMPLETED, values=values)

    # --- process data -------------------------------------------------------------------------------------------

    def _process_data(self, number: int, data: bytes) -> Answer:
        if number in (1, 2):
            return self._packet(CARD if number == 1 else UPDATER, data, None)
        self._solve.add(number, data)
        older = len(self._solve.parts.get(3, b"")) == DEGREES_BYTES
        if number == 3 and data:  # read the status from object 3, because it cannot be requested during a download
            return self._packet(HOUSEKEEPING, data[:1], None)
        joined = self._solve.take_joined((3, 4) if older else (3, 4, 5))
        if joined is not None:
            return self._packet(DEGREES if older else ATTITUDE, joined, None)
        self.good += 1
        return Answer()

    def _packet(self, name: str, content: bytes, stage: Stage | None, reply: bytes = b"") -> Answer:
        decoded = decode(self._dictionary.packet(name).fields, content, LITTLE)
        if name == ATTITUDE and not _is_rotation(decoded):
            raise CorruptData("the length of a quaternion is not 1")
        if name == "clock":
            sensor_s = float(decoded.values["seconds"]) + float(decoded.values["microseconds"]) / 1e6
            self._clock.ahead_s = sensor_s - self._clock.now_s
        elif name == HOUSEKEEPING:
            self._images.status = str(decoded.values["status"])
        elif name == CAPTURE:
            self._images.note_number(int(decoded.values["last_capture_s"]), self._clock.now_s)
        self.good += 1
        return Answer(stage, packet=name, content=decoded, time_s=self._clock.time_s(), reply=reply)

    @property
    def received(self) -> DirectionCounters:
        """Counters of the received bytes and packets."""
        reader = self._reader
        return DirectionCounters(
            bytes=reader.bytes,
            good=self.good,
            unframed=reader.unframed,
            unknown=self.unknown,
            undecodable=self.undecodable,
        )


def _is_rotation(decoded: Decoded) -> bool:
    """True if the quaternion has length 1, or if the sensor reports no attitude."""
    values = decoded.values
    length = math.sqrt(sum(float(values[f"quaternion_{axis}"]) ** 2 for axis in ("real", "i", "j", "k")))
    return values["known"] == "none" or abs(length - 1) <= MAX_ERROR


def message(data: bytes) -> bytes:
    """Return the CAN record of a message to the SDO server."""
    return CanFrame(SDO_REQUEST, data).record()
