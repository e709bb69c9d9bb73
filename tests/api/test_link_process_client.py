"""Client of a link process, with a server on a Unix socket."""

from __future__ import annotations

import asyncio
import gzip
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn

from gss.api.guard.bodies import MAX_OPEN_BODY_BYTES
from gss.api.stream.broadcast import Wire, wire
from gss.api.workers.link_client import LinkProcessClient
from gss.api.workers.private_app import peer_of

pytestmark = pytest.mark.timeout(60)
App = Callable[[Any, Any, Any], Awaitable[None]]


class Caller:
    """ASGI request of a client to the worker. ``pieces`` of the body may be awaitable."""

    def __init__(
        self, method: str, target: str, headers: dict[str, str], pieces: list[bytes | Awaitable[bytes]]
    ) -> None:
        path, _, query = target.partition("?")
        pairs = [(name.encode(), value.encode()) for name, value in headers.items()]
        self.scope = {"type": "http", "method": method, "path": path, "raw_path": path.encode(), "scheme": "https"}
        self.scope |= {"query_string": query.encode(), "headers": pairs, "client": ("192.0.2.7", 4711)}
        self.sent: list[dict[str, Any]] = []
        self.gone = asyncio.Event()
        self._pieces = list(pieces)

    async def receive(self) -> dict[str, Any]:
        if not self._pieces:
            await self.gone.wait()
            return {"type": "http.disconnect"}
        piece = self._pieces.pop(0)
        body = piece if isinstance(piece, bytes) else await piece
        return {"type": "http.request", "body": body, "more_body": bool(self._pieces)}

    async def send(self, message: dict[str, Any]) -> None:
        self.sent.append(message)

    @property
    def body(self) -> bytes:
        return b"".join(m.get("body", b"") for m in self.sent)


@asynccontextmanager
async def link_process(app: App) -> AsyncIterator[LinkProcessClient]:
    """Serve ``app`` on a Unix socket and yield a client of it."""
    with tempfile.TemporaryDirectory(prefix="gss-") as folder:
        path = Path(folder) / "fm1"
        server = uvicorn.Server(uvicorn.Config(app, uds=str(path), lifespan="off", log_level="critical"))
        task = asyncio.create_task(server.serve())
        while not server.started:
            await asyncio.sleep(0.01)
        try:
            yield LinkProcessClient("fm1", path)
        finally:
            server.should_exit = server.force_exit = True
            await task


async def send_response(send: Any, body: bytes, headers: list[tuple[bytes, bytes]], status: int = 200) -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def test_a_request_and_its_response_pass_unchanged():
    """Target, headers, compressed body and status are forwarded unchanged. The real client address replaces a forged
    one.
    """
    compressed, received = gzip.compress(b"pixels" * 100), {}

    async def app(scope: Any, _receive: Any, send: Any) -> None:
        received.update(peer_of(scope))
        await send_response(
            send, compressed, [(b"content-encoding", b"gzip"), (b"content-length", b"%d" % len(compressed))], 206
        )

    async def run() -> Caller:
        headers = {"host": "gss.example", "accept": "x/y", "te": "trailers", "x-gss-peer": "10.9.8.7 1 http"}
        caller = Caller("GET", "/api/a%2Fb%20c?x=%20+1&y=[2]", headers, [b""])
        async with link_process(app) as link:
            await link.forward(caller.scope, caller.receive, caller.send)
        return caller

    caller = asyncio.run(run())
    assert (received["raw_path"], received["query_string"]) == (b"/api/a%2Fb%20c", b"x=%20+1&y=[2]")
    assert (received["client"], received["scheme"]) == (("192.0.2.7", 4711), "https")
    assert set(received["headers"]) == {(b"host", b"gss.example"), (b"accept", b"x/y"), (b"connection", b"close")}
    assert (caller.sent[0]["status"], caller.body) == (206, compressed)
    assert dict(caller.sent[0]["headers"])[b"content-encoding"] == b"gzip"


