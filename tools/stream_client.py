"""Event-stream client that checks what it receives: consecutive numbers, no dropped messages, delay."""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import dataclass, field
from datetime import datetime

LIMIT = 64 << 20


@dataclass
class Heard:
    """Statistics of one client. ``late_s``: of each header bar, from the server's clock to ours (the same machine)."""

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
        self.topics[topic] = self.topics.get(topic, 0) + 1
        if topic == "dropped":
            self.dropped += int(json.loads(data)["dropped"])
        if topic == "link":
            self.late_s.append(time.time() - datetime.fromisoformat(json.loads(data)["utc"]).timestamp())
        seq, _, count = number.partition(".")
        if topic == "event":
            self.jumps += self.seq > 0 and int(seq) != self.seq + 1
            self.seq = int(seq)
        elif count:
            self.jumps += self.count > 0 and int(count) != self.count + 1
            self.count = int(count)
            self.seq = self.seq or int(
                seq
            )  # a state carries the newest event's number too, so that events missed after it are detected

    def new_connection(self) -> None:
        """Reset the count of states; event numbers continue."""
        self.count = 0


async def listen(host: str, port: int, headers: dict[str, str], heard: Heard, until_s: float) -> None:
    """Follow the stream until a time of ``time.monotonic``; reconnect when it ends, as a browser does."""
    while time.monotonic() < until_s:
        try:
            await _connection(host, port, headers, heard, until_s)
        except (OSError, asyncio.IncompleteReadError):
            await asyncio.sleep(0.2)
        heard.ended += time.monotonic() < until_s


async def _connection(host: str, port: int, headers: dict[str, str], heard: Heard, until_s: float) -> None:
    reader, writer = await asyncio.open_connection(host, port, limit=LIMIT)
    heard.new_connection()
    sent = {"Host": f"{host}:{port}", **headers} | ({"Last-Event-ID": str(heard.seq)} if heard.seq else {})
    # HTTP/1.0 has no chunked encoding: the response is read as sent until the connection closes.
    head = "".join(f"{name}: {value}\r\n" for name, value in sent.items())
    writer.write(f"GET /api/stream HTTP/1.0\r\n{head}\r\n".encode())
    try:
        async with asyncio.timeout(max(0.1, until_s - time.monotonic())):
            status = await reader.readuntil(b"\r\n\r\n")
            if b" 200 " not in status.split(b"\r\n", 1)[0]:
                raise ConnectionError(status.split(b"\r\n", 1)[0].decode())
            while True:
                block = await reader.readuntil(b"\n\n")
                heard.bytes += len(block)
                fields = dict(
                    line.partition(": ")[::2] for line in block.decode().splitlines() if not line.startswith(":")
                )
                if fields:
                    heard.take(fields["event"], fields["data"], fields.get("id", ""))
    except TimeoutError:
        return
    finally:
        writer.close()
