"""Event-stream client that checks for consecutive numbers, dropped messages and delay."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from dataclasses import dataclass, field
from datetime import datetime

import httpx2

MAX_EVENT_BYTES = 64 << 20
RECONNECT_S = 0.2


@dataclass
class StreamLog:
    """Statistics of one client. ``late_s``: age of each header bar on reception, in seconds; server and client use the
    same clock."""

    messages: int = 0
    bytes: int = 0
    seq: int = 0
    count: int = 0
    jumps: int = 0
    dropped: int = 0
    ended: int = 0
    late_s: list[float] = field(default_factory=list)
    topics: dict[str, int] = field(default_factory=dict)

    def take(self, topic: str, data: str, number: str) -> None:
        """Record one message."""
        self.messages += 1
        self.bytes += len(data)
        self.topics[topic] = self.topics.get(topic, 0) + 1
        if topic == "dropped":
            self.dropped += int(json.loads(data)["dropped"])
            return  # the message has no number; the parser repeats the number of the previous message
        if topic == "link":
            self.late_s.append(time.time() - datetime.fromisoformat(json.loads(data)["utc"]).timestamp())
        seq, _, count = number.partition(".")
        if topic == "event":
            self.jumps += self.seq > 0 and int(seq) != self.seq + 1
            self.seq = int(seq)
        elif count:
            self.jumps += self.count > 0 and int(count) != self.count + 1
            self.count = int(count)
            self.seq = (
                self.seq or int(seq)
            )  # other messages contain the number of the newest event, from which events that were missed can be detected

    def new_connection(self) -> None:
        """Reset the counter of messages without an event number. Event numbers are kept."""
        self.count = 0


async def listen(host: str, port: int, headers: dict[str, str], log: StreamLog, until_s: float) -> None:
    """Read the stream until ``until_s`` of ``time.monotonic``. Reconnect when it ends, as a browser does."""
    while time.monotonic() < until_s:
        with contextlib.suppress(TimeoutError, httpx2.HTTPError):
            async with asyncio.timeout(max(0.1, until_s - time.monotonic())):
                await _connection(f"http://{host}:{port}/api/stream", headers, log)
        log.ended += time.monotonic() < until_s
        await asyncio.sleep(RECONNECT_S)


async def _connection(url: str, headers: dict[str, str], log: StreamLog) -> None:
    log.new_connection()
    sent = headers | ({"Last-Event-ID": str(log.seq)} if log.seq else {})
    async with (
        httpx2.AsyncClient(timeout=None, trust_env=False) as client,
        client.sse(url, headers=sent, max_event_size=MAX_EVENT_BYTES) as source,
    ):
        source.response.raise_for_status()
        async for event in source:
            log.take(event.event, event.data, event.id)
