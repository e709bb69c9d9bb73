"""Measure the time from a click on ABORT to its first byte on the wire, under load and with faults.

``python -m tools.abort_times [--times 5] [--only CONDITION ...] [--json]`` starts a simulated sensor, a tap on its line
and a server for each condition. It sends each ABORT over a new connection and prints the times. The condition "disk
full" mounts a small tmpfs, which needs root.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import signal
import socket
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import httpx2
import numpy as np

from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.instruments.dictionary.read_dictionary import load_dictionary
from tools.served import Served, served

LIMIT_S = 0.5
SMALL_DISK_MB = 64
ABORT_TIMEOUT_S = 30.0


class AbortTap:
    """TCP relay between server and sensor that records when ABORT passes towards the sensor."""

    def __init__(self, sensor_port: int) -> None:
        self._sensor_port = sensor_port
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self.aborts: queue.Queue[float] = queue.Queue()
        self.silent = threading.Event()
        """While set, data from the sensor do not reach the ground, so commands stay queued."""
        self._code = load_dictionary().command("ABORT").code
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Stop accepting connections."""
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                ground, _ = self._server.accept()
                sensor = socket.create_connection(("127.0.0.1", self._sensor_port))
                threading.Thread(target=self._relay, args=(ground, sensor, True), daemon=True).start()
                threading.Thread(target=self._relay, args=(sensor, ground, False), daemon=True).start()

    def _relay(self, source: socket.socket, target: socket.socket, is_uplink: bool) -> None:
        receiver = LineReceiver(from_device=False)
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                at_s = time.monotonic()
                if is_uplink or not self.silent.is_set():
                    target.sendall(data)
                if is_uplink:
                    for packet in receiver.feed(data):
                        if packet.type is PacketType.COMMAND and packet.code == self._code:
                            self.aborts.put(at_s)
        for connection in (source, target):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)


@dataclass(frozen=True)
class Times:
    """Times of one condition in seconds; ``None`` if ABORT did not pass within ``ABORT_TIMEOUT_S``. ``answers``: HTTP
    status and response time in seconds."""

    condition: str
    wire_s: list[float | None]
    answers: list[tuple[int, float]]

    def __add__(self, other: Times) -> Times:
        return Times(self.condition, self.wire_s + other.wire_s, self.answers + other.answers)

    @property
    def worst_s(self) -> float:
        """Longest time from the request to the wire."""
        return max(ABORT_TIMEOUT_S if s is None else s for s in self.wire_s)


def measure(condition: str, server: Served, tap: AbortTap, times: int) -> Times:
    """Send ABORT ``times`` times, each over a new connection."""
    wire_times_s: list[float | None] = []
    answers: list[tuple[int, float]] = []
    for _ in range(times):
        while not tap.aborts.empty():
            tap.aborts.get()
        start_s = time.monotonic()
        response: list[tuple[int, float]] = []
        thread = threading.Thread(target=_send_abort, args=(server, start_s, response), daemon=True)
        thread.start()
        try:
            wire_times_s.append(tap.aborts.get(timeout=ABORT_TIMEOUT_S) - start_s)
        except queue.Empty:
            wire_times_s.append(None)
        thread.join(ABORT_TIMEOUT_S)
        answers += response or [(0, ABORT_TIMEOUT_S)]
        time.sleep(0.3)
    return Times(condition, wire_times_s, answers)


def _send_abort(server: Served, start_s: float, answers: list[tuple[int, float]]) -> None:
    with contextlib.suppress(httpx2.HTTPError):
        reply = httpx2.post(f"{server.address}/api/commands/abort", headers=server.headers, timeout=ABORT_TIMEOUT_S)
        answers.append((reply.status_code, time.monotonic() - start_s))


# --- conditions ---------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def idle(_server: Served, _tap: AbortTap) -> Iterator[None]:
    """Apply no other load."""
    yield


@contextlib.contextmanager
def database_locked(server: Served, _tap: AbortTap) -> Iterator[None]:
    """Hold SQLite's write lock from another connection."""
    connection = sqlite3.connect(server.folder / "gss.db", isolation_level=None, timeout=30)
    connection.execute("BEGIN IMMEDIATE")
    time.sleep(1.0)
    yield
    connection.execute("ROLLBACK")
    connection.close()


@contextlib.contextmanager
def disk_full(server: Served, _tap: AbortTap) -> Iterator[None]:
    """Fill the disk of the data folder."""
    filler = server.folder / "filler"
    with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    time.sleep(1.0)
    yield
    filler.unlink()


@contextlib.contextmanager
def many_queued(server: Served, tap: AbortTap) -> Iterator[None]:
    """Queue five hundred commands while the sensor does not respond. The queue is refilled for each ABORT."""
    tap.silent.set()
    body = {"name": "SET_EXPOSURE", "arguments": {"exposure_ms": 100}}
    with httpx2.Client(headers=server.headers, base_url=f"{server.address}/api", timeout=30) as client:
        while True:
            waiting = len(client.get("/commands", params={"result": "queued", "limit": 1000}).json())
            if waiting >= 500:
                break
            for _ in range(500 - waiting + 5):
                client.post("/commands", json=body).raise_for_status()
        yield
    tap.silent.clear()


@contextlib.contextmanager
def importing(server: Served, _tap: AbortTap) -> Iterator[None]:
    """Import photographs of 16 megapixels continuously."""
    from astropy.io import fits

    pixels = np.random.default_rng(1).integers(0, 4000, (4000, 4000), dtype=np.uint16)
    file = BytesIO()
    fits.PrimaryHDU(pixels).writeto(file)
    with _repeated(2, lambda: _import(server, file.getvalue())):
        time.sleep(2.0)
        yield


