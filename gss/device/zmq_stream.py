"""Line over ZeroMQ: ``zmq://host:port``, through pyzmq. A DEALER socket connects to a DEALER or ROUTER of a
mission-control system.

Each write sends one message. The bytes of received messages are concatenated and message boundaries are ignored, so a
message can contain raw bytes or whole packets. Only this module imports pyzmq.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

import zmq
from zmq.utils.monitor import recv_monitor_message

from gss.device.line_address import LineAddress
from gss.domain.errors import LinkDown

log = logging.getLogger("gss.link")

WRITE_TIMEOUT_MS = 10_000
MAX_MESSAGE = 1 << 20
QUEUED_MESSAGES = 64
"""Queue length in each direction: 64 MiB with the largest messages. A faster sender waits."""
CLOSE_WITHIN_S = 11.0
LOST = (zmq.EVENT_DISCONNECTED, zmq.EVENT_CLOSED)
FAILED = (
    zmq.EVENT_CLOSED,
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL,
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL,
    zmq.EVENT_HANDSHAKE_FAILED_AUTH,
)


class ZmqStream:
    """A :class:`gss.device.transport.ByteStream` over one connection. A lock limits access to one thread at a time,
    because ZeroMQ sockets are not thread-safe."""

    def __init__(
        self, address: LineAddress, within_s: float, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Open the connection. Raises LinkDown unless a ZeroMQ socket answers within ``within_s``."""
        self.url, self._monotonic_s = address.text, monotonic_s
        self._lock, self._closed, self._buffer = threading.Lock(), False, b""
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        for option, value in (
            (zmq.LINGER, 0),
            (zmq.SNDTIMEO, WRITE_TIMEOUT_MS),
            (zmq.MAXMSGSIZE, MAX_MESSAGE),
            (zmq.RCVHWM, QUEUED_MESSAGES),
            (zmq.SNDHWM, QUEUED_MESSAGES),
            (zmq.RECONNECT_IVL, -1),  # no automatic reconnection: the owner of the line opens it again
            (zmq.IPV6, 1),
        ):
            self._socket.setsockopt(option, value)
        self._monitor = self._socket.get_monitor_socket()
        self._poller = zmq.Poller()
        self._poller.register(self._socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        try:
            host = f"[{address.host}]" if ":" in address.host else address.host
            self._socket.connect(f"tcp://{host}:{address.port}")
            self._await_handshake(within_s)
        except (zmq.ZMQError, LinkDown) as error:
            self.close()
            if isinstance(error, LinkDown):
                raise
            raise LinkDown(f"cannot open {self.url}", got=str(error), hint="check the host's name") from error

    def _await_handshake(self, within_s: float) -> None:
        until_s = self._monotonic_s() + within_s
        while (left_s := until_s - self._monotonic_s()) > 0:
            if not self._monitor.poll(math.ceil(left_s * 1000)):
                break
            event = recv_monitor_message(self._monitor)["event"]
            if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                return
            if event in FAILED:
                raise LinkDown(
                    f"cannot open {self.url}",
                    got="the connection was refused, or no ZeroMQ socket answers",
                    hint="start the other end, or check the address",
                )
        raise LinkDown(
            f"cannot open {self.url}",
            expected=f"a ZeroMQ socket that answers within {within_s:g} s",
            got="no answer",
            hint="start the other end, or check the address",
        )

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Return up to ``max_bytes`` available bytes; wait up to ``timeout_s`` for the first byte. Returns b"" after
        the timeout. Raises LinkDown if the connection is lost, but only after all received bytes were returned."""
        with self._lock:
            self._check_open()
            try:
                ready = {} if self._buffer else dict(self._poller.poll(math.ceil(timeout_s * 1000)))
                while len(self._buffer) < max_bytes and self._socket.poll(0):
                    self._buffer += b"".join(self._socket.recv_multipart(zmq.DONTWAIT))
            except zmq.ZMQError as error:
                raise self._down(str(error)) from error
            data, self._buffer = self._buffer[:max_bytes], self._buffer[max_bytes:]
            if not data and self._monitor in ready:
                self._check_event(recv_monitor_message(self._monitor)["event"])
            return data

    def _check_event(self, event: int) -> None:
        if event in LOST:
            raise self._down("the other end closed the connection")

    def write(self, data: bytes) -> None:
        """Send the data as one message. Raises LinkDown on failure."""
        with self._lock:
            self._check_open()
            try:
                for start in range(0, len(data), MAX_MESSAGE):
                    self._socket.send(data[start : start + MAX_MESSAGE])
            except zmq.ZMQError as error:
                raise self._down(str(error)) from error

    def _check_open(self) -> None:
        if self._closed:
            raise self._down("the connection was closed")

    def _down(self, reason: str) -> LinkDown:
        return LinkDown(f"the line {self.url} was lost", got=reason, hint="check the other end and the network")

    def close(self) -> None:
        """Close the connection. Can be called more than once. If another thread is reading, waits for the end of the
        read."""
        if not self._lock.acquire(timeout=CLOSE_WITHIN_S):
            log.error("%s was not closed: a read did not end within %g s", self.url, CLOSE_WITHIN_S)
            return
        try:
            if not self._closed:
                self._closed = True
                self._socket.disable_monitor()
                self._monitor.close(linger=0)
                self._socket.close(linger=0)
                self._context.term()
        finally:
            self._lock.release()
