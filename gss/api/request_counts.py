"""Count requests by route kind and status class, and measure the time to the first byte. The middleware is plain ASGI,
so it does not slow down streams."""

from __future__ import annotations

import time

from fastapi import FastAPI
from fastapi.routing import iter_route_contexts
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gss.operations.metrics import Metrics


def kinds_of(app: FastAPI) -> frozenset[str]:
    """Return the first path segments below /api. The set is fixed so that unknown paths cannot add label values to the
    metrics."""
    paths = ((context.path or "").split("/") for context in iter_route_contexts(app.routes))
    return frozenset(parts[2] for parts in paths if parts[1:2] == ["api"])


class Counting:
    """Middleware that counts requests. ``kinds``: known route kinds; all others are counted as "other"."""

    def __init__(self, app: ASGIApp, metrics: Metrics, kinds: frozenset[str]) -> None:
        self._app, self._metrics, self._kinds = app, metrics, kinds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        kind, status, begun_s = self._kind(scope["path"]), 500, time.perf_counter()

        async def timed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                if kind != "stream":  # streams are not measured, because they do not end
                    elapsed_s = time.perf_counter() - begun_s
                    self._metrics.observe_response(kind, elapsed_s)
            await send(message)

        try:
            await self._app(scope, receive, timed)
        finally:
            self._metrics.count_request(kind, f"{status // 100}xx")

    def _kind(self, path: str) -> str:
        parts = path.split("/", 3)
        if parts[1:2] != ["api"]:
            return "metrics" if path == "/metrics" else "pages"
        return parts[2] if len(parts) > 2 and parts[2] in self._kinds else "other"
