"""Device end of a CAN bus that processes on this machine share (python-can's ``udp_multicast``)."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

from gss.device.can_stream import CanStream
from gss.device.line_address import CAN, UDP_MULTICAST, parse_line_address
from gss.domain.errors import BadInput, LinkDown

GROUP = "239.74.163.2"
"""Default multicast group of python-can."""
PORT_FILE = "can-port"
MAX_PORT = 65_535


def bus_port(port: int, state_dir: Path | None) -> int:
    """Return the UDP port of the bus: ``port`` unless it is 0, else the port stored in ``state_dir``, else a free port.
    Raises BadInput if ``port`` is out of range."""
    if not 0 <= port <= MAX_PORT:
        raise BadInput("UDP port is out of range", expected=f"0 – {MAX_PORT}", got=str(port))
    if port:
        return port
    file = state_dir / PORT_FILE if state_dir is not None else None
    if file is not None:
        with contextlib.suppress(OSError, ValueError):
            return int(file.read_text("ascii"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        free_port: int = probe.getsockname()[1]
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(str(free_port), "ascii")
    return free_port


class CanBusLine:
    """A :class:`gss.device.simulator.terminal.DeviceLine` on a CAN bus. A bus needs no listener."""

    def __init__(self, port: int) -> None:
        """Open the bus. Raises LinkDown."""
        self.url = f"{CAN}://{UDP_MULTICAST}/{GROUP}:{port}"
        self._bus = CanStream(parse_line_address(self.url), 0)
        self._cut = False

    def wait_handles(self) -> list[int]:
        return [self._bus.fileno()]

    def read(self, count: int) -> bytes:
        data = self._bus.read(count, 0.0)
        return b"" if self._cut else data

    def write(self, data: bytes) -> int | None:
        """Send frames. Returns the number of accepted bytes, None if the line is disconnected, 0 if the network accepts
        none."""
        if self._cut:
            return None
        try:
            self._bus.write(data)
        except LinkDown:
            return 0
        return len(data)

    def hang_up(self) -> None:
        """Disconnect from the bus."""
        self._cut = True

    def restore(self) -> None:
        """Connect to the bus again."""
        self._cut = False

    def close(self) -> None:
        self._bus.close()
