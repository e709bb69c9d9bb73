"""Check the origin of a request against the server's host names, the trusted proxies and the allowed page origins."""

from __future__ import annotations

from dataclasses import dataclass
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from typing import Protocol
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

from gss.domain.errors import BadInput

LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")
PLAIN = "-"
"""Placeholder for an unknown address."""


class Exposure(Protocol):
    """Settings that determine how the server is exposed."""

    host: str
    tls_certificate: str
    tls_key: str
    behind_proxy: bool
    trusted_proxies: str
    public_names: str


@dataclass(frozen=True)
class Caller:
    """Client of a request, not the proxy in front of the server. ``authority``: host and port as in the browser's
    address bar."""

    address: str
    authority: str
    secure: bool


@dataclass(frozen=True)
class Refusal:
    """Reason for rejecting a request."""

    message: str
    expected: str = ""
    got: str = ""


class Perimeter:
    """Checks the origin of requests. Created once from the settings; the guard calls it for every request."""

    def __init__(self, settings: Exposure) -> None:
        self.tls = bool(settings.tls_certificate)
        self.behind_proxy = settings.behind_proxy
        self.secure = self.tls or self.behind_proxy
        self._proxies = networks(settings.trusted_proxies) if settings.behind_proxy else ()
        self.names = frozenset((*LOCAL_NAMES, *public_names(settings)))

    def caller(self, scope: Scope, headers: Headers) -> Caller | Refusal:
        """Return the client, or a refusal if a request bypasses the required proxy. X-Forwarded-* headers from other
        peers are ignored."""
        client = scope.get("client")
        peer = str(client[0]) if client else PLAIN
        if not self.behind_proxy:
            return Caller(peer, headers.get("host", ""), self.tls)
        if not self._is_proxy(peer):
            return Refusal("direct requests are rejected; use the proxy", "an address of the proxy", peer)
        if _last(headers, "x-forwarded-proto") != "https":
            return Refusal("the proxy reports no HTTPS connection", "X-Forwarded-Proto: https")
        host = _last(headers, "x-forwarded-host") or headers.get("host", "")
        return Caller(self._behind(",".join(headers.getlist("x-forwarded-for")), peer), host, True)

    def refusal(self, caller: Caller, headers: Headers, *, data: bool) -> Refusal | None:
        """Return a refusal for a foreign host name (DNS rebinding) or a foreign origin, else None. ``data``: the path
        is API data, not a page file."""
        if host_name(caller.authority) not in self.names:
            names = "localhost, 127.0.0.1, ::1 or one of GSS_PUBLIC_NAMES"
            return Refusal("unknown host name", names, host_name(caller.authority))
        origin = headers.get("origin")
        own_origin = f"{'https' if caller.secure else 'http'}://{caller.authority}"
        if origin is not None and origin.lower() != own_origin.lower():
            return Refusal("cross-origin request rejected", own_origin, origin)
        site = headers.get("sec-fetch-site", "none")
        if data and site not in ("same-origin", "none"):
            return Refusal("cross-origin request rejected", own_origin, f"Sec-Fetch-Site: {site}")
        return None

    def _is_proxy(self, address: str) -> bool:
        try:
            return any(ip_address(address) in network for network in self._proxies)
        except ValueError:
            return False

    def _behind(self, forwarded: str, peer: str) -> str:
        """Return the last address of the list that is not a trusted proxy, because clients can forge earlier
        entries."""
        for address in reversed([part.strip() for part in forwarded.split(",") if part.strip()]):
            if not self._is_proxy(address):
                try:
                    return str(ip_address(address))
                except ValueError:
                    return PLAIN
        return peer


def _last(headers: Headers, name: str) -> str:
    """Return the last value in the last line of a header. The nearest proxy wrote it."""
    return ",".join(headers.getlist(name)).split(",")[-1].strip()


def host_name(authority: str) -> str:
    """Return the host of ``host`` or ``host:port``; "" if the text is not valid or contains anything else, such as a path."""
    try:
        parts = urlsplit(f"//{authority}")
        host = parts.hostname if parts.port != 0 else None
    except ValueError:
        return ""
    return (host or "").lower() if parts.netloc == authority and "@" not in authority else ""


def public_names(settings: Exposure) -> list[str]:
    """Return the non-local host names under which browsers can reach this server."""
    names = [name.strip().lower() for name in settings.public_names.split(",") if name.strip()]
    return [*names, settings.host.lower()] if settings.tls_certificate and not is_loopback(settings.host) else names


def networks(text: str) -> tuple[IPv4Network | IPv6Network, ...]:
    """Parse a comma-separated list of addresses and networks. BadInput if one is not valid."""
    try:
        return tuple(ip_network(part.strip(), strict=False) for part in text.split(",") if part.strip())
    except ValueError as error:
        raise BadInput(
            "invalid list of proxies", expected="addresses or networks, for example 10.0.0.0/8", got=str(error)
        ) from None


def is_loopback(host: str) -> bool:
    """True if the host is reachable from this machine only."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def check_exposure(settings: Exposure) -> None:
    """Check that a non-loopback address has TLS or a proxy, and that a server behind a proxy has a public name. Raises
    BadInput otherwise."""
    if bool(settings.tls_certificate) != bool(settings.tls_key):
        raise BadInput(
            "TLS needs a certificate and a key", expected="GSS_TLS_CERTIFICATE and GSS_TLS_KEY", got="one of them"
        )
    if settings.behind_proxy and not (settings.public_names.strip() and networks(settings.trusted_proxies)):
        raise BadInput(
            "a server behind a proxy needs its public names", expected="GSS_PUBLIC_NAMES and GSS_TRUSTED_PROXIES"
        )
    if is_loopback(settings.host) or settings.tls_certificate or settings.behind_proxy:
        return
    raise BadInput(
        "without TLS this server listens on loopback only",
        expected="127.0.0.1 or ::1, or GSS_TLS_CERTIFICATE and GSS_TLS_KEY, or GSS_BEHIND_PROXY=true",
        got=settings.host,
    )
