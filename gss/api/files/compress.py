"""Compress long JSON and text responses for clients that accept gzip; all others pass unchanged."""

from __future__ import annotations

import gzip

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MIN_BYTES = 2048
LEVEL = 4
KINDS = ("application/json", "text/html", "text/csv", "text/plain")
NEVER = ("/api/session",)
"""Responses that contain a secret are not compressed, because the compressed length could reveal the secret."""


class Compress:
    """Middleware that compresses responses sent in one part. Streams and files sent in chunks pass unchanged."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        accepts_gzip = scope["type"] == "http" and "gzip" in Headers(scope=scope).get("accept-encoding", "")
        await self._app(
            scope, receive, _CompressingSend(send) if accepts_gzip and not scope["path"].startswith(NEVER) else send
        )


class _CompressingSend:
    def __init__(self, send: Send) -> None:
        self._send = send
        self._start: Message | None = None

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start" and _is_compressible(Headers(raw=message["headers"])):
            self._start = message  # sent after the first part of the body shows whether the body is complete
            return
        if self._start is not None:
            start, self._start = self._start, None
            if not message.get("more_body", False):
                message = self._compressed(start, message)
            await self._send(start)
        await self._send(message)

    def _compressed(self, start: Message, message: Message) -> Message:
        body = gzip.compress(message["body"], LEVEL, mtime=0)
        headers = MutableHeaders(raw=start["headers"])
        headers["Content-Encoding"], headers["Content-Length"] = "gzip", str(len(body))
        headers.add_vary_header("Accept-Encoding")
        start["headers"] = headers.raw
        return {"type": "http.response.body", "body": body}


def _is_compressible(headers: Headers) -> bool:
    length = headers.get("content-length", "")
    return (
        length.isdigit()
        and int(length) >= MIN_BYTES
        and headers.get("content-type", "").startswith(KINDS)
        and "content-encoding" not in headers
    )
