"""Device end of a real line: a pseudo-terminal or one TCP connection, limited to the baud rate, with line faults.

Runs in one loop of one thread. As on a UART, bytes that cannot be written, for example without a listener, are lost.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from gss.device.simulator.faults import LineControl
from gss.device.simulator.other_makers import SimulatedUnit
from gss.domain.errors import BadInput, Conflict

READ_BYTES = 4096
GIVE_UP_S = 5.0
"""Time after which unread bytes are lost; a reader on a busy machine can pause for seconds."""
BURST_S = 0.02


class DeviceLine(Protocol):
    """Device end of a line; never blocks."""

    url: str

    def wait_handles(self) -> list[int]: ...

    def read(self, count: int) -> bytes: ...

    def write(self, data: bytes) -> int | None: ...

    def hang_up(self) -> None: ...

    def restore(self) -> None: ...

    def close(self) -> None: ...


class PtyLine:
    """A pseudo-terminal in raw mode. Keeps the slave end open, because otherwise reads from the master fail with
    EIO."""

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self._handles: tuple[int, int] | None = None
        self._cut = False
        self.url = self._open()

    def _open(self) -> str:
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self._handles = (master, slave)
        name = os.ttyname(slave)
        if self._link is None:
            return name
        if self._link.is_symlink():
            self._link.unlink()
        self._link.symlink_to(name)
        return str(self._link)

    def wait_handles(self) -> list[int]:
        return [self._handles[0]] if self._handles else []

    def read(self, count: int) -> bytes:
        if self._handles is None:
            return b""
        try:
            data = os.read(self._handles[0], count)
        except OSError:
            return b""
        return b"" if self._cut else data

    def write(self, data: bytes) -> int | None:
        """Write without blocking. Returns the number of accepted bytes, 0 if the buffer is full, None if the line is
        disconnected."""
        if self._cut or self._handles is None:
            return None
        try:
            return os.write(self._handles[0], data)
        except OSError:
            return 0

    def hang_up(self) -> None:
        """Disconnect the line.

        With a symlink the port disappears. Without a symlink, the port could not reappear under the same name, so the
        line only stops responding.
        """
        self._cut = True
        if self._link is not None:
            self._release()

    def restore(self) -> None:
        """Reconnect the line: a new port behind the same symlink."""
        self._cut = False
        if self._handles is None:
            self.url = self._open()

    def _release(self) -> None:
        for handle in self._handles or ():
            with contextlib.suppress(OSError):
                os.close(handle)
        self._handles = None
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def close(self) -> None:
        self._release()


class TcpLine:
    """One TCP connection at a time on the loopback interface; a second connection is closed immediately."""

    def __init__(self, port: int) -> None:
        if not 0 <= port <= 65535:
            raise BadInput("TCP port is out of range", expected="0 – 65535", got=str(port))
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
        except OSError as error:
            self._listener.close()
            raise Conflict(
                f"port {port} is in use", got=str(error), hint="choose another port, or 0 for a free one"
            ) from error
        self._listener.listen(1)
        self._listener.setblocking(False)
        self._peer: socket.socket | None = None
        self._cut = False
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"

    def wait_handles(self) -> list[int]:
        return [self._listener.fileno(), *([self._peer.fileno()] if self._peer else [])]

    def _accept(self) -> None:
        try:
            peer, _ = self._listener.accept()
        except OSError:
            return
        if self._peer is not None or self._cut:
            peer.close()
            return
        peer.setblocking(False)
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._peer = peer

    def _drop(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    def read(self, count: int) -> bytes:
        self._accept()
        if self._peer is None:
            return b""
        try:
            data = self._peer.recv(count)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop()
        return data

    def write(self, data: bytes) -> int | None:
        """Write without blocking. Returns the number of accepted bytes, 0 if the buffer is full, None without a
        client."""
        if self._peer is None:
            return None
        try:
            return self._peer.send(data)
        except BlockingIOError:
            return 0
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.ECONNRESET):
                return 0
            self._drop()
            return None

    def hang_up(self) -> None:
        """Close the connection, and close new connections immediately."""
        self._cut = True
        self._drop()

    def restore(self) -> None:
        """Accept connections again."""
        self._cut = False

    def close(self) -> None:
        self._drop()
        self._listener.close()


class Terminal:
    """Moves bytes between a line and a device.

    ``bytes_per_s`` 0: no rate limit. ``clock``: simulated clock. ``paced``: False also removes the rate limit, as
    required while the clock is stopped.
    """

    def __init__(
        self,
        line: DeviceLine,
        device: SimulatedUnit,
        clock: Callable[[], float],
        bytes_per_s: float,
        control: LineControl,
    ) -> None:
        self._line, self._device, self._clock, self._rate = line, device, clock, bytes_per_s
        self._control, self._connected = control, True
        self.paced = True
        self._pending = b""  # bytes to which faults were applied; they wait for the line rate
        self._out = b""  # bytes whose delay has ended; they wait for buffer space
        self._blocked_s: float | None = None
        self._read_credit = self._write_credit = 0.0
        self._at_s = clock()

    def run_once(self, wait_s: float, extra_handles: list[int] | None = None) -> list[int]:
        """Wait up to ``wait_s``, then advance the device once. Returns the ready handles of ``extra_handles``."""
        handles = self._line.wait_handles() if self._may_read() else []
        ready, _, _ = select.select([*handles, *(extra_handles or [])], [], [], wait_s)
        now_s = self._clock()
        self._connect_or_cut(now_s)
        self._refill(now_s)
        self._receive(now_s)
        self._device.advance(now_s)
        self._send(now_s)
        return [h for h in (extra_handles or []) if h in ready]

    def _connect_or_cut(self, now_s: float) -> None:
        connected = self._control.connected(now_s)
        if connected and not self._connected:
            self._line.restore()
        elif self._connected and not connected:
            self._control.down.counts.bytes_lost_disconnected += len(self._pending) + len(self._out)
            self._pending = self._out = b""
            self._control.up.lose_all()
            self._control.down.lose_all()
            self._line.hang_up()
        self._connected = connected

    @property
    def _limited(self) -> bool:
        return bool(self._rate) and self.paced

    def _may_read(self) -> bool:
        return not self._limited or self._read_credit >= 1

    def _refill(self, now_s: float) -> None:
        elapsed_s, self._at_s = max(0.0, now_s - self._at_s), now_s
        if self._limited:
            # After a slow iteration, the bytes of up to a quarter second are sent at the same time.
            max_credit = self._rate * max(BURST_S, min(elapsed_s, 0.25))
            self._read_credit = min(self._read_credit + self._rate * elapsed_s, max_credit)
            self._write_credit = min(self._write_credit + self._rate * elapsed_s, max_credit)

    def _receive(self, now_s: float) -> None:
        if self._control.up.stalled(now_s):
            return
        arrived = self._control.up.carry(b"", now_s)
        if arrived:
            self._device.feed(arrived, now_s)
        while self._may_read():
            count = min(READ_BYTES, int(self._read_credit)) if self._limited else READ_BYTES
            data = self._line.read(count)
            if self._limited:
                self._read_credit -= len(data)
            if data:
                self._device.feed(self._control.up.carry(data, now_s), now_s)
            if len(data) < count:
                return

    def _send(self, now_s: float) -> None:
        if self._control.down.stalled(now_s):
            return
        self._out += self._control.down.late(b"", now_s)
        while self._write_due(now_s) and (self._pending or self._fetch(now_s)):
            share = min(len(self._pending), int(self._write_credit)) if self._limited else len(self._pending)
            if share <= 0:
                return
            if self._limited:
                self._write_credit -= share
            self._out += self._control.down.late(self._pending[:share], now_s)
            self._pending = self._pending[share:]

    def _fetch(self, now_s: float) -> bool:
        """Append the next frame of the device, with faults applied. Returns False if there is none."""
        frame = self._device.next_frame(now_s)
        if frame is not None:
            self._pending += self._control.down.apply(frame)
        return frame is not None

    def _write_due(self, now_s: float) -> bool:
        """Write the bytes that are due. Returns False if the buffer is full.

        After ``GIVE_UP_S`` without progress the bytes are lost, as on a wire without a reader.
        """
        if not self._out:
            return True
        accepted = self._line.write(self._out)
        if accepted is None:
            accepted = len(self._out)
            self._control.down.counts.bytes_lost_disconnected += 0 if self._connected else accepted
        self._out = self._out[accepted:]
        if not self._out:
            self._blocked_s = None
            return True
        if accepted or self._blocked_s is None:
            self._blocked_s = now_s
        elif now_s - self._blocked_s > GIVE_UP_S:
            self._control.down.counts.bytes_lost_unread += len(self._out)
            self._out = b""
        return False

    @property
    def busy(self) -> bool:
        """True if bytes are waiting to be written."""
        return bool(self._pending or self._out)

    def close(self) -> None:
        """Close the line."""
        self._line.close()
