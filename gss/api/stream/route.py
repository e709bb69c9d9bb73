"""Event stream. A client can resume it after any recorded event. All other messages contain only the current state."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Header, Request, Response
from starlette.types import Receive, Scope, Send

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, identity_still_valid, who_of
from gss.api.errors import problem
from gss.api.stream.broadcast import Broadcaster, Listener, unnumbered, wire
from gss.api.stream.topics import StreamTopics
from gss.domain.errors import RateLimited
from gss.wiring.services import Services

router = api_router("stream")
TOPICS = "Server-sent events. The event name is the topic; the data is the property of StreamTopics with that name."
PAGE = 500
PAGES = 20
PING_S = 10.0
RECHECK_S = 5.0
NUMBER = re.compile(r"(\d{1,18})(\.\d+)?", re.ASCII)
HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store"),
    (b"x-accel-buffering", b"no"),
]
Valid = Callable[[], str]
"""Function that is called repeatedly while a stream is open. Returns "" while the listener is authorized, otherwise the
reason why it is not."""


class EventStream(Response):
    """Streaming response for one listener. ``after``: number after which recorded events are sent first; None: none are
    sent. ``name``: user whose listener limit applies; "": no limit."""

    media_type = "text/event-stream"

    def __init__(
        self,
        services: Services,
        broadcaster: Broadcaster,
        after: int | None = None,
        valid: Valid | None = None,
        name: str = "",
    ) -> None:
        super().__init__()
        self._name = name
        self._services, self._broadcaster, self._seq, self._valid = services, broadcaster, after, valid

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send events until the connection, the session or the server ends."""
        try:
            listener = self._broadcaster.join(self._name)
        except RateLimited as error:
            scope["state"]["detail"] = error.message
            refusal = problem(429, error.message, error.expected, error.got, error.hint, None, error.retry_after_s)
            await refusal(scope, receive, send)
            return
        watch = asyncio.create_task(_close_on_disconnect(receive, listener))
        try:
            await send({"type": "http.response.start", "status": 200, "headers": HEADERS})
            await self._catch_up(send)
            if await self._first(send):
                await self._follow(listener, send)
            await send({"type": "http.response.body", "body": b""})
        except OSError:
            pass  # the client disconnected while a message was being sent
        finally:
            self._broadcaster.leave(listener)
            watch.cancel()

    async def _catch_up(self, send: Send) -> None:
        """Send the recorded events after the last received number, in pages. Events beyond the last page are reported
        as dropped."""
        if self._seq is None:
            return
        for _ in range(PAGES):
            rows = await asyncio.to_thread(self._services.base.bus.after, self._seq, PAGE)
            if not rows:
                await self._restart_after_newest(send)
                return
            self._seq = rows[-1].seq
            await _send(send, b"".join(wire("event", present.records.event(row), str(row.seq)).data for row in rows))
            if len(rows) < PAGE:
                return
        newest = await asyncio.to_thread(self._services.base.bus.newest)
        if newest > self._seq:
            await _send(send, wire("dropped", {"dropped": newest - self._seq}, None).data)
            self._seq = newest

    async def _restart_after_newest(self, send: Send) -> None:
        """If the last received number is above the newest, it is of another database, as after a restore. Report that events
        were dropped, and continue after the newest."""
        newest = await asyncio.to_thread(self._services.base.bus.newest)
        if self._seq is not None and newest < self._seq:
            await _send(send, wire("dropped", {"dropped": self._seq - newest}, None).data)
            self._seq = newest

    async def _first(self, send: Send) -> bool:
        """Send the initial state. Return False if it is unknown, so that the client must reconnect. The initial state
        has no number, because the numbers of later messages do not continue from it."""
        newest = self._broadcaster.newest
        if newest is None and self._broadcaster.state is not None:
            newest = await asyncio.to_thread(self._broadcaster.state)
        if newest is not None:
            await _send(send, unnumbered(newest))
        return newest is not None

    async def _follow(self, listener: Listener, send: Send) -> None:
        loop = asyncio.get_running_loop()
        check_at_s = loop.time()
        ping_at_s = check_at_s + PING_S
        while not listener.closed:
            messages, dropped = listener.take()
            data = [m.data for m in messages if m.seq is None or self._seq is None or m.seq > self._seq]
            if dropped:
                self._broadcaster.counts.dropped += dropped
                data.insert(0, wire("dropped", {"dropped": dropped}, None).data)
            if not data and loop.time() >= ping_at_s:
                data = [b": still here\n\n"]
            if data:
                ping_at_s = loop.time() + PING_S
                await _send(send, b"".join(data))
            if self._valid is not None and loop.time() >= check_at_s:
                check_at_s = loop.time() + RECHECK_S
                reason = await asyncio.to_thread(self._valid)
                if reason:
                    await _send(send, wire("session", {"ended": reason}, None).data)
                    return
            await _wait(listener.ready, min(ping_at_s, check_at_s if self._valid else ping_at_s) - loop.time())


@router.get(
    "/stream",
    response_class=EventStream,
    status_code=200,
    responses={200: {"model": StreamTopics, "description": TOPICS}},
)
async def stream(request: Request, app: App, last_event_id: Annotated[str | None, Header()] = None) -> EventStream:
    """Stream of events and state changes. After a reconnection with ``Last-Event-ID``, the recorded events since that
    id are sent first."""
    caller = who_of(request.scope)
    after, valid = resumed_after(last_event_id or ""), _valid(request, app)
    return EventStream(app, request.app.state.broadcaster, after, valid, caller.name if caller else "")


def resumed_after(number: str) -> int | None:
    """Return the event number in the ``id`` of a message; None if the ``id`` is not valid."""
    number_match = NUMBER.fullmatch(number)
    return int(number_match[1]) if number_match else None


def _valid(request: Request, app: Services) -> Valid | None:
    caller = who_of(request.scope)
    return None if caller is None else lambda: identity_still_valid(app, caller)


async def _send(send: Send, data: bytes) -> None:
    await send({"type": "http.response.body", "body": data, "more_body": True})


async def _wait(ready: asyncio.Event, seconds: float) -> None:
    try:
        async with asyncio.timeout(max(0.0, seconds)):
            await ready.wait()
    except TimeoutError:
        return


async def _close_on_disconnect(receive: Receive, listener: Listener) -> None:
    message: Any = {}
    while message.get("type") != "http.disconnect":
        message = await receive()
    listener.close()
