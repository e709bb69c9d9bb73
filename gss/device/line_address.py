"""Line addresses: a device path, or scheme, host and port of a serial device server.

Nothing else is accepted: pyserial reads options (timeouts, logging) from paths and queries, and its other schemes (spy,
alt, loop) write files or load code.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from ipaddress import IPv6Address

from gss.domain.errors import BadInput

SOCKET, RFC2217, UDP = "socket", "rfc2217", "udp"
EXPECTED = "a device path, socket://host:port, rfc2217://host:port or udp://host:port"
LARGEST_PORT = 65_535
NETWORK = re.compile(
    rf"(?P<scheme>{SOCKET}|{RFC2217}|{UDP})://"
    r"(?:(?P<name>[A-Za-z0-9._-]+)|\[(?P<ipv6>[0-9A-Fa-f:.]+(?:%[A-Za-z0-9._-]+)?)\])"
    r":(?P<port>[0-9]{1,5})"
)


@dataclass(frozen=True)
class LineAddress:
    """A checked address. A device path has ``scheme`` and ``host`` "" and ``port`` 0. ``host`` is in lower case."""

    text: str
    scheme: str = ""
    host: str = ""
    port: int = 0

    @property
    def is_device(self) -> bool:
        """True if the address is a device path on this machine."""
        return not self.scheme


def parse_line_address(text: str) -> LineAddress:
    """Check an address. Raises BadInput if it has a user name, path, query, fragment, another scheme or no valid port."""
    if text and "://" not in text and text.isprintable():
        return LineAddress(text)
    match = NETWORK.fullmatch(text)
    if match is None or not 0 < int(match["port"]) <= LARGEST_PORT or not _is_host(match):
        raise BadInput(
            "invalid line address" if text else "no line address given",
            expected=EXPECTED,
            got=ascii(text)[:80] if text else "",
            hint=f"leave out user name, path, query and fragment; ports are 1 – {LARGEST_PORT}",
        )
    return LineAddress(text, match["scheme"], (match["name"] or match["ipv6"]).lower(), int(match["port"]))


def _is_host(match: re.Match[str]) -> bool:
    if match["name"]:
        return True
    try:
        IPv6Address(match["ipv6"])
    except ValueError:
        return False
    return True
