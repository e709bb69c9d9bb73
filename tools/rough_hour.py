"""Test an hour with disturbances: ``kill -9`` of the server every ten minutes and a full disk once.

The load is 50 packets/s, a frame every six seconds, ten listeners and browsers.

``python -m tools.rough_hour DATA [--minutes 60] [--rate 50] [--browsers 10]`` prints one JSON document. ``DATA`` must
be on a small, otherwise unused file system (``mount -t tmpfs -o size=3g none DATA``), because the tool fills it
completely. At the end every gap of the record must have a cause and the store must be intact.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO

import httpx2

from gss.client import Client, ClientError
from tools.browser import launch_options
from tools.served import START_S, resident_bytes
from tools.stream_client import StreamLog, listen

KILL_EVERY_S = 600.0
FRAME_EVERY_S = 6.0
FILLED_S = 60.0
MAX_FILLED_BYTES = 8 << 30
"""Largest size of a file system that is filled. A larger file system is probably used for other data."""
MINUTE_S = 60.0
LIVE = "[data-testid=link-state]"


@dataclass
class HourDisturbance:
    """One disturbance. ``recovered_s``: seconds from its end until the server reports new telemetry."""

    kind: str
    at_s: float
    recovered_s: float


@dataclass
class HourRecord:
    """Results of the test. ``resident_mib``: resident memory of the server, once per minute."""

    minutes: float
    rate: float
    load: list[float] = field(default_factory=list)
    resident_mib: list[float] = field(default_factory=list)
    troubles: list[HourDisturbance] = field(default_factory=list)
    images_taken: int = 0
    images_refused: int = 0
    frames_stored: int = 0
    listeners: list[dict[str, float]] = field(default_factory=list)
    browsers: dict[str, object] = field(default_factory=dict)
    record: dict[str, object] = field(default_factory=dict)
    store: dict[str, object] = field(default_factory=dict)


class RoughServer:
    """Server on a fixed port that can be killed and restarted with the same data."""

    def __init__(self, data: Path, port: int, device: str, log: IO[bytes]) -> None:
        self._command = [*_gss(), "serve", "--port", str(port), "--data", str(data), "--device", device]
        self._log = log
        self.address = f"http://127.0.0.1:{port}"
        self.process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(self._command, stdout=self._log, stderr=self._log)
        deadline_s = time.monotonic() + START_S
        while time.monotonic() < deadline_s:
            try:
                httpx2.get(f"{self.address}/api/session", timeout=5)
            except httpx2.TransportError:
                time.sleep(0.1)
            else:
                return process
        process.kill()
        raise RuntimeError("the server did not start; see its log")

    def kill(self) -> None:
        """Kill the server with SIGKILL and restart it."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        self.process = self._start()

    def stop(self) -> None:
        """Stop the server with SIGINT, as an operator does."""
        self.process.send_signal(signal.SIGINT)
        self.process.wait(timeout=30)


def _gss() -> list[str]:
    return [sys.executable, "-m", "gss"]


def _fill(data: Path) -> Path:
    """Fill the file system of ``data``. Return the file to remove afterwards."""
    space = os.statvfs(data)
    if space.f_blocks * space.f_frsize > MAX_FILLED_BYTES:
        raise SystemExit(f"{data} is on a file system of more than 8 GiB. Mount a small one there first.")
    filler = data.parent / f"{data.name}-filler" if data.parent.stat().st_dev == data.stat().st_dev else data / "filler"
    block = b"\0" * (1 << 20)
    with filler.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(block)
        except OSError:
            return filler


async def _until_new_telemetry(http: httpx2.AsyncClient) -> float:
    """Return the seconds until a housekeeping packet is stored that is newer than this call."""
    begin_s = time.monotonic()
    newest: int | None = None
    while True:
        try:
            reply = await http.get("/telemetry/packets", params={"packet": "housekeeping", "limit": 1})
            number = int(reply.json()[0]["id"]) if reply.is_success and reply.json() else 0
            if newest is not None and number > newest:
                return time.monotonic() - begin_s
            newest = number if newest is None else newest
        except (httpx2.HTTPError, OSError):
            pass
        await asyncio.sleep(0.2)


@asynccontextmanager
async def browsers(address: str, session: str, pages: int) -> AsyncIterator[dict[str, object]]:
    """Keep ``pages`` Live pages open. After the block the result contains each page's link state, script errors and
    heap."""
    from playwright.async_api import async_playwright

    result: dict[str, object] = {"pages": pages}
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(**launch_options())
        errors: list[str] = []
        opened = []
        for _ in range(pages):
            context = await browser.new_context()
            await context.add_cookies([{"name": "gss_session", "value": session, "url": address}])
            page = await context.new_page()
            page.on("pageerror", lambda error: errors.append(str(error)))
            await page.goto(f"{address}/live")
            await page.locator(LIVE).wait_for(timeout=120_000)
            opened.append(page)
        yield result
        lamps, heaps = [], []
        for page in opened:
            lamps.append((await page.locator(LIVE).first.inner_text()).strip().replace("\n", " "))
            probe = await page.context.new_cdp_session(page)
            await probe.send("HeapProfiler.collectGarbage")
            heaps.append(round((await probe.send("Runtime.getHeapUsage"))["usedSize"] / 1e6, 1))
        result |= {"link_lamps": lamps, "heap_mb": heaps, "script_errors": errors}
        await browser.close()


def _take_images(address: str, token: str, end_s: float, record: HourRecord) -> None:
    """Command an image every ``FRAME_EVERY_S`` until ``end_s``. The server downloads the images."""
    while time.monotonic() < end_s:
        try:
            with Client(address, token) as client, client.authority():
                client.wait_connected(60)
                client.send("TAKE_IMAGE", timeout_s=30)
                record.images_taken += 1
        except ClientError:  # the server was killed, or the disk is full
            record.images_refused += 1
        time.sleep(FRAME_EVERY_S)


