"""Check of the network addresses on which an operator may open a line. Addresses are restricted because the error text of a
failed connection would reveal which ports of another host are open."""

from __future__ import annotations

from ipaddress import ip_address, ip_network

from gss.device.line_address import LineAddress
from gss.domain.errors import NotPermitted


def is_allowed(address: LineAddress, allowed: str) -> bool:
    """True if the address is a device or CAN bus of this host, a port of this host, or a host on the ``allowed`` list (names and
    networks separated by commas). Names are compared as text, because the address that a name resolves to can change."""
    if address.is_local:
        return True
    host = address.host
    entries = [entry.strip().lower() for entry in allowed.split(",") if entry.strip()]
    return host == "localhost" or host in entries or _is_in(host, ["127.0.0.0/8", "::1", *entries])


def _is_in(host: str, networks: list[str]) -> bool:
    try:
        address = ip_address(host)
    except ValueError:
        return False
    for network in networks:
        try:
            if address in ip_network(network, strict=False):
                return True
        except ValueError:
            continue  # the entry is a host name and not a network
    return False


def not_allowed(url: str) -> NotPermitted:
    """Return the error for an address that an operator may not open."""
    return NotPermitted(
        "only an admin may open this address",
        expected="a device or a port of this machine, a host of GSS_LINK_ALLOW, or a line that was open before",
        got=url[:200],
        hint="ask an admin to open it once",
    )
