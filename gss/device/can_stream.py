"""Line over a CAN bus: ``can://interface/channel``, through python-can. Each frame is one record of
:mod:`gss.device.can_frames`.

Only this module imports python-can. A bus does not show whether another node is connected. A bus without other nodes
looks like a silent line. A read blocks at most for its timeout.
"""

from __future__ import annotations

import contextlib
import logging
import time

import can
from can.interfaces.slcan import slcanBus

from gss.device.can_frames import MAX_EXTENDED, RECORD, CanFrame, CanReader
from gss.device.line_address import SLCAN, SOCKETCAN, UDP_MULTICAST, LineAddress
from gss.domain.errors import LinkDown

WRITE_TIMEOUT_S = 10.0
BUS_ERRORS = (can.CanError, OSError)
DAMAGED = (ValueError, TypeError)
"""Errors that python-can raises if a serial adapter sends text that is not a valid frame."""
THIS_MACHINE = 0
"""Hop limit of a bus that processes on this machine share. With this limit, frames do not leave the machine. Other
hosts of the network can still send to the group."""
HINTS = {
    SOCKETCAN: "set the interface up: ip link set can0 up type can bitrate 1000000",
    SLCAN: "check the adapter and its port",
    UDP_MULTICAST: "check that this computer has a route for multicast",
}
logging.getLogger("can").setLevel(logging.ERROR)  # python-can logs every frame that it cannot read


class CanStream:
    """A :class:`gss.device.transport.ByteStream` over one CAN bus."""

    def __init__(self, address: LineAddress, bitrate: int) -> None:
        """Open the bus. ``bitrate`` applies to serial adapters only; other interfaces have a configured bit rate.
        Raises LinkDown."""
        self.url = address.text
        self._partial, self._closed = CanReader(), False
        try:
            self._bus = _open(address, bitrate)
        except (*BUS_ERRORS, *DAMAGED) as error:
            raise LinkDown(f"cannot open {self.url}", got=str(error), hint=HINTS[address.interface]) from error

    def fileno(self) -> int:
        """Return the file descriptor that becomes readable when a frame is received."""
        return self._bus.fileno()

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Return the records that are available; wait up to ``timeout_s`` for the first one. Returns b"" after the
        timeout. Returns one record even if ``max_bytes`` is smaller. Raises LinkDown if the bus is lost."""
        records, end_s = b"", time.monotonic() + timeout_s
        while not records or len(records) + RECORD.size <= max_bytes:
            left_s = end_s - time.monotonic()
            record = self._receive(0.0 if records else max(0.0, left_s))
            if record is None:
                break
            records += record
            if left_s <= 0:  # a series of unsupported frames must not prolong the read without limit
                break
        return records

    def _receive(self, timeout_s: float) -> bytes | None:
        """Return the record of the next classic CAN frame; b"" for any other frame, None if no frame is received."""
        if self._closed:
            raise self._down("the bus was closed")
        try:
            message = self._bus.recv(timeout_s)
        except DAMAGED:
            return b""
        except BUS_ERRORS as error:
            if isinstance(error, OSError) or isinstance(error.__cause__, OSError):
                raise self._down(str(error)) from error
            if isinstance(self._bus, slcanBus):
                self._bus.flush()  # without this call, the adapter keeps the bytes that it cannot read
            return b""
        if message is None:
            return None
        if message.is_fd or message.is_error_frame:
            return b""
        frame = CanFrame(
            message.arbitration_id & MAX_EXTENDED,
            bytes(message.data),
            message.is_extended_id,
            message.is_remote_frame,
        )
        return frame.record()

    def write(self, data: bytes) -> None:
        """Send the frames of the complete records; an incomplete record is kept for the next call. Raises LinkDown on
        failure."""
        for frame in self._partial.feed(data):
            message = can.Message(
                arbitration_id=frame.id,
                data=frame.data,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
            )
            try:
                self._bus.send(message, timeout=WRITE_TIMEOUT_S)
            except BUS_ERRORS as error:
                raise self._down(str(error)) from error

    def _down(self, reason: str) -> LinkDown:
        return LinkDown(f"the line {self.url} was lost", got=reason, hint="check bus and adapter")

    def close(self) -> None:
        """Close the bus. Can be called more than once."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(*BUS_ERRORS):
            self._bus.shutdown()


def _open(address: LineAddress, bitrate: int) -> can.BusABC:
    """Open the bus with fixed options. python-can's configuration files are not used."""
    interface = address.interface
    if interface == UDP_MULTICAST:
        return can.Bus(
            address.host, interface=interface, ignore_config=True, port=address.port, fd=False, hop_limit=THIS_MACHINE
        )
    if interface == SLCAN:
        return can.Bus(address.channel, interface=interface, ignore_config=True, bitrate=bitrate, sleep_after_open=0.0)
    return can.Bus(address.channel, interface=interface, ignore_config=True)
