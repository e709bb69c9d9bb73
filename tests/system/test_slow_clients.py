"""Hundreds of clients without an account that send their requests byte by byte: users, ABORT and the log stay as they are."""

from __future__ import annotations

import asyncio
import contextlib
import resource
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from tools.served import Served, served

pytestmark = pytest.mark.timeout(240)
CLIENTS = 300
HEAD = (
    b"POST /api/session HTTP/1.1\r\nHost: localhost\r\nX-GSS: 1\r\n"
    b"Content-Type: application/json\r\nContent-Length: 60000\r\n\r\n"
)
DESCRIPTORS = 256
"""Fewer than there are slow clients."""
ANSWER_S = 3.0
"""Far more than ABORT takes on an idle machine, far less than a client has to wait that is not let in."""
LOG_BYTES = 64 << 10


class SlowClients:
    """Clients on loopback that drip a byte a second into POST /api/session and connect again whenever they are dropped."""

    def __init__(self, host: str, port: int, count: int) -> None:
        self._address, self._count = (host, port), count
        self.connected = 0
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._run(),), name="slow clients")

    def __enter__(self) -> SlowClients:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30)
        self._loop.close()

    async def _run(self) -> None:
        self._stop = asyncio.Event()
        tasks = [self._loop.create_task(self._drip(number)) for number in range(self._count)]
        await self._stop.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _drip(self, number: int) -> None:
        await asyncio.sleep(number / self._count)
        while True:
            with contextlib.suppress(OSError):
                _, writer = await asyncio.open_connection(*self._address)
                self.connected += 1
                try:
                    writer.write(HEAD)
                    while not writer.is_closing():
                        writer.write(b" ")
                        await writer.drain()
                        await asyncio.sleep(1)
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.5)


@pytest.fixture(params=[(), ("--workers", "2")], ids=["one process", "two workers"])
def server(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Served]:
    """A server whose processes may open few files."""
    with served(tmp_path / "data", *request.param, GSS_CONNECTIONS_MOST="180") as server:
        wait_until_answering(server, workers=bool(request.param))
        for pid in server.processes().values():
            resource.prlimit(pid, resource.RLIMIT_NOFILE, (DESCRIPTORS, DESCRIPTORS))
        yield server


def wait_until_answering(server: Served, *, workers: bool) -> None:
    """Until ABORT is answered, by a worker where there are any."""
    limit_s = time.monotonic() + 120
    while time.monotonic() < limit_s:
        with contextlib.suppress(httpx2.TransportError):
            abort_s(server)
            if not workers or server.listeners() == 1:
                return
        time.sleep(0.2)
    pytest.fail("the server does not answer")


def abort_s(server: Served) -> float:
    """Seconds until ABORT on a new connection is answered; there is no line, so that the answer is 409."""
    begun_s = time.monotonic()
    reply = httpx2.post(f"{server.address}/api/commands/abort", headers=server.headers, timeout=30)
    assert (reply.status_code, reply.json()["message"]) == (409, "ABORT was not sent: the line is down.")
    return time.monotonic() - begun_s


def test_slow_clients_block_neither_abort_nor_users_nor_fill_the_log(server: Served) -> None:
    """ABORT on a new connection is answered, an open event stream stays open, and the log stays short."""
    with socket.create_connection(server.host_and_port, timeout=30) as stream:
        key = server.headers["Authorization"]
        stream.sendall(f"GET /api/stream HTTP/1.1\r\nHost: localhost\r\nAuthorization: {key}\r\n\r\n".encode())
        assert stream.recv(4096).startswith(b"HTTP/1.1 200")
        with SlowClients(*server.host_and_port, CLIENTS) as slow:
            limit_s = time.monotonic() + 60
            while slow.connected < CLIENTS and time.monotonic() < limit_s:
                time.sleep(0.1)
            waits_s = []
            for _ in range(8):
                waits_s.append(abort_s(server))
                time.sleep(1)
        assert max(waits_s) < ANSWER_S, waits_s
        stream.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while stream.recv(65536):
                pass
        stream.settimeout(30)
        assert stream.recv(65536), "the event stream was dropped"
    log = (server.folder.parent / f"{server.folder.name}.log").stat().st_size
    assert log < LOG_BYTES, f"{log} bytes of log"
