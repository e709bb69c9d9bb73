"""Security headers of every response: no foreign content, framing or MIME sniffing."""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.types import Message, Send

POLICY = (
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; worker-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'self'; frame-ancestors 'self'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "SAMEORIGIN",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=()",
}
STRICT_TRANSPORT = ("Strict-Transport-Security", "max-age=31536000")
"""Header that is sent only with TLS. A browser that has received it uses only HTTPS for this host."""


class HeaderWriter:
    """ASGI send function that adds the security headers to a response and records its status."""

    def __init__(self, send: Send, secure: bool, *, private: bool) -> None:
        self._send, self._secure, self._private = send, secure, private
        self.status = 0

    async def __call__(self, message: Message) -> None:
        """Forward one ASGI message."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            if self._secure:
                headers.setdefault(*STRICT_TRANSPORT)
            if self._private:
                headers.setdefault("Cache-Control", "no-store")
        await self._send(message)
