"""Bytes to and from a port: tty, pseudo-terminal, ``socket://host:port`` and whatever else pyserial's URLs name.

The only importer of pyserial. Reading blocks at most as long as asked; a port that vanishes is a LinkDown; a port that
another process holds is a Conflict.
"""

from __future__ import annotations

import contextlib
import os
import stat
from typing import Protocol

import serial

from gss.domain.errors import BadInput, Conflict, LinkDown, NotFound

WRITE_TIMEOUT_S = 10.0
SCHEMES = ("", "socket", "rfc2217")
SETTLE_S = 0.15
CONNECT_HINT = "start the device or the simulator, or check the address"


class ByteStream(Protocol):
    """An open line."""

    url: str

    def read(self, max_bytes: int, timeout_s: float) -> bytes: ...

    def write(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class SerialStream:
    """A ByteStream over pyserial. Reading and writing may happen in different threads; one of each at a time."""

    def __init__(self, url: str, port: serial.SerialBase) -> None:
        self.url, self._port = url, port
        self._early, self._heard = b"", False

    def settle(self) -> None:
        """Wait a moment for the far end to hang up: a device server that speaks to one program at a time takes the second
        connection and closes it. Conflict then; what comes meanwhile is kept for the first read."""
        try:
            self._early = self.read(1, SETTLE_S)
        except LinkDown as error:
            raise Conflict(
                f"{self.url} hung up at once",
                got=error.got,
                hint="another program may hold the line; stop it, or use another port",
            ) from error

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Up to ``max_bytes``: what is there, or what comes first within ``timeout_s``; b"" if nothing does. LinkDown if
        the far end is gone."""
        if self._early:
            data, self._early = self._early, b""
            return data
        port = self._port
        try:
            port.timeout = timeout_s
            data = bytes(port.read(1))
            if data and max_bytes > 1:
                # Asking for more with no timeout gives what is there; a socket does not know how much that is.
                port.timeout = 0
                data += bytes(port.read(max_bytes - 1))
            self._heard = self._heard or bool(data)
            return data
        except (OSError, TypeError, AttributeError) as error:
            # pyserial raises TypeError or AttributeError when another thread closes the port under a blocked read.
            raise self._down(error) from error

    def write(self, data: bytes) -> None:
        """All of ``data``, or LinkDown."""
        try:
            self._port.write(data)
        except (OSError, TypeError, AttributeError) as error:
            raise self._down(error) from error

    def _down(self, error: Exception) -> LinkDown:
        hint = CONNECT_HINT if self._heard else f"{CONNECT_HINT}; another program may hold the line"
        return LinkDown(f"the line {self.url} is gone", got=str(error), hint=hint)

    def close(self) -> None:
        """Give the port back. Closing twice is fine."""
        # pyserial forgets to close its socket when the far end has gone first.
        left_open = getattr(self._port, "_socket", None)
        with contextlib.suppress(OSError):
            self._port.close()
        if left_open is not None:
            left_open.close()


def open_stream(url: str, baud: int = 115_200) -> ByteStream:
    """Open a line for this process alone. NotFound, Conflict or LinkDown say what is in the way."""
    if not url:
        raise BadInput("no line given", expected="a device path or socket://host:port")
    _check_address(url)
    is_socket = "://" in url
    if not is_socket:
        _check_device(url)
    try:
        port = serial.serial_for_url(url, do_not_open=True)
        port.baudrate, port.timeout, port.write_timeout = baud, 0.1, WRITE_TIMEOUT_S
        if not is_socket:
            port.exclusive = True
        port.open()
    except serial.SerialException as error:
        raise _cannot_open(url, error) from error
    except (OSError, ValueError) as error:
        raise LinkDown(f"cannot open {url}", got=str(error), hint=CONNECT_HINT) from error
    if not is_socket:
        # What lay in the terminal's buffer before we came belongs to nobody.
        with contextlib.suppress(OSError):
            port.reset_input_buffer()
    stream = SerialStream(url, port)
    if is_socket:
        try:
            stream.settle()
        except Conflict:
            stream.close()
            raise
    return stream


def _check_address(url: str) -> None:
    """Only lines: pyserial's other schemes (spy, alt, loop) write files or load code on behalf of the address."""
    scheme = url.partition("://")[0] if "://" in url else ""
    if scheme not in SCHEMES or not url.isprintable():
        raise BadInput(
            "not the address of a line",
            expected="a device path, socket:// or rfc2217://host:port",
            got=ascii(url)[:80],
        )


def _check_device(path: str) -> None:
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise NotFound(f"there is no port {path}", hint=CONNECT_HINT) from None
    except OSError as error:
        raise LinkDown(f"cannot open {path}", got=str(error)) from error
    if not stat.S_ISCHR(mode):
        raise BadInput(f"{path} is no serial port", expected="a terminal device")


def _cannot_open(url: str, error: serial.SerialException) -> Conflict | LinkDown:
    """pyserial reports a held lock in the text only."""
    text = str(error)
    if "exclusively lock" in text or "Resource temporarily unavailable" in text:
        return Conflict(f"another process holds {url}", got=text, hint="stop the other program, or use another port")
    if "Permission" in text:
        return LinkDown(f"no permission for {url}", got=text, hint="add your user to the group of the port")
    return LinkDown(f"cannot open {url}", got=text, hint=CONNECT_HINT)