async def rough_hour(server: RoughServer, data: Path, token: str, session: str, record: HourRecord, pages: int) -> None:
    """Disturb the server for ``record.minutes`` and fill ``record``."""
    end_s = (start_s := time.monotonic()) + 60 * record.minutes
    fill_at_s = start_s + 0.55 * 60 * record.minutes
    kill_at_s = start_s + KILL_EVERY_S
    headers = {"Authorization": f"Bearer {token}"}
    logs = [StreamLog() for _ in range(10)]
    host, port = server.address.removeprefix("http://").split(":")
    async with (
        httpx2.AsyncClient(base_url=f"{server.address}/api", headers=headers, timeout=30) as http,
        browsers(server.address, session, pages) as seen,
    ):
        tasks = [asyncio.create_task(listen(host, int(port), headers, log, end_s)) for log in logs]
        images = asyncio.create_task(asyncio.to_thread(_take_images, server.address, token, end_s, record))
        next_line_s = start_s
        while (now_s := time.monotonic()) < end_s:
            if now_s >= kill_at_s:
                kill_at_s += KILL_EVERY_S
                await asyncio.to_thread(server.kill)
                record.troubles.append(HourDisturbance("kill -9", now_s - start_s, await _until_new_telemetry(http)))
            if now_s >= fill_at_s:
                fill_at_s = float("inf")
                filler = await asyncio.to_thread(_fill, data)
                await asyncio.sleep(FILLED_S)
                filler.unlink()
                record.troubles.append(
                    HourDisturbance("disk full for 60 s", now_s - start_s, await _until_new_telemetry(http))
                )
            if now_s >= next_line_s:
                next_line_s += MINUTE_S
                record.load.append(round(os.getloadavg()[0], 2))
                record.resident_mib.append(round(resident_bytes(server.process.pid) / 2**20, 1))
                print(
                    f"{(now_s - start_s) / 60:5.1f} min  load {record.load[-1]}  server {record.resident_mib[-1]} MiB",
                    file=sys.stderr,
                    flush=True,
                )
            await asyncio.sleep(1.0)
        await asyncio.gather(*tasks, images)
        record.frames_stored = (await http.get("/frames", params={"limit": 1})).json()["total"]
    record.browsers = seen
    record.listeners = [_summary(log) for log in logs]


def _summary(log: StreamLog) -> dict[str, float]:
    late = sorted(log.late_s)
    return {
        "messages": log.messages,
        "dropped": log.dropped,
        "jumps": log.jumps,
        "reconnects": log.ended,
        "late_p95_s": round(late[int(0.95 * (len(late) - 1))], 3) if late else -1.0,
        "late_last_s": round(log.late_s[-1], 3) if late else -1.0,
    }


@contextmanager
def _simulator(port: int, rate: float, log: IO[bytes]):  # type: ignore[no-untyped-def]  # a generator of None
    # The rate of the line is not limited, because fifty packets per second at 115 200 Bd would leave no capacity for
    # frames.
    options = ["--instrument", "cubestar", "--tcp", str(port), "--housekeeping-hz", f"{rate:g}", "--baud", "0"]
    process = subprocess.Popen([*_gss(), "simulate", *options], stdout=log, stderr=log)
    try:
        yield
    finally:
        process.terminate()
        process.wait(timeout=20)


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*_gss(), *arguments], capture_output=True, text=True, check=False)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the test and print its record as JSON. Return 1 if a gap has no cause or the store is damaged."""
    parser = argparse.ArgumentParser(prog="python -m tools.rough_hour", description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=50.0, help="housekeeping packets per second")
    parser.add_argument("--browsers", type=int, default=10)
    parser.add_argument("--port", type=int, default=28181)
    options = parser.parse_args(arguments)
    data = options.data / "gss"
    data.mkdir(parents=True, exist_ok=True)
    record = HourRecord(options.minutes, options.rate)
    with (
        (options.data.parent / f"{options.data.name}.log").open("ab") as log,
        _simulator(options.port + 1, options.rate, log),
    ):
        server = RoughServer(data, options.port, f"socket://127.0.0.1:{options.port + 1}", log)
        key = next(
            w
            for w in _run("token", "add", "hour", "--role", "admin", "--data", str(data)).stdout.split()
            if len(w) > 30
        )
        session = _session(server, data)
        asyncio.run(rough_hour(server, data, key, session, record, options.browsers))
        server.stop()
    gaps, store = (
        _run("check", "record", "--all", "--json", "--data", str(data)),
        _run("check", "store", "--data", str(data)),
    )
    record.record = json.loads(gaps.stdout)
    record.store = {"output": store.stdout.strip(), "exit_code": store.returncode}
    print(json.dumps(asdict(record), indent=1))
    return max(gaps.returncode, store.returncode)


def _session(server: RoughServer, data: Path) -> str:
    """Return the session cookie of a new user for the browsers."""
    secret = os.urandom(12).hex()
    command = [*_gss(), "user", "add", "hour-watch", "--role", "operator", "--password-stdin", "--data", str(data)]
    subprocess.run(command, input=secret + "\n", text=True, check=True, capture_output=True)
    body = {"name": "hour-watch", "password": secret}
    reply = httpx2.post(f"{server.address}/api/session", json=body, headers={"X-GSS": "1"}, timeout=START_S)
    reply.raise_for_status()
    return str(reply.cookies["gss_session"])


if __name__ == "__main__":
    sys.exit(main())
