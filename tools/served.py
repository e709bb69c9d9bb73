"""Run a server process for measurements: start it, sign in, inspect it from outside and stop it."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from gss.operations.accounts.tokens import TokenService
from gss.operations.clock import utc_now
from gss.settings import Settings
from gss.store.engine import Database, open_engine

START_S = 300.0
ADDRESS = re.compile(r"https?://[^\s/]+")
TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Served:
    """A running ``gss serve``. ``headers``: request headers with an admin's credentials."""

    address: str
    folder: Path
    process: subprocess.Popen[str]
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def host_and_port(self) -> tuple[str, int]:
        """Host and port of the public socket."""
        host, port = self.address.partition("://")[2].rsplit(":", 1)
        return host, int(port)

    def log(self) -> str:
        """Return the log so far."""
        return (self.folder.parent / f"{self.folder.name}.log").read_text(errors="replace")

    def processes(self) -> dict[str, int]:
        """Return name and id of the link process and of each API worker."""
        processes = {"link": self.process.pid}
        for pid in _children(self.process.pid):
            with contextlib.suppress(OSError):
                if self._handles(pid) and b"spawn" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    processes[f"worker {len(processes)}"] = pid
        return processes

    def listeners(self) -> int:
        """Return the number of handles of the public listening socket in the link process. With API workers, a second
        handle means that the link process accepts connections."""
        return self._handles(self.process.pid)

    def _handles(self, pid: int) -> int:
        """Return the number of handles of the public listening socket in a process. Only the link process and the
        workers have such handles."""
        rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
        (inode,) = (row[9] for row in rows if row[3] == "0A" and row[1].endswith(f":{self.host_and_port[1]:04X}"))
        count = 0
        for handle in list(Path(f"/proc/{pid}/fd").iterdir()):
            with contextlib.suppress(OSError):
                count += os.readlink(handle) == f"socket:[{inode}]"
        return count

    def sign_in(self, name: str = "soak-admin") -> str:
        """Create a user and sign in. Return the value of the session cookie."""
        import httpx2

        password = secrets.token_urlsafe(16)
        command = [sys.executable, "-m", "gss", "user", "add", name, "--role", "admin", "--password-stdin"]
        subprocess.run(
            [*command, "--data", str(self.folder)], input=password + "\n", text=True, check=True, capture_output=True
        )
        reply = httpx2.post(
            f"{self.address}/api/session", json={"name": name, "password": password}, headers={"X-GSS": "1"}
        )
        reply.raise_for_status()
        return str(reply.cookies["gss_session"])


def resident_bytes(pid: int) -> int:
    """Return the resident memory of a process in bytes."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def processor_s(pid: int) -> float:
    """Return the processor time used by a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def _children(pid: int) -> list[int]:
    children: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            children += [int(child) for child in (task / "children").read_text().split()]
    return sorted(children)


@contextlib.contextmanager
def served(folder: Path, *arguments: str, **environment: str) -> Iterator[Served]:
    """Run ``gss serve`` on a free port with the data folder ``folder`` until the end of the block."""
    command = [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(folder), *arguments]
    log = (folder.parent / f"{folder.name}.log").open("ab")
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=log, text=True, env={**os.environ, **environment}
    )
    assert process.stdout is not None  # noqa: S101 - a pipe was requested
    start_timeout = threading.Timer(START_S, process.kill)
    start_timeout.start()
    try:
        address = next((match[0] for line in process.stdout if (match := ADDRESS.search(line))), "")
        start_timeout.cancel()
        if not address:
            raise RuntimeError(f"the server did not start: {Path(log.name).read_text()[-2000:]}")
        server = Served(address, folder, process)
        server.headers = {"Authorization": f"Bearer {_token(folder)}"}
        yield server
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout=25)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()
        log.close()


def _token(folder: Path) -> str:
    database = Database(open_engine(Settings(data=folder).database_url))
    try:
        return (
            TokenService(database, utc_now, lambda: None)
            .add(f"tools-{secrets.token_hex(3)}", "admin", days=7, by="tools")
            .key
        )
    finally:
        database.close()
