"""API throughput and latency, with one process and with two API workers; own load generator on keep-alive connections."""

from __future__ import annotations

import asyncio
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

import numpy as np

from tools.bench_tables import Table, Value
from tools.served import Served, served
from tools.soak import wait_for_rest

SEED = 1
CONNECTIONS = 8


def api(quick: bool) -> list[Table]:
    """Return requests per second and response times."""
    seconds = 0.5 if quick else 5.0
    rows: list[tuple[str, dict[str, Value]]] = []
    for workers in (0, 2):
        with tempfile.TemporaryDirectory() as folder:
            arguments = ["--simulator", "cubestar", *(["--workers", str(workers)] if workers else [])]
            with served(Path(folder) / "data", *arguments) as server:
                wait_for_rest(server)
                label = f"{workers} API workers" if workers else "one process"
                for name, path in _paths().items():
                    rows.append((f"{label}: {name}", asyncio.run(_measured(server, path, seconds))))
    conditions = (
        f"{CONNECTIONS} keep-alive connections on loopback for {seconds:g} s each; every one asks again as soon as it is answered; "
        "simulated sensor on the line; the generator (asyncio, one process) shares the machine. "
        "With API workers the header and the latest values are forwarded to the link process, the rest is answered by the worker."
    )
    return [Table("api", "Answers of the API", conditions, SEED, rows)]


def _paths() -> dict[str, str]:
    now = time.time()
    start, end = (time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(now + d)) for d in (-3600, 60))
    span = f"start={quote(start)}&end={quote(end)}"
    return {
        "header": "/api/link",
        "latest telemetry": "/api/telemetry/latest",
        "frames": "/api/frames",
        "history of an hour": f"/api/telemetry/history?name=housekeeping.rate_deg_s&{span}&points=600",
    }


async def _measured(server: Served, path: str, seconds: float) -> dict[str, Value]:
    took_s: list[float] = []
    sizes: list[int] = []
    end_s = time.perf_counter() + seconds
    start_s = time.perf_counter()
    await asyncio.gather(*(_ask(server, path, end_s, took_s, sizes) for _ in range(CONNECTIONS)))
    span_s = time.perf_counter() - start_s
    p50_ms, p95_ms, p99_ms = map(float, 1e3 * np.percentile(took_s, (50, 95, 99)))
    rate = round(len(took_s) / span_s, 1)
    return {"per_s": rate, "p50_ms": p50_ms, "p95_ms": p95_ms, "p99_ms": p99_ms, "bytes": sizes[-1]}


async def _ask(server: Served, path: str, end_s: float, took_s: list[float], sizes: list[int]) -> None:
    host, port = server.host_and_port
    reader, writer = await asyncio.open_connection(host, port, limit=1 << 24)
    head = "".join(f"{name}: {value}\r\n" for name, value in server.headers.items())
    request = f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\n{head}\r\n".encode()
    try:
        while time.perf_counter() < end_s:
            asked_s = time.perf_counter()
            writer.write(request)
            status = await reader.readuntil(b"\r\n\r\n")
            if b" 200 " not in status.split(b"\r\n", 1)[0]:
                raise RuntimeError(f"{path}: {status.splitlines()[0].decode()}")
            fields = dict(line.lower().split(b": ", 1) for line in status.split(b"\r\n")[1:] if line)
            size = await _body(reader, fields)
            took_s.append(time.perf_counter() - asked_s)
            sizes.append(size)
    finally:
        writer.close()


async def _body(reader: asyncio.StreamReader, fields: dict[bytes, bytes]) -> int:
    if b"content-length" in fields:
        return len(await reader.readexactly(int(fields[b"content-length"])))
    size = 0
    while piece := int(await reader.readline(), 16):
        size += len(await reader.readexactly(piece + 2)) - 2
    await reader.readline()
    return size
