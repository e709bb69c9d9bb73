"""The one event stream: recorded events can be resumed after any of them, the rest is the state of the moment."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

from fastapi import APIRouter, Header, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from gss.api import present
from gss.api.deps import App
from gss.operations.events import Message

router = APIRouter(tags=["stream"])
PRESENT: dict[str, Callable[[Any], Any]] = {
    "link": present.link.link,
    "telemetry": present.telemetry.latest,
    "command": present.commands.command,
    "schedule": present.schedule.schedule,
    "stack_run": present.stacks.run,
    "authority": present.authority.authority,
    "transfer": present.records.transfer,
    "frame": lambda frame: present.frames.frame(frame, None),
    "solution": present.frames.solution,
    "job": present.records.job,
    "event": present.records.event,
    "cycle": present.telemetry.cycle,
    "tables": present.tables.on_board,
    "limits": lambda change: change,
    "alarm": present.alarms.alarm,
    "replay": present.contacts.replay,
    "replay.telemetry": present.telemetry.latest,
    "replay.command": present.contacts.replay_command,
    "replay.event": present.contacts.replay_event,
}
BACKFILL = 500
PING_S = 10.0


@router.get("/stream", response_class=EventSourceResponse)
async def stream(
    request: Request, app: App, last_event_id: str | None = Header(default=None)
) -> AsyncIterator[ServerSentEvent]:
    """Everything as it happens. Reconnect with ``Last-Event-ID`` and the recorded events since then come first."""
    loop, ready = asyncio.get_running_loop(), asyncio.Event()
    subscription = app.bus.subscribe(lambda: _wake(loop, ready))
    try:
        seq = int(last_event_id) if last_event_id and last_event_id.isascii() and last_event_id.isdigit() else None
        if seq is not None:
            for row in await asyncio.to_thread(app.bus.after, seq, BACKFILL):
                seq = row.seq
                yield _sse(Message("event", row, row.seq))
        yield ServerSentEvent(data=present.link.link(app.status.header()), event="link")
        while not app.stopping.is_set() and not await request.is_disconnected():
            messages, dropped = subscription.take()
            if dropped:
                yield ServerSentEvent(data={"dropped": dropped}, event="dropped")
            for message in messages:
                if message.seq is None or seq is None or message.seq > seq:
                    yield _sse(message)
            ready.clear()
            try:
                await asyncio.wait_for(ready.wait(), PING_S)
            except TimeoutError:
                yield ServerSentEvent(comment="still here")
    finally:
        app.bus.unsubscribe(subscription)


def _sse(message: Message) -> ServerSentEvent:
    seq = None if message.seq is None else str(message.seq)
    return ServerSentEvent(data=PRESENT[message.topic](message.payload), event=message.topic, id=seq)


def _wake(loop: asyncio.AbstractEventLoop, ready: asyncio.Event) -> None:
    if not loop.is_closed():
        loop.call_soon_threadsafe(ready.set)
