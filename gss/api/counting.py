"""Counts requests by kind of route and answer, and how long they took. Plain ASGI: a stream costs nothing more."""

from __future__ import annotations

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gss.operations.upkeep.metrics import Metrics

KINDS = frozenset(
    """
    admin alarms analyses audit authority calibrations campaigns catalogues commands contacts design events frames health
    jobs limits link openapi.json profiles rerun schedule session sessions setup sky solutions stacks stream tables
    telemetry tokens transfers users
    """.split()  # noqa: SIM905 - a list would be thirty lines
)


class Counting:
    """Middleware."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app, self._metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        kind, status, begun_s = kind_of(scope["path"]), 500, time.perf_counter()

        async def told(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                if kind != "stream":  # until the answer begins: a stream never ends, and a slow reader is not our time
                    taken_s = time.perf_counter() - begun_s
                    self._metrics.observe("gss_http_seconds", "Time to the answer's first byte.", taken_s, route=kind)
            await send(message)

        try:
            await self._app(scope, receive, told)
        finally:
            code = f"{status // 100}xx"
            self._metrics.count("gss_http_requests_total", "Answered requests.", route=kind, status=code)


def kind_of(path: str) -> str:
    """Few values: what anybody may ask for must not grow the figures."""
    parts = path.split("/", 3)
    if parts[1:2] != ["api"]:
        return "metrics" if path == "/metrics" else "pages"
    return parts[2] if len(parts) > 2 and parts[2] in KINDS else "other"
