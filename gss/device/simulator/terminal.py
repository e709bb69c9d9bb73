"""The device's end of a real line: a pseudo-terminal or one TCP connection, paced to the baud rate, with faults.

One thread, one loop. Nobody listening is normal: a UART sends into the void, so what cannot be written is lost.
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

from gss.device.simulator.faults import LineFaults
from gss.device.simulator.machine import Device
from gss.domain.errors import Conflict

READ_BYTES = 4096
BACKLOG_BYTES = 4096
GIVE_UP_S = 1.0
BURST_S = 0.02


class Line(Protocol):
    """The near end of a line; never blocks."""

    url: str

    def wait_handles(self) -> list[int]: ...

    def read(self, count: int) -> bytes: ...

    def write(self, data: bytes) -> int | None: ...

    def close(self) -> None: ...


class PtyLine:
    """A pseudo-terminal in raw mode. The far side is kept open here too: a master without it reads EIO for ever."""

    def __init__(self, link: Path | None = None) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.url = os.ttyname(self._slave)
        self._link = link
        if link is not None:
            if link.is_symlink():
                link.unlink()
            link.symlink_to(self.url)
            self.url = str(link)

    def wait_handles(self) -> list[int]:
        return [self._master]

    def read(self, count: int) -> bytes:
        try:
            return os.read(self._master, count)
        except OSError:
            return b""

    def write(self, data: bytes) -> int | None:
        """Bytes taken; 0 when the buffer is full."""
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def close(self) -> None:
        for handle in (self._master, self._slave):
            with contextlib.suppress(OSError):
                os.close(handle)
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()


class TcpLine:
    """One connection at a time on the loopback; a second one is closed at once."""

    def __init__(self, port: int) -> None:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
        except OSError as error:
            self._listener.close()
            raise Conflict(f"port {port} is taken", got=str(error), hint="another port, or 0 for a free one") from error
        self._listener.listen(1)
        self._listener.setblocking(False)
        self._peer: socket.socket | None = None
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"

    def wait_handles(self) -> list[int]:
        return [self._listener.fileno(), *([self._peer.fileno()] if self._peer else [])]

    def _accept(self) -> None:
        try:
            peer, _ = self._listener.accept()
        except OSError:
            return
        if self._peer is not None:
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
        """Bytes taken, 0 when the buffer is full, None when nobody is there."""
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

    def close(self) -> None:
        self._drop()
        self._listener.close()


class Terminal:
    """Moves bytes between a line and a device. ``bytes_per_s`` 0: as fast as it goes. ``clock``: the simulated one."""

    def __init__(
        self,
        line: Line,
        device: Device,
        clock: Callable[[], float],
        bytes_per_s: float,
        up: LineFaults,
        down: LineFaults,
    ) -> None:
        self._line, self._device, self._clock, self._rate = line, device, clock, bytes_per_s
        self._up, self._down = up, down
        self._pending = b""
        self._blocked_s: float | None = None
        self._read_credit = self._write_credit = 0.0
        self._at_s = clock()

    def turn(self, wait_s: float, also: list[int] | None = None) -> list[int]:
        """Wait a little, then let time pass once. Returns which of the handles in ``also`` are ready."""
        handles = self._line.wait_handles() if self._may_read() else []
        ready, _, _ = select.select([*handles, *(also or [])], [], [], wait_s)
        now_s = self._clock()
        self._refill(now_s)
        self._receive(now_s)
        self._device.advance(now_s)
        self._send(now_s)
        return [h for h in (also or []) if h in ready]

    def _may_read(self) -> bool:
        return not self._rate or self._read_credit >= 1

    def _refill(self, now_s: float) -> None:
        elapsed_s, self._at_s = max(0.0, now_s - self._at_s), now_s
        if self._rate:
            # After a slow turn the line catches up with what it could have carried, up to a quarter second.
            most = self._rate * max(BURST_S, min(elapsed_s, 0.25))
            self._read_credit = min(self._read_credit + self._rate * elapsed_s, most)
            self._write_credit = min(self._write_credit + self._rate * elapsed_s, most)

    def _receive(self, now_s: float) -> None:
        if self._up.stalled(now_s):
            return
        while self._may_read():
            count = min(READ_BYTES, int(self._read_credit)) if self._rate else READ_BYTES
            data = self._line.read(count)
            self._read_credit -= len(data)
            if data:
                self._device.feed(self._up.apply(data), now_s)
            if len(data) < count:
                return

    def _send(self, now_s: float) -> None:
        if self._down.stalled(now_s):
            return
        while True:
            if not self._pending and not self._fetch(now_s):
                return
            share = min(len(self._pending), int(self._write_credit)) if self._rate else len(self._pending)
            if share <= 0:
                return
            taken = self._line.write(self._pending[:share])
            if taken is None:
                taken = share
            if taken == 0:
                self._wait_or_lose(now_s, share)
                return
            self._blocked_s = None
            self._write_credit -= taken
            self._pending = self._pending[taken:]

    def _fetch(self, now_s: float) -> bool:
        frame = self._device.next_frame(now_s)
        if frame is not None:
            self._pending += self._down.apply(frame)
        return frame is not None and bool(self._pending)

    def _wait_or_lose(self, now_s: float, share: int) -> None:
        """The buffer is full: after a while these bytes are gone, as on a wire that nobody reads."""
        if self._blocked_s is None:
            self._blocked_s = now_s
        elif now_s - self._blocked_s > GIVE_UP_S:
            self._pending = self._pending[share:]

    @property
    def busy(self) -> bool:
        """Is there something to write at once?"""
        return bool(self._pending)

    def close(self) -> None:
        """Let go of the line."""
        self._line.close()
