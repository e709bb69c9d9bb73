"""Line over UDP: ``udp://host:port``. A write sends one datagram, a read returns one.

The sensor, or the mission-control system in front of it, replies to the address from which it received data. Datagrams
can be lost or repeated without notice. UDP does not show whether the other end exists. An address that rejects
datagrams looks like a silent line.
"""

from __future__ import annotations

import contextlib
import socket

from gss.device.line_address import LineAddress
from gss.domain.errors import LinkDown

MAX_DATAGRAM = 65_507


class UdpStream:
    """A :class:`gss.device.transport.ByteStream` over one connected UDP socket."""

    def __init__(self, address: LineAddress) -> None:
        """Open the socket. Raises LinkDown if the host cannot be resolved or reached."""
        self.url = address.text
        try:
            family, kind, protocol, _, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
        except OSError as error:
            raise LinkDown(f"cannot open {self.url}", got=str(error), hint="check the host's name") from error
        try:
            self._socket.connect(place)
        except OSError as error:
            self._socket.close()
            raise LinkDown(f"cannot open {self.url}", got=str(error), hint="check the network") from error

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Return the next datagram; b"" if none is received within ``timeout_s``. Raises LinkDown if the socket is
        closed."""
        try:
            self._socket.settimeout(timeout_s)
            return self._socket.recv(MAX_DATAGRAM)
        except (TimeoutError, ConnectionRefusedError, BlockingIOError):
            return b""
        except OSError as error:
            raise self._down(error) from error

    def write(self, data: bytes) -> None:
        """Send the data as one datagram, or as several if the data are larger than a datagram. Raises LinkDown on
        failure."""
        for start in range(0, len(data), MAX_DATAGRAM):
            try:
                self._socket.send(data[start : start + MAX_DATAGRAM])
            except ConnectionRefusedError:
                continue  # this error concerns an earlier datagram; the other end may start later
            except OSError as error:
                raise self._down(error) from error

    def _down(self, error: OSError) -> LinkDown:
        return LinkDown(f"the line {self.url} was lost", got=str(error), hint="check the network")

    def close(self) -> None:
        """Close the socket. Can be called more than once."""
        with contextlib.suppress(OSError):
            self._socket.close()
