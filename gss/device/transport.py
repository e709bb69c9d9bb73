"""Line I/O: serial port, pseudo-terminal, ``socket://host:port`` and ``rfc2217://host:port``. ``udp://``, ``can://``
and ``zmq://`` are in :mod:`gss.device.udp`, :mod:`gss.device.can_stream` and :mod:`gss.device.zmq_stream`.

Only this module imports pyserial. A read blocks at most for its timeout, opening a line at most for ``OPEN_WITHIN_S``.
LinkDown is raised if a port disappears, Conflict if another process uses a serial port.
"""

from __future__ import annotations

import contextlib
import os
import stat
import threading
from concurrent.futures import Future
from typing import Protocol

import serial

from gss.device.can_stream import CanStream
from gss.device.line_address import CAN, RFC2217, SLCAN, UDP, ZMQ, LineAddress, parse_line_address
from gss.device.udp import UdpStream
from gss.device.zmq_stream import ZmqStream
from gss.domain.errors import BadInput, Conflict, LinkDown, NotFound

DEFAULT_BAUD = 115_200
OPEN_WITHIN_S = 5.0
WRITE_TIMEOUT_S = 10.0
RFC2217_POLL_S = 0.01
SETTLE_S = 0.15
CONNECT_HINT = "start the device or the simulator, or check the address"
UNFINISHED_MOST = 8
_unfinished = threading.BoundedSemaphore(UNFINISHED_MOST)
"""Limits the number of threads that open lines at the same time. Each thread ends, because pyserial has timeouts."""


class ByteStream(Protocol):
    """An open line."""

    url: str

    def read(self, max_bytes: int, timeout_s: float) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


PORT_ERRORS = (OSError, TypeError, AttributeError, ValueError)
"""Errors that pyserial raises when a port fails.

TypeError or AttributeError: another thread closed the port during a blocking read. ValueError: the process has too many
open files for select().
"""


