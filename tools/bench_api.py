"""Measure API throughput and latency with one process and with two API workers. httpx2 generates the load on keep-alive
connections."""

from __future__ import annotations

import asyncio
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

import httpx2
import numpy as np

from tools.bench_tables import BenchTable, Value
from tools.served import Served, served
from tools.soak import wait_for_rest

SEED = 1
CONNECTIONS = 8


def api(quick: bool) -> list[BenchTable]:
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
        f"{CONNECTIONS} keep-alive connections on loopback for {seconds:g} s each; each sends its next request "
        "when it receives a response; "
        "simulated sensor on the line; the generator (httpx2, one process) shares the machine. "
        "With API workers the header and the latest values are forwarded to the link process, "
        "the worker answers all other requests."
    )
    return [BenchTable("api", "Answers of the API", conditions, SEED, rows)]


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
    durations_s: list[float] = []
    sizes: list[int] = []
    end_s = time.perf_counter() + seconds
    start_s = time.perf_counter()
    await asyncio.gather(*(_request_until(server, path, end_s, durations_s, sizes) for _ in range(CONNECTIONS)))
    span_s = time.perf_counter() - start_s
    p50_ms, p95_ms, p99_ms = map(float, 1e3 * np.percentile(durations_s, (50, 95, 99)))
    rate = round(len(durations_s) / span_s, 1)
    return {"per_s": rate, "p50_ms": p50_ms, "p95_ms": p95_ms, "p99_ms": p99_ms, "bytes": sizes[-1]}


async def _request_until(server: Served, path: str, end_s: float, durations_s: list[float], sizes: list[int]) -> None:
    headers = server.headers | {"Accept-Encoding": "identity"}
    async with httpx2.AsyncClient(base_url=server.address, headers=headers, trust_env=False, timeout=60) as client:
        while time.perf_counter() < end_s:
            requested_s = time.perf_counter()
            reply = await client.get(path)
            durations_s.append(time.perf_counter() - requested_s)
            sizes.append(len(reply.raise_for_status().content))
