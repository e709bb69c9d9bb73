"""Timeouts of incomplete requests over real sockets; streams and authenticated bodies have no time limit."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
import uvicorn
from uvicorn.server import ServerState

from gss.api.connections.admission import ConnectionLimits, Connections
from gss.api.connections.timed_http import HttpTimeouts
from gss.api.serving import uvicorn_options
from gss.settings import Settings

TIMEOUTS = HttpTimeouts(head_s=0.3, open_body_s=0.6, body_pause_s=0.5, check_every_s=0.05)
"""Short timeouts for the tests: tenths of a second instead of tens of seconds."""
Reader, Writer = asyncio.StreamReader, asyncio.StreamWriter


async def application(scope: Any, receive: Any, send: Any) -> None:
    """Read the body, then answer. /stream sends for longer than every time limit, /signed-in authenticates the
    connection, and /begun starts its response before the body is read.
    """
    if scope["path"] == "/signed-in":
        scope["state"]["connection"].mark_authenticated()
    if scope["path"] == "/begun":
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"3")]})
    more = True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            return
        more = message["more_body"]
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"3")]})
    for _ in range(3):
        if scope["path"] == "/stream":
            await asyncio.sleep(TIMEOUTS.head_s + TIMEOUTS.body_pause_s)
        await send({"type": "http.response.body", "body": b".", "more_body": True})
    await send({"type": "http.response.body", "body": b""})


def with_server(visit: Callable[[Callable[[], Awaitable[tuple[Reader, Writer]]]], Awaitable[None]]) -> None:
    """Run ``visit`` with a function that connects to a server with these timeouts."""

    async def run() -> None:
        options = uvicorn_options(Settings(), Connections(ConnectionLimits(9, 9, 9)), TIMEOUTS)
        config = uvicorn.Config(application, lifespan="off", log_config=None, **options)
        config.load()
        state = ServerState()
        server = await asyncio.get_running_loop().create_server(
            lambda: config.http_protocol_class(config=config, server_state=state, app_state={}), "127.0.0.1", 0
        )
        port = server.sockets[0].getsockname()[1]
        async with asyncio.timeout(20), server:
            await visit(lambda: asyncio.open_connection("127.0.0.1", port))

    asyncio.run(run())


@pytest.mark.parametrize(
    "begin",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nX: ",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 60000\r\n\r\n{",
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\nGET / HTTP/1.1\r\nX: ",
    ],
)
def test_an_incomplete_request_loses_its_connection(begin: bytes) -> None:
    """The server closes a connection without a request, with an incomplete head, or with an incomplete body."""

    async def visit(connect: Callable[[], Awaitable[tuple[Reader, Writer]]]) -> None:
        reader, writer = await connect()
        writer.write(begin)
        received = b"".join([piece async for piece in pieces(reader)])
        assert received.count(b"200 OK") == begin.count(b"\r\n\r\nGET")
        writer.close()

    with_server(visit)


def test_a_head_must_be_complete_in_time_despite_single_bytes() -> None:
    """The server closes a connection whose head is incomplete after the time limit, although bytes still arrive."""

    async def visit(connect: Callable[[], Awaitable[tuple[Reader, Writer]]]) -> None:
        reader, writer = await connect()
        writer.write(b"GET / HTTP/1.1\r\nX: ")
        with contextlib.suppress(ConnectionError):
            while not reader.at_eof():
                writer.write(b"x")
                await writer.drain()
                await asyncio.sleep(0.02)
        writer.close()

    with_server(visit)


def test_streams_and_slow_authenticated_bodies_have_no_time_limit() -> None:
    """A response that takes longer than every limit is completed, and so is a slow body of an authenticated user."""

    async def visit(connect: Callable[[], Awaitable[tuple[Reader, Writer]]]) -> None:
        reader, writer = await connect()
        writer.write(b"GET /stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert (await reader.readuntil(b"...")).startswith(b"HTTP/1.1 200")
        writer.write(b"POST /signed-in HTTP/1.1\r\nHost: localhost\r\nContent-Length: 12\r\n\r\n")
        for _ in range(12):
            await asyncio.sleep(0.04)
            writer.write(b"x")
        assert (await reader.readuntil(b"...")).startswith(b"HTTP/1.1 200")
        writer.close()

    with_server(visit)


@pytest.mark.parametrize("path", ["/signed-in", "/api/session"])
def test_an_unauthenticated_body_has_a_total_time(path: str) -> None:
    """A slow body keeps an authenticated connection open, but not on a route without sign-in."""

    async def visit(connect: Callable[[], Awaitable[tuple[Reader, Writer]]]) -> None:
        reader, writer = await connect()
        writer.write(f"POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 600\r\n\r\n".encode())
        drips = 0
        with contextlib.suppress(ConnectionError):
            while not reader.at_eof() and drips < 40:
                writer.write(b" ")
                await writer.drain()
                await asyncio.sleep(0.03)
                drips += 1
        assert (drips == 40) is (path == "/signed-in")
        writer.close()

    with_server(visit)


async def pieces(reader: Reader) -> Any:
    """Yield received data until the peer closes or resets the connection."""
    try:
        while piece := await reader.read(4096):
            yield piece
    except ConnectionError:
        return


@pytest.mark.parametrize("path", ["/body", "/begun"])
def test_invalid_bytes_in_a_body_end_the_connection_without_a_traceback(
    caplog: pytest.LogCaptureFixture, path: str
) -> None:
    """Invalid bytes end the connection without a traceback, before the response has begun with a 400."""
    responses: list[bytes] = []

    async def visit(connect: Callable[[], Awaitable[tuple[Reader, Writer]]]) -> None:
        reader, writer = await connect()
        head = f"POST {path} HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n\r\n"
        writer.write(head.encode() + b"1\r\na\r\n")
        if path == "/begun":
            responses.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(b"-1\r\n")
        responses.append(await reader.read())
        writer.close()

    with_server(visit)
    assert b"".join(responses).count(b"HTTP/1.1 ") == 1
    assert (b"400 Bad Request" in responses[0]) == (path == "/body")
    assert "Traceback" not in caplog.text