def _import(server: Served, content: bytes) -> None:
    files = {"file": ("night.fits", content, "application/fits")}
    httpx2.post(f"{server.address}/api/frames/import", headers=server.headers, files=files, timeout=120)


@contextlib.contextmanager
def slow_clients(server: Served, _tap: AbortTap) -> Iterator[None]:
    """Send sign-in requests from two hundred clients without an account, one byte per second."""
    head = b"POST /api/session HTTP/1.1\r\nHost: localhost\r\nX-GSS: 1\r\n"
    head += b"Content-Type: application/json\r\nContent-Length: 60000\r\n\r\n"
    clients: list[socket.socket] = []
    stop = threading.Event()

    def drip() -> None:
        while not stop.wait(1.0):
            for client in clients:
                with contextlib.suppress(OSError):
                    client.send(b" ")

    for _ in range(200):
        client = socket.create_connection(server.host_and_port)
        client.settimeout(0.5)
        client.sendall(head)
        clients.append(client)
    thread = threading.Thread(target=drip, daemon=True)
    thread.start()
    time.sleep(2.0)
    yield
    stop.set()
    thread.join()
    for client in clients:
        client.close()


@contextlib.contextmanager
def workers_dead(server: Served, _tap: AbortTap) -> Iterator[None]:
    """Kill every API worker repeatedly."""
    stop = threading.Event()

    def kill() -> None:
        while not stop.is_set():
            for name, pid in server.processes().items():
                if name != "link":
                    with contextlib.suppress(OSError):
                        os.kill(pid, signal.SIGKILL)
            stop.wait(0.05)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    time.sleep(1.0)
    yield
    stop.set()
    thread.join()


@contextlib.contextmanager
def _repeated(threads: int, work: Callable[[], None]) -> Iterator[None]:
    stop = threading.Event()

    def run() -> None:
        while not stop.is_set():
            with contextlib.suppress(httpx2.HTTPError):
                work()

    running = [threading.Thread(target=run, daemon=True) for _ in range(threads)]
    for thread in running:
        thread.start()
    yield
    stop.set()


CONDITIONS: dict[str, tuple[Callable[[Served, AbortTap], contextlib.AbstractContextManager[None]], tuple[str, ...]]] = {
    "idle": (idle, ()),
    "database locked": (database_locked, ()),
    "disk full": (disk_full, ()),
    "500 queued commands": (many_queued, ()),
    "running import": (importing, ()),
    "200 slow clients": (slow_clients, ()),
    "all workers dead": (workers_dead, ("--workers", "2")),
}


@contextlib.contextmanager
def _folder(small: bool) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "data"
        folder.mkdir()
        if small:
            options = ["-o", f"size={SMALL_DISK_MB}m", "tmpfs", str(folder)]
            subprocess.run(["mount", "-t", "tmpfs", *options], check=True)
        yield folder
        if small:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextlib.contextmanager
def _sensor(folder: Path) -> Iterator[int]:
    command = [sys.executable, "-m", "gss", "simulate", "--tcp", "0", "--baud", "0", "--state-dir", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None  # noqa: S101 - a pipe was requested
    ready = next(line for line in process.stdout if "READY" in line)
    yield int(ready.rsplit(":", 1)[1])
    process.terminate()
    process.wait(10)


def run(condition: str, times: int) -> Times:
    """Measure one condition on a fresh server and sensor."""
    context, arguments = CONDITIONS[condition]
    limits = {"GSS_DISK_WATCH_MB": "2", "GSS_DISK_STOP_MB": "1"}
    # An ABORT empties the queue, so the queue must be filled again for each ABORT.
    rounds = times if context is many_queued else 1
    result = Times(condition, [], [])
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(_folder(small=context is disk_full))
        state = stack.enter_context(tempfile.TemporaryDirectory())
        tap = AbortTap(stack.enter_context(_sensor(Path(state))))
        stack.callback(tap.close)
        device = f"socket://127.0.0.1:{tap.port}"
        server = stack.enter_context(served(folder, "--device", device, *arguments, **limits))
        _wait_for_sensor(server)
        for _ in range(rounds):
            with context(server, tap):
                result += measure(condition, server, tap, times // rounds)
    return result


def _wait_for_sensor(server: Served) -> None:
    until_s = time.monotonic() + 60
    while time.monotonic() < until_s:
        reply = httpx2.get(f"{server.address}/api/link", headers=server.headers, timeout=10)
        if reply.status_code == 200 and reply.json()["dictionary_match"]:
            return
        time.sleep(0.2)
    raise RuntimeError("the sensor did not respond")


def main() -> int:
    """Print a table. Exit status 1 if ABORT took longer than ``LIMIT_S`` under any condition."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=5, help="number of ABORTs under each condition")
    parser.add_argument("--only", nargs="*", choices=list(CONDITIONS), default=list(CONDITIONS))
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args()
    measured = [run(condition, options.times) for condition in options.only]
    if options.json:
        print(json.dumps([vars(times) for times in measured]))
    else:
        print(f"{'condition':<22}{'wire median':>13}{'wire worst':>13}{'answer worst':>14}  status")
        for times in measured:
            median = statistics.median(ABORT_TIMEOUT_S if s is None else s for s in times.wire_s)
            codes = " ".join(str(code) for code, _ in times.answers)
            answer_s = max(s for _, s in times.answers)
            print(f"{times.condition:<22}{median:>11.3f} s{times.worst_s:>11.3f} s{answer_s:>12.3f} s  {codes}")
    return int(any(times.worst_s > LIMIT_S for times in measured))


if __name__ == "__main__":
    sys.exit(main())
