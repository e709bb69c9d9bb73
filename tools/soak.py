"""Soak test with 50 packets/s and ten listeners for a given time. No data may be late or lost, and no process may grow.

``python -m tools.soak HOURS [--workers N] [--clients 10] [--rate 50] [--browsers N] [--data FOLDER]`` prints a line per
minute and one JSON document at the end. The exit status is 0 if no limit was exceeded. ``make soak`` runs it for a day.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2

from tools.served import Served, processor_s, resident_bytes, served
from tools.soak_pages import LATEST_S, watch
from tools.stream_client import StreamLog, listen

MIN_SHARE = 0.5
"""Minimum share of the packet rate. On a loaded machine the simulated sensor skips packets. Skipped packets are not
counted as lost."""
COUNTERS_EVERY_S = 10.0
"""Interval at which the line counters of the ground are stored as telemetry."""
GROWTH_BYTES, GROWTH_SHARE = 24 << 20, 0.10
WARM_UP_SHARE, MIN_WARM_UP_S = 0.25, 20.0
SAMPLE_EVERY_S = 5.0
START_S = 180.0
Say = Callable[[str], None]


@dataclass
class SoakSample:
    """One sample of the server state. ``good``: packets received; ``store_late_s``: age of the latest stored packet;
    ``line_late_s``: delay of the line relative to its minimum."""

    at_s: float
    good: int
    bad: int
    gaps: int
    stored: int
    store_late_s: float
    line_late_s: float
    resident: dict[str, int]
    processor_s: dict[str, float]


@dataclass
class SoakReport:
    """Results of a run."""

    seconds: float
    rate: float
    workers: int
    samples: list[SoakSample] = field(default_factory=list)
    logs: list[StreamLog] = field(default_factory=list)
    browser: dict[str, Any] = field(default_factory=dict)

    def late_ms(self, share: float) -> float:
        """Return a quantile of the header bar's delay, over all clients."""
        late = sorted(s for log in self.logs for s in log.late_s)
        return 1e3 * late[min(len(late) - 1, int(share * len(late)))] if late else float("nan")

    def growth(self) -> dict[str, tuple[float, float]]:
        """Return (MiB after warm-up, MiB at the end) of each process that ran for the whole time."""
        warm = [sample for sample in self.samples if sample.at_s >= max(MIN_WARM_UP_S, WARM_UP_SHARE * self.seconds)]
        third = max(1, len(warm) // 3)
        names = set.intersection(*(set(sample.resident) for sample in warm)) if warm else set()
        return {n: (_mib(warm[:third], n), _mib(warm[-third:], n)) for n in sorted(names)}

    def problems(self) -> list[str]:
        """Return a text for each exceeded limit."""
        first, last = self.samples[0], self.samples[-1]
        packets = (last.good - first.good) / (last.at_s - first.at_s)
        problems = []
        if packets < MIN_SHARE * self.rate:
            problems.append(f"only {packets:.1f} packets/s of {self.rate:g} were received")
        bad, gaps = last.bad - first.bad, last.gaps - first.gaps
        if bad or gaps:
            problems.append(f"{bad} damaged packets and {gaps} gaps on a line without faults")
        received, stored = last.good - first.good, last.stored - first.stored
        counter_rows = (last.at_s - first.at_s) / COUNTERS_EVERY_S
        if (
            abs(received + counter_rows - stored) > self.rate + 20
        ):  # the counts are read at different times, and not every packet is telemetry
            problems.append(f"{received} packets received, {stored} stored")
        if max(last.store_late_s, last.line_late_s) >= LATEST_S:
            problems.append(f"late at the end: stored {last.store_late_s:.2f} s, line {last.line_late_s:.2f} s")
        problems += [f"client {k}: {text}" for k, log in enumerate(self.logs) for text in _faults(log)]
        for name, (before, after) in self.growth().items():
            if after - before > max(GROWTH_BYTES / 2**20, GROWTH_SHARE * before):
                problems.append(f"{name} grew from {before:.0f} to {after:.0f} MiB")
        return problems + [f"browser: {text}" for text in self.browser.get("problems", [])]

    def plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        first, last = self.samples[0], self.samples[-1]
        span_s = last.at_s - first.at_s
        return {
            "seconds": self.seconds,
            "workers": self.workers,
            "clients": len(self.logs),
            "packets_per_s": (last.good - first.good) / span_s,
            "packets": last.good,
            "stored": last.stored,
            "line_gaps": last.gaps - first.gaps,
            "late_ms": {"p50": self.late_ms(0.5), "p95": self.late_ms(0.95), "max": self.late_ms(1.0)},
            "late_at_end_s": {"store": last.store_late_s, "line": last.line_late_s},
            "messages": sum(log.messages for log in self.logs),
            "jumps": sum(log.jumps for log in self.logs),
            "dropped": sum(log.dropped for log in self.logs),
            "reconnects": sum(log.ended for log in self.logs),
            "processor_percent": {
                name: 100 * (last.processor_s[name] - first.processor_s[name]) / span_s
                for name in last.processor_s
                if name in first.processor_s
            },
            "resident_mib": self.growth(),
            "browser": self.browser,
            "problems": self.problems(),
        }


def _faults(log: StreamLog) -> list[str]:
    faults = []
    if log.jumps or log.dropped:
        faults.append(f"{log.jumps} jumps in the numbers, {log.dropped} dropped")
    if not log.late_s or log.late_s[-1] >= LATEST_S:
        faults.append(f"the last header bar was late: {log.late_s[-1:]} s")
    if log.ended:
        faults.append(f"the stream ended {log.ended} times")
    return faults


def _mib(samples: Sequence[SoakSample], name: str) -> float:
    return statistics.median(sample.resident[name] for sample in samples) / 2**20


async def soak(
    server: Served,
    seconds: float,
    *,
    clients: int = 10,
    rate: float = 50.0,
    workers: int = 0,
    session: str = "",
    pages: int = 1,
    say: Say = lambda _: None,
) -> SoakReport:
    """Listen to the stream and sample the server for ``seconds``. ``session``: session cookie for ``pages`` browsers
    that also show the Live page; empty: no browsers."""
    report = SoakReport(seconds, rate, workers, logs=[StreamLog() for _ in range(clients)])
    start_s = time.monotonic()
    end_s = start_s + seconds
    host, port = server.host_and_port
    listeners = [asyncio.create_task(listen(host, port, server.headers, h, end_s)) for h in report.logs]
    watching = asyncio.create_task(watch(server, session, end_s, pages)) if session else None
    async with httpx2.AsyncClient(base_url=f"{server.address}/api", headers=server.headers, timeout=30) as http:
        min_offset_s, next_line_s = float("inf"), 60.0
        while True:
            sample, offset_s = await _sample(http, server, start_s)
            min_offset_s = min(min_offset_s, offset_s)
            sample.line_late_s = offset_s - min_offset_s
            report.samples.append(sample)
            if watching is not None and watching.done():
                watching.result()  # raises if no browser could open the page, instead of after hours
            if sample.at_s >= next_line_s:
                next_line_s += 60.0
                say(_line(report))
            if time.monotonic() + SAMPLE_EVERY_S >= end_s:
                break
            await asyncio.sleep(SAMPLE_EVERY_S)
        await asyncio.gather(*listeners)
    if watching is not None:
        report.browser = await watching
    return report


async def _sample(http: httpx2.AsyncClient, server: Served, start_s: float) -> tuple[SoakSample, float]:
    """Return the sample, and the difference between ground clock and device clock in seconds. Only changes of the
    difference are meaningful."""
    counters = (await http.get("/link/counters")).json()["received"]
    newest = (await http.get("/telemetry/packets", params={"packet": "housekeeping", "limit": 1})).json()[0]
    received_s, requested_s = datetime.fromisoformat(newest["received"]).timestamp(), time.time()
    pids = server.processes()
    bad = sum(int(counters[name]) for name in ("bad_crc", "too_long", "too_short", "undecodable"))
    sample = SoakSample(
        time.monotonic() - start_s,
        int(counters["good"]),
        bad,
        int(counters["gaps"]),
        int(newest["id"]),
        requested_s - received_s,
        0.0,
        {name: resident_bytes(pid) for name, pid in pids.items()},
        {name: processor_s(pid) for name, pid in pids.items()},
    )
    return sample, received_s - float(newest["device_time_s"])


def _line(report: SoakReport) -> str:
    sample = report.samples[-1]
    memory = ", ".join(f"{name} {size / 2**20:.0f}" for name, size in sample.resident.items())
    jumps, dropped = sum(h.jumps for h in report.logs), sum(h.dropped for h in report.logs)
    return (
        f"{sample.at_s / 60:6.1f} min  {sample.good} packets, gaps {sample.gaps}, stored {sample.stored}  "
        f"late p95 {report.late_ms(0.95):.0f} ms, store {1e3 * sample.store_late_s:.0f} ms, "
        f"line {1e3 * sample.line_late_s:.0f} ms  "
        f"jumps {jumps}, dropped {dropped}  MiB: {memory}"
    )


@contextlib.contextmanager
def loaded_server(folder: Path, rate: float, workers: int) -> Any:
    """Start a server with a simulated sensor that sends ``rate`` housekeeping packets per second."""
    arguments = ["--simulator", "cubestar", *(["--workers", str(workers)] if workers else [])]
    options = {"GSS_SIMULATOR_OPTIONS": f"--housekeeping-hz {rate:g}", "GSS_STREAMS_EACH": "500"}
    with served(folder, *arguments, **options) as server:
        wait_for_rest(server)
        yield server


def wait_for_rest(server: Served) -> None:
    """Wait until the device is identified and its banks are read. After that it sends only housekeeping. Raises
    RuntimeError."""
    deadline_s = time.monotonic() + START_S
    with httpx2.Client(base_url=f"{server.address}/api", headers=server.headers, timeout=30) as http:
        while time.monotonic() < deadline_s:
            with contextlib.suppress(httpx2.TransportError):  # API workers take some seconds to load
                catalogue_id = (http.get("/link").json()["active_bank"] or {}).get("catalogue_id")
                if catalogue_id and all(transfer["finished"] for transfer in http.get("/transfers").json()):
                    return
            time.sleep(0.2)
    raise RuntimeError("the sensor was not identified in time")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the soak test and print the result."""
    parser = argparse.ArgumentParser(prog="python -m tools.soak", description=__doc__)
    parser.add_argument("hours", type=float)
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--clients", type=int, default=10)
    parser.add_argument("--rate", type=float, default=50.0, help="packets per second")
    parser.add_argument("--browsers", type=int, default=0, help="number of browsers on the Live page")
    parser.add_argument("--data", type=Path, help="data folder, which is kept")
    options = parser.parse_args(arguments)

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory(prefix="gss-soak-") as temporary:
        folder = options.data or Path(temporary) / "data"
        with loaded_server(folder, options.rate, options.workers) as server:
            session = server.sign_in() if options.browsers else ""
            run = soak(
                server,
                options.hours * 3600,
                clients=options.clients,
                rate=options.rate,
                workers=options.workers,
                session=session,
                pages=options.browsers,
                say=say,
            )
            report = asyncio.run(run)
        size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
    print(json.dumps(report.plain() | {"data_folder_bytes": size, "last_look": asdict(report.samples[-1])}, indent=1))
    return 1 if report.problems() else 0


if __name__ == "__main__":
    sys.exit(main())
