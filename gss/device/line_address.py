"""Line addresses: a device path; scheme, host and port of a server; or interface and channel of a CAN bus.

All other addresses are rejected: pyserial reads options (timeouts, logging) from paths and queries, and its other
schemes (spy, alt, loop) write files or load code. python-can would accept any option of an interface.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from ipaddress import IPv6Address

from gss.domain.errors import BadInput

SOCKET, RFC2217, UDP, ZMQ, CAN = "socket", "rfc2217", "udp", "zmq", "can"
SOCKETCAN, SLCAN, UDP_MULTICAST = "socketcan", "slcan", "udp_multicast"
EXPECTED = (
    "a device path, socket://host:port, rfc2217://host:port, udp://host:port, zmq://host:port, can://socketcan/can0, "
    "can://slcan/dev/ttyACM0 or can://udp_multicast/239.0.0.0 – 239.255.255.255:port"
)
MAX_PORT = 65_535
NETWORK = re.compile(
    rf"(?P<scheme>{SOCKET}|{RFC2217}|{UDP}|{ZMQ})://"
    r"(?:(?P<name>[A-Za-z0-9._-]+)|\[(?P<ipv6>[0-9A-Fa-f:.]+(?:%[A-Za-z0-9._-]+)?)\])"
    r":(?P<port>[0-9]{1,5})"
)
CAN_BUS = re.compile(
    rf"{CAN}://(?:{SOCKETCAN}/(?P<interface>[A-Za-z0-9._-]{{1,15}})"
    rf"|{SLCAN}(?P<path>/dev(?:/[A-Za-z0-9_-][A-Za-z0-9._-]*)+)"
    rf"|{UDP_MULTICAST}/(?P<group>239(?:\.(?:25[0-5]|2[0-4][0-9]|1?[0-9]?[0-9])){{3}}):(?P<port>[0-9]{{1,5}}))"
)
"""Group addresses begin with 239, the range for private use."""


@dataclass(frozen=True)
class LineAddress:
    """A validated address. For a device path, ``scheme`` and ``host`` are "" and ``port`` is 0. ``host``: in lower
    case; for a CAN bus the multicast group. ``interface``, ``channel``: set for a CAN bus, "" otherwise."""

    text: str
    scheme: str = ""
    host: str = ""
    port: int = 0
    interface: str = ""
    channel: str = ""

    @property
    def is_device(self) -> bool:
        """True if the address is a device path on this machine."""
        return not self.scheme

    @property
    def is_local(self) -> bool:
        """True for a device or CAN bus of this machine. False for a multicast group, because other hosts can send to
        it."""
        return self.is_device or (self.scheme == CAN and self.interface != UDP_MULTICAST)


def parse_line_address(text: str) -> LineAddress:
    """Parse and validate an address. Raises BadInput if it has a user name, path, query or fragment, an unsupported
    scheme, or no valid port."""
    if text and "://" not in text and text.isprintable():
        return LineAddress(text)
    address = _can_bus(text) or _network(text)
    if address is None:
        raise BadInput(
            "invalid line address" if text else "no line address given",
            expected=EXPECTED,
            got=ascii(text)[:80] if text else "",
            hint=f"leave out user name, path, query and fragment; ports are 1 – {MAX_PORT}",
        )
    return address


def _network(text: str) -> LineAddress | None:
    match = NETWORK.fullmatch(text)
    if match is None or not _is_port(match["port"]) or not _is_host(match):
        return None
    return LineAddress(text, match["scheme"], (match["name"] or match["ipv6"]).lower(), int(match["port"]))


def _can_bus(text: str) -> LineAddress | None:
    match = CAN_BUS.fullmatch(text)
    if match is None:
        return None
    if match["group"]:
        if not _is_port(match["port"]):
            return None
        return LineAddress(text, CAN, match["group"], int(match["port"]), UDP_MULTICAST, match["group"])
    if match["path"]:
        return LineAddress(text, CAN, interface=SLCAN, channel=match["path"])
    return LineAddress(text, CAN, interface=SOCKETCAN, channel=match["interface"])


def _is_port(digits: str) -> bool:
    return 0 < int(digits) <= MAX_PORT


def _is_host(match: re.Match[str]) -> bool:
    if match["name"]:
        return True
    try:
        IPv6Address(match["ipv6"])
    except ValueError:
        return False
    return True
