"""Real server and simulator processes, controlled over HTTP."""

from __future__ import annotations

import os
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import pytest

START_S = 60.0
LONG_S = 600.0
POLL_S = (0.05, 0.5)


@pytest.fixture(scope="module", autouse=True)
def _forked(forked: None) -> None:
    """Fork the servers and simulators of these tests from a preloaded process."""


class Console:
    """HTTP client of an admin that waits for results."""

    def __init__(self, address: str, headers: dict[str, str]) -> None:
        self.address, self.headers = address, headers
        self.http = httpx2.Client(base_url=f"{address}/api", headers=headers, timeout=30)

    def get(self, path: str, **query: Any) -> Any:
        """Return the JSON of a GET that must succeed."""
        reply = self.http.get(path, params=query)
        assert reply.status_code == 200, reply.text
        return reply.json()

    def post(self, path: str, body: Any = None, status: int = 201) -> Any:
        """Return the JSON of a POST that must succeed."""
        reply = self.http.post(path, json=body)
        assert reply.status_code == status, reply.text
        return reply.json()

    def wait(self, what: str, look: Callable[[], Any], seconds: float = 30.0) -> Any:
        """Return the first true value of ``look``; fail with ``what`` after the timeout. The time between two calls is a tenth
        of the time waited, between the limits POLL_S."""
        began = time.monotonic()
        while (waited := time.monotonic() - began) < seconds:
            found = look()
            if found:
                return found
            time.sleep(min(max(POLL_S[0], waited / 10), POLL_S[1]))
        pytest.fail(f"waited {seconds:g} s for {what}")

    def command(self, name: str, *, confirm: str = "", **arguments: Any) -> Any:
        """Send a command and wait for its end."""
        row = self.post("/commands", {"name": name, "arguments": arguments, "confirm": confirm})
        ended = ("completed", "rejected", "failed", "unknown")
        return self.wait(
            f"{name} to end",
            lambda: next((c for c in [self.get(f"/commands/{row['id']}")] if c["result"] in ended), None),
        )


class Server:
    """``gss serve`` as a child process on a free port. ``headers``: request headers of a signed-in user."""

    def __init__(self, folder: Path, headers: dict[str, str], *arguments: str, **environment: str) -> None:
        self.folder = folder
        self.log = (folder.parent / f"{folder.name}.log").open("ab")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(folder), *arguments],
            env={**os.environ, "GSS_SIMULATOR_BAUD": "0", **environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self.log,
            text=True,
        )
        self.console = Console(self._address(), headers)

    def _address(self) -> str:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if "http://" in line:
                return line[line.index("http://") :].strip()
        pytest.fail(f"the server did not start: {Path(self.log.name).read_text()[-2000:]}")

    def stop(self, end: signal.Signals = signal.SIGINT, within_s: float = 60.0) -> None:
        """Stop the server as Ctrl-C does, or with another signal."""
        if self.process.poll() is None:
            self.process.send_signal(end)
            self.process.wait(timeout=within_s)
        self._close()

    def kill(self) -> None:
        """Kill the server as a power failure would; the simulator is a separate process and continues."""
        self.process.kill()
        self.process.wait()
        self._close()

    def _close(self) -> None:
        self.console.http.close()
        if self.process.stdout:
            self.process.stdout.close()
        self.log.close()


@pytest.fixture
def serve(tmp_path: Path, signed_in: Callable[..., dict[str, str]]) -> Iterator[Callable[..., Server]]:
    """Factory of servers on one data folder with a signed-in admin. Running servers are stopped after the test."""
    started: list[Server] = []

    def start(*arguments: str, **environment: str) -> Server:
        again = bool(started) and not environment.get("GSS_DATABASE")
        where = environment.get("GSS_DATABASE") or tmp_path / "data"
        headers = started[-1].console.headers if again else signed_in(where)
        started.append(Server(tmp_path / "data", headers, *arguments, **environment))
        return started[-1]

    yield start
    for server in started:
        if server.process.poll() is None:
            server.stop()


class Units:
    """Client of a server with units."""

    def __init__(self, server: Server) -> None:
        self.server, self.console = server, server.console

    def fleet(self) -> dict[str, Any]:
        return {unit["name"]: unit for unit in self.console.get("/fleet")["units"]}

    def http(self, name: str) -> httpx2.Client:
        """A client of one unit."""
        return httpx2.Client(
            base_url=f"{self.console.address}/units/{name}/api", headers=self.console.headers, timeout=30
        )

    def connected(self, *names: str) -> dict[str, Any]:
        """Wait until these units have a line and telemetry; return the fleet."""

        def there() -> dict[str, Any] | None:
            units = self.fleet()
            good = all(units[n]["current"] and units[n]["link"]["rx"]["state"] == "up" for n in names)
            return units if good else None

        return self.console.wait(f"{names} to be connected", there, LONG_S)


@pytest.fixture
def start_units(serve: Callable[..., Server]) -> Callable[..., Units]:
    """Factory of a server with units, each given as NAME=INSTRUMENT@ADDRESS."""

    def start(*specifications: str, **environment: str) -> Units:
        return Units(serve(*(word for text in specifications for word in ("--unit", text)), **environment))

    return start


@pytest.fixture
def run_gss() -> Iterator[Callable[..., Any]]:
    """Function that starts ``gss`` with these arguments as a child process. It is stopped after the test."""
    started: list[Any] = []

    def run(*arguments: str) -> Any:
        command = [sys.executable, "-m", "gss", *arguments]
        started.append(subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True))
        return started[-1]

    yield run
    for process in started:
        process.terminate()
        process.wait(timeout=60)
        process.stdout.close()


class Sensor:
    """A simulator on a TCP port that can be killed and started again on its flash."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder, self._arguments = folder, arguments
        folder.mkdir(exist_ok=True)
        self.port = 0
        self.start()

    def start(self) -> None:
        command = [sys.executable, "-m", "gss.device.simulator", "--profile", "cubestar", "--tcp", "0", "--seed", "7"]
        command += ["--state-dir", str(self.folder), "--baud", "0", *self._arguments]
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        ready = next(line for line in self.process.stdout if line.startswith("READY"))
        self.url = ready.split()[1]
        self.port = int(self.url.rsplit(":", 1)[1])

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def stop(self) -> None:
        """Stop the simulator with SIGTERM, as its supervisor does."""
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(timeout=60)
            self.process.stdout.close()


@pytest.fixture
def sensor(tmp_path: Path) -> Iterator[Sensor]:
    """Sensor of one test."""
    simulator = Sensor(tmp_path / "sensor")
    yield simulator
    simulator.stop()


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[str]:
    """Address of a simulated sensor on a TCP port, independent of any server."""
    sensor = Sensor(tmp_path / "sensor")
    yield sensor.url
    sensor.stop()


@dataclass(frozen=True)
class Certificate:
    """Files of a self-signed certificate for localhost and of its key. ``trust``: settings of a client that trusts it."""

    chain: Path
    key: Path
    trust: ssl.SSLContext


@pytest.fixture(scope="session")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    """Certificate of servers and proxies with TLS."""
    folder = tmp_path_factory.mktemp("certificate")
    chain, key = folder / "chain.pem", folder / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    names = ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    subprocess.run([*command, *names, "-keyout", key, "-out", chain], check=True, capture_output=True)
    return Certificate(chain, key, ssl.create_default_context(cafile=chain))
