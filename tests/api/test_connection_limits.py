"""Limits of connections over real sockets: which connections the server closes, and what it logs."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import resource
import socket
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from fastapi.testclient import TestClient
from uvicorn.server import ServerState

from gss.api.connections.admission import ConnectionLimits, Connections, origin_of
from gss.api.connections.limited_listener import LimitedListener
from gss.api.connections.log_throttle import PER_MINUTE, WINDOW_S, LogThrottle
from gss.api.serving import uvicorn_options
from gss.settings import Settings

Peer = tuple[asyncio.StreamReader, asyncio.StreamWriter]
Connect = Callable[..., Awaitable[Peer]]
LIMITS = ConnectionLimits(authenticated=2, unauthenticated=3, per_address=2)
RELEASED = threading.Event()
SLOW = b"POST /slow HTTP/1.1\r\nHost: localhost\r\nContent-Length: 9\r\n\r\n "


async def application(scope: Any, receive: Any, send: Any) -> None:
    """Answer a request when its body is complete.

    Paths below /user authenticate the connection. /user/stream does not end; /user/held ends when ``RELEASED`` is set.
    """
    if scope["path"].startswith("/user"):
        scope["state"]["connection"].mark_authenticated()
    while (await receive())["more_body"]:
        pass
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"a", "more_body": True})
    while scope["path"] == "/user/held" and not RELEASED.is_set():
        await asyncio.sleep(0.01)
    if scope["path"] != "/user/stream":
        await send({"type": "http.response.body", "body": b"b"})
    else:
        await receive()


def with_server(visit: Callable[[Connect, Connections], Awaitable[None]], **settings: str) -> None:
    """Run ``visit`` with a server that has the low connection limits ``LIMITS``. ``visit`` can connect from any loopback
    address."""

    async def run() -> None:
        connections = Connections(LIMITS)
        options = uvicorn_options(Settings(**settings), connections)
        config = uvicorn.Config(application, lifespan="off", log_config=None, **options)
        config.load()
        listener = socket.create_server(("127.0.0.1", 0))
        port, state = listener.getsockname()[1], ServerState()
        server = await asyncio.get_running_loop().create_server(
            lambda: config.http_protocol_class(config=config, server_state=state, app_state={}),
            sock=LimitedListener(connections, listener.detach()),
            ssl=config.ssl,
        )
        peers: list[Peer] = []

        async def connect(begin: bytes = b"", address: str = "127.0.0.1") -> Peer:
            peers.append(await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0)))
            peers[-1][1].write(begin)
            await asyncio.sleep(0.05)
            return peers[-1]

        async with asyncio.timeout(30):
            await visit(connect, connections)
        for _, writer in peers:
            writer.transport.abort()
        server.close()
        for protocol in list(state.connections):
            protocol.transport.abort()
        await asyncio.sleep(0.05)

    asyncio.run(run())


async def is_open(peer: Peer) -> bool:
    """True if the server has not closed the connection."""
    with contextlib.suppress(ConnectionError):
        try:
            async with asyncio.timeout(0.1):
                return bool(await peer[0].read(4096))
        except TimeoutError:
            return True
    return False


def request(path: str) -> bytes:
    """Return a complete request."""
    return f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()


def test_the_oldest_unauthenticated_connection_of_an_address_is_dropped() -> None:
    """The server drops the oldest connection, even with a request begun, and answers the new one. Other addresses are
    not affected.
    """

    async def visit(connect: Connect, connections: Connections) -> None:
        other = await connect(b"", "127.0.0.9")
        first, second, third = await connect(SLOW), await connect(SLOW), await connect(SLOW)
        assert [await is_open(peer) for peer in (other, first, second, third)] == [True, False, True, True]
        new = await connect(request("/"))
        assert (await new[0].readuntil(b"ab")).startswith(b"HTTP/1.1 200")
        assert not await is_open(second)
        assert connections.unauthenticated <= LIMITS.unauthenticated

    with_server(visit)


def test_over_the_total_the_address_with_the_most_connections_loses_its_oldest() -> None:
    """Over the total limit, the server drops the oldest connection of the address with the most connections."""

    async def visit(connect: Connect, _connections: Connections) -> None:
        calm = await connect(SLOW, "127.0.0.9")
        first, second = await connect(SLOW), await connect(SLOW)
        await connect(SLOW, "127.0.0.7")
        assert [await is_open(peer) for peer in (calm, first, second)] == [True, False, True]

    with_server(visit)


def test_an_authenticated_connection_is_not_dropped_for_others() -> None:
    """Neither an open stream nor an idle connection of a user is dropped when many unknown clients connect."""

    async def visit(connect: Connect, connections: Connections) -> None:
        stream, idle = await connect(request("/user/stream")), await connect(request("/user"))
        for _ in range(20):
            await connect(SLOW)
        assert (await stream[0].read(4096)).endswith(b"a")
        idle[1].write(request("/user"))
        assert (await idle[0].readuntil(b"ab")).startswith(b"HTTP/1.1 200")
        assert await is_open(stream)
        assert connections.unauthenticated == LIMITS.per_address

    with_server(visit)


def test_users_over_their_limit_lose_idle_connections_only() -> None:
    """Over the limit for authenticated connections, an idle one is dropped. One with a response in progress stays."""

    async def visit(connect: Connect, _connections: Connections) -> None:
        stream, idle = await connect(request("/user/stream")), await connect(request("/user"))
        for peer in (stream, idle):
            await peer[0].readuntil(b"a")
        await idle[0].readuntil(b"b")
        for _ in range(3):
            await connect(request("/user/stream"))
        assert [await is_open(peer) for peer in (stream, idle)] == [True, False]

    with_server(visit)


def test_unauthenticated_connections_drop_no_user_over_the_limit() -> None:
    """Three authenticated connections exceed the limit of two, because none was idle when the third one began. New
    unauthenticated connections do not drop them, even after they have become idle.
    """

    async def visit(connect: Connect, _connections: Connections) -> None:
        users = [await connect(request("/user/held")) for _ in range(3)]
        for peer in users:
            await peer[0].readuntil(b"a")
        RELEASED.set()
        for peer in users:
            await peer[0].readuntil(b"b")
        for address in ("127.0.0.7", "127.0.0.8", "127.0.0.9"):
            await connect(SLOW, address)
        assert [await is_open(peer) for peer in users] == [True, True, True]

    try:
        with_server(visit)
    finally:
        RELEASED.clear()


def test_a_user_over_the_limit_displaces_an_idle_connection_of_the_same_address_first() -> None:
    """An older idle connection of another address is dropped only if the same address has no idle connection."""

    async def visit(connect: Connect, _connections: Connections) -> None:
        other, same = await connect(request("/user"), "127.0.0.9"), await connect(request("/user"))
        for peer in (other, same):
            await peer[0].readuntil(b"b")
        first = await connect(request("/user/stream"))
        assert [await is_open(peer) for peer in (other, same, first)] == [True, False, True]
        second = await connect(request("/user/stream"))
        assert [await is_open(peer) for peer in (other, second)] == [False, True]

    with_server(visit)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """TLS settings with a self-signed certificate."""
    folder: Path = tmp_path_factory.mktemp("tls")
    key, chain = str(folder / "key.pem"), str(folder / "chain.pem")
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    subprocess.run([*command, "-keyout", key, "-out", chain], check=True, capture_output=True)
    return {"tls_certificate": chain, "tls_key": key}


def test_an_incomplete_handshake_is_dropped_too(certificate: dict[str, str]) -> None:
    """A connection without a complete TLS handshake counts, because it uses a descriptor."""

    async def visit(connect: Connect, connections: Connections) -> None:
        first, second, third = await connect(), await connect(), await connect()
        assert [await is_open(peer) for peer in (first, second, third)] == [False, True, True]
        assert connections.unauthenticated == 2

    with_server(visit, **certificate)


def test_a_failed_handshake_frees_its_place(certificate: dict[str, str], caplog: pytest.LogCaptureFixture) -> None:
    """A connection does not count after its TLS handshake has failed, so the next connection displaces no other."""

    async def visit(connect: Connect, connections: Connections) -> None:
        for address in ("127.0.0.7", "127.0.0.8", "127.0.0.9"):
            peer = await connect(b"no TLS record, closed by the server\r\n\r\n", address)
            assert not await is_open(peer)
            assert not await is_open(peer)
        waiting = await connect()
        assert connections.unauthenticated == 1
        assert await is_open(waiting)

    with_server(visit, **certificate)
    assert not [text for text in caplog.messages if "Connection limit" in text]


def test_without_descriptors_an_unauthenticated_connection_is_dropped(caplog: pytest.LogCaptureFixture) -> None:
    """Without free descriptors, the server drops an unauthenticated connection, answers the new client and logs the
    error.
    """

    async def visit(connect: Connect, connections: Connections) -> None:
        slow = await connect(SLOW)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        client = socket.socket()
        highest = max(int(name) for name in os.listdir("/proc/self/fd"))
        fillers = [os.open(os.devnull, os.O_RDONLY) for _ in range(highest + 1 - len(os.listdir("/proc/self/fd")))]
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(fillers, default=highest) + 1, hard))
        try:
            with contextlib.suppress(OSError):
                while True:
                    fillers.append(os.dup(0))
            client.setblocking(False)
            await asyncio.get_running_loop().sock_connect(client, slow[1].get_extra_info("peername"))
            client.send(request("/"))
            assert (await asyncio.get_running_loop().sock_recv(client, 4096)).startswith(b"HTTP/1.1 200")
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            for number in fillers:
                os.close(number)
            client.close()
        assert not await is_open(slow)

    with_server(visit)
    assert f"Cannot accept a connection: {os.strerror(errno.EMFILE)}" in caplog.messages


def test_limits_follow_the_setting_and_the_limit_of_open_files() -> None:
    """Connections use at most half of the descriptors. Behind a proxy, one address may have all unauthenticated
    connections."""
    assert ConnectionLimits.within(800, 20_000, behind_proxy=False) == ConnectionLimits(400, 400, 200)
    assert ConnectionLimits.within(800, 256, behind_proxy=False) == ConnectionLimits(64, 64, 32)
    assert ConnectionLimits.within(800, 20_000, behind_proxy=True).per_address == 400


WITH_ALL_DESCRIPTORS = """
import os, resource, socket, threading, time
from gss.api.connections.limited_listener import raise_descriptor_limit
from gss.device.transport import open_stream
soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (min(512, hard), hard))
listener = socket.create_server(("127.0.0.1", 0))
def talk():
    peer = listener.accept()[0]
    while True:
        peer.sendall(b"x")
        time.sleep(0.05)
