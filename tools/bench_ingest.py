"""Measure packets per second from the line into the database: the complete link service, over a socket, at full
speed."""

from __future__ import annotations

import socket
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from gss.device.simulator.factory import burn_golden
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.sky import SimulatedSky
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.golden import build_golden
from gss.instruments.package_files import UnitTiming
from gss.instruments.registry import shipped_camera
from tools.bench_tables import BenchTable, Value

SEED = 1
STEP_S = 0.001
TIMEOUT_S = 40.0


def ingest(quick: bool) -> list[BenchTable]:
    """Return the rate of housekeeping packets through read, capture, decode, limit check and store."""
    count = 500 if quick else 20_000
    stream = recorded_line(count)
    rows: list[tuple[str, dict[str, Value]]] = []
    for label, per_s in (("at the maximum rate", 0.0), ("offered 5 000/s", 5000.0)):
        rows.append((label, _measured(stream, count, 0.0 if quick else per_s)))
    conditions = (
        f"{count} housekeeping packets over a TCP socket into gss's link service with all its handlers and SQLite in a "
        "temporary folder; every byte is captured before it is decoded, and a packet counts when its row is stored. "
        "Wall clock and processor time of the whole process, sender included."
    )
    return [BenchTable("ingest", "Packets from the line into the database", conditions, SEED, rows)]


def recorded_line(count: int) -> list[bytes]:
    """Return line frames of a simulated sensor that sends housekeeping a thousand times per second."""
    camera, memory = shipped_camera("cubestar"), Memory.in_ram()
    burn_golden(memory, camera, build_golden(camera, memory.bank_bytes))
    tracker = StarTracker(camera, SimulatedSky(camera, Inertial.pointing(1.5, 0.1, 0.3), 2026.0, SEED), memory)
    now_s = 100.0
    device = SimulatedDevice(
        load_dictionary(), Identity(), memory, tracker, now_s, timing=UnitTiming(housekeeping_s=STEP_S)
    )
    frames: list[bytes] = []
    while len(frames) < count + 1:  # the first frame reports the start and is not telemetry
        now_s += STEP_S
        device.advance(now_s)
        while (frame := device.next_frame(now_s)) is not None:
            frames.append(frame)
    return frames[-count:]


def _measured(frames: list[bytes], count: int, per_s: float) -> dict[str, Value]:
    from gss.settings import Settings
    from gss.wiring.build import build

    with tempfile.TemporaryDirectory() as folder, socket.create_server(("127.0.0.1", 0)) as listener:
        services = build(Settings(data=Path(folder), device=f"socket://127.0.0.1:{listener.getsockname()[1]}"))
        services.start()
        try:
            line, _ = listener.accept()
            while not services.line.link.connected:  # data received before the contact starts are discarded
                time.sleep(0.01)
            time.sleep(0.5)
            sender = threading.Thread(target=_send, args=(line, frames, per_s), daemon=True)
            before_s, before_cpu_s = time.perf_counter(), time.process_time()
            sender.start()
            stored = _wait(services, count)
            elapsed_s, cpu_s = time.perf_counter() - before_s, time.process_time() - before_cpu_s
            line.close()
        finally:
            services.stop()
    return {
        "stored": stored,
        "packets_per_s": round(stored / elapsed_s),
        "processor_ms_per_packet": 1e3 * cpu_s / max(1, stored),
        "bytes": sum(map(len, frames)) // len(frames),
        "lost": count - stored,
    }


def _send(line: socket.socket, frames: list[bytes], per_s: float) -> None:
    start_s = time.perf_counter()
    for k in range(0, len(frames), 10):
        if per_s:
            time.sleep(max(0.0, start_s + k / per_s - time.perf_counter()))
        line.sendall(b"".join(frames[k : k + 10]))


def _wait(services: Any, count: int) -> int:
    """Wait until ``count`` rows are stored or ``TIMEOUT_S`` has passed. Return the number of telemetry rows received
    from the line."""
    from sqlalchemy import text

    deadline_s = time.perf_counter() + TIMEOUT_S
    stored = 0
    while stored < count and time.perf_counter() < deadline_s:
        time.sleep(0.02)
        with services.base.database.unit_of_work() as session:
            stored = int(session.scalar(text("select coalesce(max(id), 0) from telemetry_packets")) or 0)
    with services.base.database.unit_of_work() as session:
        row_count = session.scalar(text("select count(*) from telemetry_packets where packet != 'ground_line'"))
    return int(row_count or 0)
