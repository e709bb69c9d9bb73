"""Compare two transports between an API worker and the link process: HTTP over a Unix socket (httpx2, uvicorn) and
ZeroMQ (pyzmq).

``python -m tools.bench_processes``; needs pyzmq (``pip install -e .[bench]``). The results and the choice are in
docs/decisions/0031-http-to-the-link-process.md. Both ends use asyncio in separate processes. The messages have the
sizes of an ABORT, the telemetry of a page, and the pixels of a frame.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import statistics
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx2
import uvicorn
import zmq
import zmq.asyncio

ABORT_REQUEST, ABORT_RESPONSE = b"", b"a" * 420
FRAME = os.urandom(512 << 10)
PACKET = b"t" * 3000
PER_S, EVENTS = 50, 500
REQUESTS, FRAMES = 2000, 300
Call = Callable[[], Awaitable[bytes]]


async def _http_app(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] != "http":
        return
    if scope["path"] == "/events":
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", b"text/event-stream")]})
        for _ in range(EVENTS):
            await asyncio.sleep(1 / PER_S)
            data = b"event: telemetry\ndata: %r %s\n\n" % (time.monotonic(), PACKET)
            await send({"type": "http.response.body", "body": data, "more_body": True})
        await send({"type": "http.response.body", "body": b""})
        return
    body = FRAME if scope["path"] == "/frame" else ABORT_RESPONSE
    while (await receive()).get("more_body"):
        pass
    headers = [(b"content-length", b"%d" % len(body)), (b"content-type", b"application/json")]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": body})


def _serve_http(folder: str) -> None:
    uvicorn.run(_http_app, uds=f"{folder}/http", log_level="error", http="h11")


def _serve_zmq(folder: str) -> None:
    asyncio.run(_zmq_server(folder))


async def _zmq_server(folder: str) -> None:
    context = zmq.asyncio.Context()
    router, publisher = context.socket(zmq.ROUTER), context.socket(zmq.PUB)
    router.bind(f"ipc://{folder}/zmq")
    publisher.bind(f"ipc://{folder}/zmq-events")
    while True:
        caller, request = await router.recv_multipart()
        if request == b"events":
            await router.send_multipart([caller, b""])
            await asyncio.sleep(0.2)  # a subscription takes effect later
            for _ in range(EVENTS):
                await asyncio.sleep(1 / PER_S)
                await publisher.send_multipart([b"telemetry", b"%r %s" % (time.monotonic(), PACKET)])
        else:
            await router.send_multipart([caller, FRAME if request == b"frame" else ABORT_RESPONSE])


async def _timed(name: str, call: Call, number: int, size: int) -> None:
    for _ in range(20):
        await call()
    times_s, cpu_s = [], time.process_time()
    for _ in range(number):
        start_s = time.perf_counter()
        assert len(await call()) == size  # noqa: S101
        times_s.append(time.perf_counter() - start_s)
    cpu_s = time.process_time() - cpu_s
    _print_row(name, times_s, cpu_s / number)


def _print_row(name: str, times_s: list[float], cpu_s: float) -> None:
    cuts = statistics.quantiles(times_s, n=100)
    print(f"{name:52s} {1e3 * cuts[49]:8.3f} {1e3 * cuts[94]:8.3f} {1e3 * cpu_s:8.3f}")


async def _delays(name: str, events: AsyncIterator[bytes]) -> None:
    cpu_s = time.process_time()
    delays_s = [time.monotonic() - float(data.split(b" ", 1)[0]) async for data in events]
    _print_row(name, delays_s, (time.process_time() - cpu_s) / EVENTS)


async def _measure_http(folder: str, keep: int) -> None:
    limits = httpx2.Limits(max_connections=None, max_keepalive_connections=keep)
    label = "kept connection" if keep else "connection per request"
    async with httpx2.AsyncHTTPTransport(uds=f"{folder}/http", limits=limits) as transport:

        async def request(method: str, path: str, body: bytes | None) -> bytes:
            headers = [("host", "link")] + ([] if keep else [("connection", "close")])
            sent = httpx2.Request(method, f"http://link/{path}", headers=headers, content=body)
            return await (await transport.handle_async_request(sent)).aread()

        await _timed(f"ABORT, httpx2, {label}", lambda: request("POST", "abort", ABORT_REQUEST), REQUESTS, 420)
        await _timed(f"frame 512 KiB, httpx2, {label}", lambda: request("GET", "frame", None), FRAMES, 512 << 10)
        if keep:
            return

        async def events() -> AsyncIterator[bytes]:
            request = httpx2.Request("GET", "http://link/events")
            response = await transport.handle_async_request(request)
            response.request = request
            async for event in httpx2.EventSource(response):
                yield event.data.encode()

        await _delays("event of 3 KB at 50/s, httpx2 EventSource", events())


async def _measure_zmq(folder: str) -> None:
    context = zmq.asyncio.Context()
    dealer, subscriber = context.socket(zmq.DEALER), context.socket(zmq.SUB)
    dealer.connect(f"ipc://{folder}/zmq")
    subscriber.connect(f"ipc://{folder}/zmq-events")
    subscriber.subscribe(b"")

    async def request(name: bytes) -> bytes:
        await dealer.send_multipart([name])
        return bytes((await dealer.recv_multipart())[0])

    async def events() -> AsyncIterator[bytes]:
        await request(b"events")
        for _ in range(EVENTS):
            yield (await subscriber.recv_multipart())[1]

    await _timed("ABORT, pyzmq DEALER-ROUTER", lambda: request(b"abort"), REQUESTS, 420)
    await _timed("frame 512 KiB, pyzmq DEALER-ROUTER", lambda: request(b"frame"), FRAMES, 512 << 10)
    await _delays("event of 3 KB at 50/s, pyzmq PUB-SUB", events())
    context.destroy(linger=0)


def main() -> None:
    """Measure both transports and print milliseconds."""
    print(f"{'':52s} {'median':>8s} {'p95':>8s} {'CPU':>8s}  ms; CPU of the caller for each")
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="gss-") as folder, contextlib.ExitStack() as stack:
        for serve, name in ((_serve_http, "http"), (_serve_zmq, "zmq")):
            process = spawn.Process(target=serve, args=(folder,))
            process.start()
            stack.callback(process.join)
            stack.callback(process.terminate)
            while not Path(folder, name).exists():
                time.sleep(0.05)
        asyncio.run(_measure_http(folder, 10))
        asyncio.run(_measure_http(folder, 0))
        asyncio.run(_measure_zmq(folder))


if __name__ == "__main__":
    main()