threading.Thread(target=talk, daemon=True).start()
assert raise_descriptor_limit() == resource.getrlimit(resource.RLIMIT_NOFILE)[0]
used = []
try:
    while len(used) < 2000:
        used.append(os.open(os.devnull, os.O_RDONLY))
except OSError:
    for number in used[-10:]:
        os.close(number)
stream = open_stream(f"socket://127.0.0.1:{listener.getsockname()[1]}")
print(len(used), stream.read(1, 5.0).decode())
"""


def test_a_link_opens_with_nearly_all_descriptors_in_use() -> None:
    """A link opens although nearly all descriptors are in use. pyserial uses select(), which accepts only descriptors
    below 1024, so the limit of open files must not be higher."""
    command = [sys.executable, "-c", WITH_ALL_DESCRIPTORS]
    completed = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert completed.stdout.endswith(" x\n"), completed.stderr
    assert 900 < int(completed.stdout.split()[0]) < 1024


@pytest.mark.parametrize(
    ("address", "origin"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("", "-"),
    ],
)
def test_an_ipv6_network_counts_as_one_client(address: str, origin: str) -> None:
    """All addresses of an IPv6 network count as one client, because one client can use all of them."""
    assert origin_of(address) == origin


@pytest.fixture
def throttled() -> Iterator[tuple[logging.Logger, list[str], list[float]]]:
    """Logger with the throttle, its logged lines, and a clock that the test sets."""
    clock, lines, log = [0.0], [], logging.getLogger("tests.throttled")

    class ListHandler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            lines.append(record.getMessage())

    throttle, handler = LogThrottle(lambda: clock[0]), ListHandler()
    log.addFilter(throttle)
    log.addHandler(handler)
    yield log, lines, clock
    log.removeFilter(throttle)
    log.removeHandler(handler)


def test_similar_messages_are_counted_and_not_logged(throttled: tuple[logging.Logger, list[str], list[float]]) -> None:
    """A few similar messages per minute are logged, then the number of omitted ones. Other messages are still
    logged.
    """
    log, lines, clock = throttled
    for number in range(1000):
        log.warning("dropped %s", number)
    log.warning("something else")
    assert len(lines) == PER_MINUTE + 1
    clock[0] = WINDOW_S
    log.warning("dropped %s", "again")
    assert lines[-1] == f"dropped again ({1000 - PER_MINUTE} similar messages were omitted)"


def test_failed_unauthenticated_requests_do_not_fill_the_audit_log(client: TestClient) -> None:
    """A hundred invalid sign-in requests add one audit row."""
    stranger = TestClient(client.app, base_url="http://localhost", headers={"X-GSS": "1"})
    before = client.get("/api/audit").json()
    assert {stranger.post("/api/session", json={"wrong": number}).status_code for number in range(100)} == {422}
    rows = [row for row in client.get("/api/audit").json() if row not in before]
    assert [row["action"] for row in rows].count("session.sign_in") == 1
