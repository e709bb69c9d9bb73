"""Where the server may listen; asked before anything heavy is loaded."""

from __future__ import annotations

from ipaddress import ip_address

from gss.domain.errors import BadInput


def check_host(host: str) -> str:
    """The address to listen on, if it is a loopback one; sign-in comes before anything else may be allowed."""
    try:
        loopback = host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        loopback = False
    if not loopback:
        raise BadInput(
            "this server has no sign-in yet and listens on loopback only", expected="127.0.0.1 or ::1", got=host
        )
    return host