class SerialStream:
    """A ByteStream over pyserial. One thread may read while another writes."""

    def __init__(self, url: str, port: serial.Serial) -> None:
        self.url, self._port = url, port
        self._early, self._received_any = b"", False

    def settle(self) -> None:
        """Wait ``SETTLE_S``. Raises Conflict if the other end closes the connection during this time.

        A device server that serves one client at a time accepts a second connection and closes it. A byte received
        during the wait is kept for the first read.
        """
        try:
            self._early = self.read(1, SETTLE_S)
        except LinkDown as error:
            raise Conflict(
                f"{self.url} closed the connection immediately",
                got=error.got,
                hint="another program may be using the line; stop it, or use another port",
            ) from error

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Return up to ``max_bytes`` available bytes; wait up to ``timeout_s`` for the first byte. Returns b"" after
        the timeout.

        Raises LinkDown if the port or connection is lost.
        """
        if self._early:
            data, self._early = self._early, b""
            return data
        try:
            data = self._receive(self._port, max_bytes, timeout_s)
        except PORT_ERRORS as error:
            raise self._down(error) from error
        self._received_any = self._received_any or bool(data)
        return data

    def _receive(self, port: serial.Serial, max_bytes: int, timeout_s: float) -> bytes:
        if port.timeout != timeout_s:  # pyserial sets all parameters of the line with each change
            port.timeout = timeout_s
        data = bytes(port.read(1))
        if data and max_bytes > 1:
            data += self._available(port, max_bytes - 1)
        return data

    def _available(self, port: serial.Serial, max_bytes: int) -> bytes:
        port.timeout = 0  # a socket cannot report the number of available bytes
        return bytes(port.read(max_bytes))

    def write(self, data: bytes) -> None:
        """Write all of ``data``. Raises LinkDown on failure."""
        try:
            self._port.write(data)
        except PORT_ERRORS as error:
            raise self._down(error) from error

    def _down(self, error: Exception) -> LinkDown:
        hint = CONNECT_HINT if self._received_any else f"{CONNECT_HINT}; another program may be using the line"
        return LinkDown(f"the line {self.url} was lost", got=str(error), hint=hint)

    def close(self) -> None:
        """Close the port. Can be called more than once."""
        # pyserial does not close its socket if the other end closed the connection first.
        left_open = getattr(self._port, "_socket", None)
        with contextlib.suppress(OSError):
            self._port.close()
        if left_open is not None:
            left_open.close()


class DeviceStream(SerialStream):
    """SerialStream for a port of this machine, which reports the number of available bytes."""

    def _available(self, port: serial.Serial, max_bytes: int) -> bytes:
        return bytes(port.read(min(max_bytes, port.in_waiting)))


class Rfc2217Stream(SerialStream):
    """SerialStream for RFC 2217. Never changes the timeout, because pyserial renegotiates the port on every change."""

    def _receive(self, port: serial.Serial, max_bytes: int, timeout_s: float) -> bytes:
        for _ in range(max(1, round(timeout_s / RFC2217_POLL_S))):
            data = bytes(port.read(1))
            if data:
                return data + bytes(port.read(min(max_bytes - 1, port.in_waiting)))
        return b""


def open_stream(url: str, baud: int = DEFAULT_BAUD, within_s: float = OPEN_WITHIN_S) -> ByteStream:
    """Open a line on a separate thread. A local serial port is opened for exclusive use. All other lines can be shared
    with other programs: a CAN bus, the port of a serial CAN adapter, and the other end of a network connection.

    ``baud``: rate of a serial port or adapter; a device server may ignore it. Raises NotFound, Conflict, BadInput or
    LinkDown with the reason; LinkDown also after ``within_s``. A port that opens later is closed immediately.
    """
    address = parse_line_address(url)
    if not _unfinished.acquire(blocking=False):
        raise Conflict(
            "too many openings of lines are pending", expected=f"fewer than {UNFINISHED_MOST}", hint="try again later"
        )
    opening: Future[ByteStream] = Future()
    try:
        threading.Thread(
            target=_open_into, args=(opening, address, baud, within_s), name="open line", daemon=True
        ).start()
    except RuntimeError as error:
        _unfinished.release()
        raise LinkDown(
            f"cannot open {url}",
            expected="a free thread",
            got=str(error),
            hint="try again; if it persists, check the limits of memory and threads on this computer",
        ) from error
    try:
        return opening.result(within_s)
    except TimeoutError:
        opening.add_done_callback(_close_late)
        raise LinkDown(
            f"cannot open {url}", expected=f"an open port within {within_s:g} s", got="no answer", hint=CONNECT_HINT
        ) from None


def _open_into(opening: Future[ByteStream], address: LineAddress, baud: int, within_s: float) -> None:
    try:
        opening.set_result(_open(address, baud, within_s))
    except BaseException as error:  # raised again by opening.result()
        opening.set_exception(error)
    finally:
        _unfinished.release()


def _close_late(opening: Future[ByteStream]) -> None:
    if opening.exception() is None:
        opening.result().close()


def _open(address: LineAddress, baud: int, within_s: float) -> ByteStream:
    url = address.text
    if address.scheme == UDP:
        return UdpStream(address)
    if address.scheme == ZMQ:
        return ZmqStream(address, within_s)
    if address.interface == SLCAN:
        _check_device(address.channel)
    if address.scheme == CAN:
        return CanStream(address, baud)
    if address.is_device:
        _check_device(url)
    try:
        port = _port(address, baud)
        port.open()
    except serial.SerialException as error:
        raise _cannot_open(url, error) from error
    except (OSError, ValueError) as error:
        raise LinkDown(f"cannot open {url}", got=str(error), hint=CONNECT_HINT) from error
    if address.is_device:
        # Bytes that are already in the terminal's buffer belong to an earlier user of the port.
        with contextlib.suppress(OSError):
            port.reset_input_buffer()
        return DeviceStream(url, port)
    stream = Rfc2217Stream(url, port) if address.scheme == RFC2217 else SerialStream(url, port)
    try:
        stream.settle()
    except Conflict:
        stream.close()
        raise
    return stream


def _port(address: LineAddress, baud: int) -> serial.Serial:
    port = serial.serial_for_url(address.text, do_not_open=True)
    port.baudrate, port.timeout = baud, RFC2217_POLL_S
    if address.scheme != RFC2217:  # pyserial has no write timeout for RFC 2217; its socket stops waiting after 5 s
        port.write_timeout = WRITE_TIMEOUT_S
    if address.is_device:
        port.exclusive = True
    return port


def _check_device(path: str) -> None:
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise NotFound(f"there is no port {path}", hint=CONNECT_HINT) from None
    except OSError as error:
        raise LinkDown(f"cannot open {path}", got=str(error)) from error
    if not stat.S_ISCHR(mode):
        raise BadInput(f"{path} is not a serial port", expected="a terminal device")


def _cannot_open(url: str, error: serial.SerialException) -> Conflict | LinkDown:
    """Return the error for a failed opening. pyserial reports a locked port only in the message text."""
    text = str(error)
    if "exclusively lock" in text or "Resource temporarily unavailable" in text:
        return Conflict(f"another process uses {url}", got=text, hint="stop the other program, or use another port")
    if "Permission" in text:
        return LinkDown(f"no permission for {url}", got=text, hint="add your user to the group of the port")
    return LinkDown(f"cannot open {url}", got=text, hint=CONNECT_HINT)
