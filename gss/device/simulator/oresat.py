"""Simulated OreSat star tracker, written from public facts (oresat-configs 7e7351d, oresat-star-tracker-software
42825b3). Not compared with a unit.

The SDO server of the library ``canopen``, which the card's software also uses, answers service data; it runs without
the library's bus and threads. The library does not support block transfers: like the card, it answers such a request
with a segmented transfer.
"""

from __future__ import annotations

import io
import logging
import struct
from collections import deque

import canopen.network
import numpy as np
from canopen.objectdictionary import ODRecord, ODVariable
from canopen.objectdictionary import datatypes as dt
from PIL import Image

from gss.device.can_frames import CanFrame, CanReader
from gss.device.simulator.other_makers import UnitWorld, check_dialects, measured
from gss.device.simulator.sdo_blocks import BlockServer
from gss.device.simulator.sky import SimulatedSky
from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix

NODE = 0x2C
OFF, BOOT, STANDBY, LOW_POWER, STAR_TRACK, CAPTURE, ERROR = 0, 1, 2, 3, 4, 5, 255
AWAKE = (STANDBY, LOW_POWER, STAR_TRACK, CAPTURE)
FOLLOWS: dict[int, tuple[int, ...]] = {
    OFF: (BOOT,),
    STANDBY: AWAKE,
    LOW_POWER: AWAKE,
    STAR_TRACK: (*AWAKE, ERROR),
    CAPTURE: (*AWAKE, ERROR),
    ERROR: (OFF,),
}
"""Statuses that a command can select, by current status. BOOT ends without a command."""
BOOT_S = 70.0
HEARTBEAT_S, CARD_S, UPDATER_S = 1.0, 30.0, 5.0
EXPOSURE_S, SOLVE_S = 0.3, 0.7
"""Chosen, because no values are published."""
SIGMA_ARCSEC = (10.0, 10.0, 60.0)
FASTEST_RAD_S = float(np.radians(1.0))
"""Chosen, because accuracy and largest rate are not published."""
START_UNIX_S = 1_767_225_600
"""Clock at power-up: 2026-01-01, the default date of the simulated sky."""
DAY_S = 86_400
LOST_FROM_CAM: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""The solver's frame has the boresight as x, y to the left and z up in the image."""
BLOCK, OLDER, MIDNIGHT, BOOTING = "block", "oresat0", "midnight", "boot"
DIALECTS = (BLOCK, OLDER, MIDNIGHT, BOOTING)
OBJECTS: tuple[tuple[int, int, str, int, str, int | None], ...] = (
    (0x4000, 0, "status", dt.UNSIGNED8, "rw", STANDBY),
    (0x4001, 1, "number of images", dt.UNSIGNED8, "rw", 1),
    (0x4001, 2, "delay", dt.UNSIGNED32, "rw", 100),
    (0x4001, 3, "duration", dt.UNSIGNED32, "rw", 1),
    (0x4001, 4, "last raw capture", dt.DOMAIN, "ro", None),
    (0x4001, 5, "last display image", dt.DOMAIN, "ro", None),
    (0x4001, 6, "last capture time", dt.UNSIGNED64, "ro", 0),
    (0x4001, 7, "images captured", dt.UNSIGNED32, "ro", 0),
    (0x4001, 8, "save captures", dt.BOOLEAN, "rw", 1),
    (0x4003, 1, "filter enable", dt.BOOLEAN, "rw", 1),
    (0x4003, 2, "filter lower bound", dt.UNSIGNED8, "rw", 0),
    (0x4003, 3, "filter lower percentage", dt.UNSIGNED8, "rw", 0),
    (0x4003, 4, "filter upper bound", dt.UNSIGNED8, "rw", 0),
    (0x4003, 5, "filter upper percentage", dt.UNSIGNED8, "rw", 0),
    (0x3003, 1, "reset", dt.UNSIGNED8, "wo", None),
    (0x3003, 2, "storage", dt.UNSIGNED8, "ro", 12),
    (0x3003, 3, "memory", dt.UNSIGNED8, "ro", 34),
    (0x2010, 0, "time", dt.UNSIGNED64, "rw", None),
)
"""Index, subindex, name, type, access, default."""
MAX_FILES = 255
logging.getLogger("canopen").setLevel(logging.CRITICAL)  # the library logs every message that it cannot read


def open_unit(world: UnitWorld) -> OresatUnit:
    """Create the unit. Raises BadInput for an unknown dialect."""
    check_dialects(world.dialects, DIALECTS)
    return OresatUnit(world)