def test_a_large_body_is_streamed_and_a_small_one_is_read_first():
    """A large body is forwarded in pieces as they arrive. A small body is forwarded when it is complete."""
    arrived: list[bytes] = []

    async def run() -> None:
        first, released = asyncio.Event(), asyncio.Event()

        async def app(_scope: Any, receive: Any, send: Any) -> None:
            more = True
            while more:
                message = await receive()
                arrived.append(message.get("body", b""))
                more = message.get("more_body", False)
                first.set()
            await send_response(send, b"%d" % sum(map(len, arrived)), [])

        async def second(size: int) -> bytes:
            await released.wait()
            return b"2" * size

        async with link_process(app) as link:
            large = MAX_OPEN_BODY_BYTES * 2
            caller = Caller("POST", "/api/x", {"content-length": str(large)}, [b"1" * (large - 5), second(5)])
            forwarding = asyncio.create_task(link.forward(caller.scope, caller.receive, caller.send))
            await first.wait()
            released.set()
            await forwarding
            assert caller.body == b"%d" % large

            first.clear()
            released.clear()
            arrived.clear()
            caller = Caller("POST", "/api/x", {"content-length": "10"}, [b"1" * 5, second(5)])
            forwarding = asyncio.create_task(link.forward(caller.scope, caller.receive, caller.send))
            await asyncio.sleep(0.1)
            assert not first.is_set()
            released.set()
            await forwarding
            assert caller.body == b"10"

    asyncio.run(run())


def test_the_link_process_sees_that_the_client_has_gone():
    """A disconnect before the response is forwarded at once. An incomplete small body is not forwarded."""

    async def run() -> None:
        waiting, ended = asyncio.Event(), asyncio.Event()

        async def app(_scope: Any, receive: Any, _send: Any) -> None:
            waiting.set()
            while (await receive())["type"] != "http.disconnect":
                pass
            ended.set()

        async with link_process(app) as link:
            caller = Caller("GET", "/api/slow", {}, [b""])
            forwarding = asyncio.create_task(link.forward(caller.scope, caller.receive, caller.send))
            await waiting.wait()
            caller.gone.set()
            await forwarding
            await ended.wait()
            assert caller.sent == []

            waiting.clear()
            caller = Caller("POST", "/api/x", {"content-length": "10"}, [])
            caller.gone.set()
            await link.forward(caller.scope, caller.receive, caller.send)
            assert not waiting.is_set()

    asyncio.run(run())


@pytest.mark.parametrize(("method", "hint"), [("GET", "again"), ("POST", "Check before you repeat")])
def test_a_missing_response_is_an_error_with_instructions(method: str, hint: str):
    """A connection that breaks before the response is a 503 with the name of the process; after a change, the message
    asks the user to check first. Without a listening socket, the message asks the user to repeat the request.
    """

    async def cut(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.close()

    async def run() -> tuple[Caller, Caller]:
        broken, unreachable = Caller(method, "/api/x", {}, [b""]), Caller(method, "/api/x", {}, [b""])
        with tempfile.TemporaryDirectory(prefix="gss-") as folder:
            link = LinkProcessClient("fm1", Path(folder) / "fm1")
            await link.forward(unreachable.scope, unreachable.receive, unreachable.send)
            async with await asyncio.start_unix_server(cut, Path(folder) / "fm1"):
                await link.forward(broken.scope, broken.receive, broken.send)
        return broken, unreachable

    broken, unreachable = asyncio.run(run())
    assert (broken.sent[0]["status"], unreachable.sent[0]["status"]) == (503, 503)
    assert b"The link process fm1 did not send a complete response" in broken.body
    assert hint.encode() in broken.body
    assert b"The link process fm1 does not respond" in unreachable.body
    assert b"again in a few seconds" in unreachable.body


def test_the_event_stream_arrives_as_it_was_sent():
    """Messages of the event stream keep their bytes, topics and numbers. Comments are removed."""
    messages = [
        wire("link", {"text": "ä\u2028\n"}, None),
        wire("event", {"seq": 12}, "12", 12),
        wire("dropped", {"dropped": 3}, None),
        wire("telemetry", {"large": "x" * 2_000_000}, "12.7"),
    ]

    async def app(_scope: Any, _receive: Any, send: Any) -> None:
        data = b": comment\n\n".join(message.data for message in messages)
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", b"text/event-stream")]})
        for k in range(0, len(data), 100_001):
            await send({"type": "http.response.body", "body": data[k : k + 100_001], "more_body": True})
        raise asyncio.CancelledError

    received: list[Wire] = []

    async def run() -> None:
        async with link_process(app) as link:
            async for message in link.messages():
                received.append(message)  # noqa: PERF401 - the iteration ends with an error

    with pytest.raises(httpx2.TransportError):
        asyncio.run(run())
    assert received == messages