class MemoryNetwork(canopen.network.Network):
    """The library's network without bus and threads: sent messages are collected."""

    def __init__(self) -> None:
        super().__init__()
        self.out: deque[bytes] = deque()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Collect a message as a record."""
        self.out.append(CanFrame(can_id, bytes(data), remote=remote).record())


class OresatUnit:
    """Simulated unit. Dialects: ``block`` supports block transfers; ``oresat0`` sends the attitude in whole degrees, as
    in the older dictionary; ``midnight`` sends milliseconds since midnight instead of Unix seconds; ``boot`` starts in
    the status BOOT, as at power-up."""

    def __init__(self, world: UnitWorld) -> None:
        self._world, self._reader, self._network = world, CanReader(), MemoryNetwork()
        self._node = self._network.create_node(NODE, _object_dictionary())
        self._node.add_read_callback(self._on_read)  # type: ignore[no-untyped-call]  # canopen types its other functions
        self._node.add_write_callback(self._on_write)  # type: ignore[no-untyped-call]  # canopen types its other functions
        self._blocks = BlockServer(self._content)
        environment = world.environment
        self._sky = SimulatedSky(
            world.instrument.profile, environment.motion, environment.epoch_jyear, world.seed, environment
        )
        self._status = BOOT if BOOTING in world.dialects else STANDBY
        self._now_s, self._ahead_s = 0.0, float(START_UNIX_S)
        self._due_s = {"heartbeat": 0.0, "card": 0.0, "updater": 0.0}
        self._work_s, self._until_s, self._taken, self._frames, self._files = 0.0, 0.0, 0, 0, 0
        self._pixels: Array | None = None
        self._captured_unix_s = 0

    # --- received -----------------------------------------------------------------------------------------------

    def feed(self, data: bytes, now_s: float) -> None:
        """Process received records. Messages that the library cannot read are not answered."""
        self._now_s = now_s
        for frame in self._reader.feed(data):
            if frame.extended or frame.remote:
                continue
            if frame.id == 0x600 + NODE and len(frame.data) == 8:
                self._service_data(frame.data)
            elif frame.id == 0x181 and len(frame.data) == 8:
                self._set_clock(frame.data)
            elif frame.id == 0 and len(frame.data) == 2:
                self._network.notify(frame.id, bytearray(frame.data), now_s)

    def _service_data(self, message: bytes) -> None:
        if BLOCK in self._world.dialects and BlockServer.is_block_upload(message):
            for answer in self._blocks.respond(message):
                self._network.send_message(0x580 + NODE, answer)
            return
        self._blocks.stop()
        try:
            self._network.notify(0x600 + NODE, bytearray(message), self._now_s)
        except (struct.error, TypeError):
            return  # the message belongs to a transfer that the library's server has not started

    def _content(self, index: int, subindex: int) -> bytes:
        return bytes(self._node.get_data(index, subindex, check_readable=True))

    def _set_clock(self, scet: bytes) -> None:
        seconds, microseconds = struct.unpack("<II", scet)
        self._ahead_s = seconds + (microseconds & 0xFF_FFFF) / 1e6 - self._now_s

    def _unix_s(self) -> float:
        return self._now_s + self._ahead_s

    def _on_read(self, index: int, subindex: int, od: ODVariable) -> int | bytes | None:
        """Return the value of an object that the card computes; None for a stored object."""
        if index == 0x4000:
            return self._status
        if index == 0x2010:
            whole_s = int(self._unix_s())
            return whole_s | int((self._unix_s() - whole_s) * 1e6) << 32
        if (index, subindex) == (0x4001, 4):
            return b""
        if (index, subindex) == (0x4001, 5):
            return self._preview()
        return self._captured_unix_s if (index, subindex) == (0x4001, 6) else None

    def _on_write(self, index: int, subindex: int, od: ODVariable, data: bytes) -> None:
        if index == 0x4000 and data[0] in FOLLOWS.get(self._status, ()):
            self._enter(data[0])
        elif index == 0x2010:
            self._set_clock(bytes(data))
        elif (index, subindex) == (0x3003, 1) and data[0] in (1, 2, 3):
            self._restart()

    def _restart(self) -> None:
        self._node.data_store.clear()
        self._pixels, self._captured_unix_s, self._files = None, 0, 0
        self._enter(STANDBY)
        self._network.send_message(0x700 + NODE, b"\0")

    def _value(self, index: int, subindex: int) -> int:
        """Return a stored setting."""
        return int.from_bytes(self._content(index, subindex), "little")

    def _preview(self) -> bytes:
        if self._pixels is None:
            return b""
        file = io.BytesIO()
        Image.fromarray(np.repeat(self._pixels[:, :, None], 3, axis=2)).save(file, "PNG")
        return file.getvalue()

    # --- work ---------------------------------------------------------------------------------------------------

    def _enter(self, status: int) -> None:
        self._status, self._taken = status, 0
        self._work_s = self._now_s + EXPOSURE_S + SOLVE_S * (status == STAR_TRACK)
        self._until_s = self._now_s + self._value(0x4001, 3)

    def advance(self, now_s: float) -> None:
        """Send the messages that are due; take and solve images."""
        self._now_s = now_s
        if self._status == BOOT and now_s >= BOOT_S:
            self._enter(STANDBY)
        for name, every_s in (("heartbeat", HEARTBEAT_S), ("card", CARD_S), ("updater", UPDATER_S)):
            if now_s >= self._due_s[name]:
                self._due_s[name] = now_s + every_s
                self._report(name)
        if now_s < self._work_s:
            return
        if self._status == CAPTURE:
            self._capture()
        elif self._status == STAR_TRACK:
            self._track()

    def _report(self, name: str) -> None:
        if name == "heartbeat":
            self._network.send_message(0x700 + NODE, b"\5")
        elif name == "card":
            share = self._value(0x3003, 2), self._value(0x3003, 3)
            self._network.send_message(0x180 + NODE, bytes([*share, self._files, 0, 6, 0]))
        else:
            self._network.send_message(0x280 + NODE, bytes([2, 0]))

    def _capture(self) -> None:
        self._expose()
        self._taken += 1
        count, delay_s = self._value(0x4001, 1), self._value(0x4001, 2) / 1e3
        self._work_s = self._now_s + EXPOSURE_S + delay_s
        if self._passes_filter() and self._value(0x4001, 8):
            self._files = min(MAX_FILES, self._files + 1)
        if (count and self._taken >= count) or (self._now_s >= self._until_s and self._taken):
            self._enter(STANDBY)

    def _expose(self) -> None:
        self._frames += 1
        exposed = self._sky.expose(self._now_s - EXPOSURE_S / 2, EXPOSURE_S, self._frames)
        self._pixels, self._captured_unix_s = exposed.pixels.astype(np.uint8), int(self._unix_s())

    def _passes_filter(self) -> bool:
        """True if enough pixels are above the lower and below the upper bound. False while the filter is disabled."""
        enabled, lower, lower_share, upper, upper_share = (self._value(0x4003, k) for k in range(1, 6))
        if not enabled or self._pixels is None:
            return False
        above, below = (100 * float(part.mean()) for part in (self._pixels > lower, self._pixels < upper))
        return (not lower or above >= lower_share) and (not upper or below >= upper_share)

    def _track(self) -> None:
        delay_s = self._value(0x4001, 2) / 1e3
        self._work_s = self._now_s + delay_s + EXPOSURE_S + SOLVE_S
        self._expose()
        quaternion, rate_rad_s = measured(self._world, self._now_s - SOLVE_S - EXPOSURE_S / 2, SIGMA_ARCSEC)
        attitude_known = float(np.linalg.norm(rate_rad_s)) <= FASTEST_RAD_S
        if attitude_known or OLDER in self._world.dialects:
            self._publish(matrix_from_quaternion(quaternion), attitude_known)
        if not delay_s:
            self._enter(STANDBY)

    def _publish(self, cam_from_icrs: Array, attitude_known: bool) -> None:
        lost_from_icrs = LOST_FROM_CAM @ cam_from_icrs
        unix_s = self._unix_s()
        time = int(unix_s % DAY_S * 1000) if MIDNIGHT in self._world.dialects else int(unix_s)
        if OLDER in self._world.dialects:
            angles = _degrees(lost_from_icrs) if attitude_known else (0, 0, 0)
            self._network.send_message(0x380 + NODE, struct.pack("<B3h", self._status, *angles))
            self._network.send_message(0x480 + NODE, struct.pack("<I", time))
            return
        i, j, k, real = (float(q) for q in quaternion_from_matrix(lost_from_icrs))
        self._network.send_message(0x380 + NODE, struct.pack("<BBI", self._status, attitude_known, time))
        self._network.send_message(0x480 + NODE, struct.pack("<2f", real, i))
        self._network.send_message(0x181 + NODE, struct.pack("<2f", j, k))

    def next_frame(self, now_s: float) -> bytes | None:
        """Return the next record to send, or None."""
        return self._network.out.popleft() if self._network.out else None

    def shut_down(self, now_s: float) -> None:
        """Do nothing: settings last for one run."""


def _degrees(lost_from_icrs: Array) -> tuple[int, int, int]:
    """Return right ascension, declination and roll in whole degrees, truncated, in the solver's convention."""
    boresight, left, up = lost_from_icrs
    ra, dec = np.arctan2(boresight[1], boresight[0]) % (2 * np.pi), np.arcsin(np.clip(boresight[2], -1, 1))
    roll = np.arctan2(-left[2], up[2]) % (2 * np.pi)
    return int(np.degrees(ra)), int(np.degrees(dec)), int(np.degrees(roll))


def _object_dictionary() -> canopen.ObjectDictionary:
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]  # canopen types its other functions
    records: dict[int, ODRecord] = {}
    for index, subindex, name, data_type, access, default in OBJECTS:
        variable = ODVariable(name, index, subindex)
        variable.data_type, variable.access_type, variable.default = data_type, access, default
        if subindex == 0:
            dictionary.add_object(variable)
            continue
        if index not in records:
            records[index] = ODRecord(f"0x{index:04X}", index)
            dictionary.add_object(records[index])
        records[index].add_member(variable)
    return dictionary
