"""From an empty folder to the first user, with real processes: printed link, shell, TLS, and the files on disk."""

from __future__ import annotations

import io
import os
import re
import signal
import ssl
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import httpx2
import pytest

from gss.cli import main
from gss.operations.accounts.accounts import REMEMBERED_S

pytestmark = pytest.mark.timeout(180)
PASSWORD = "orion over the sea"
CHEAP = {"GSS_PASSWORD_MEMORY_KIB": "8", "GSS_PASSWORD_PASSES": "1"}


class Ran(NamedTuple):
    """Result of a shell command."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def shell(capsys, monkeypatch) -> Callable[..., Ran]:
    """Function that runs ``gss`` in this process, separate from the server, and returns its result."""
    for name, value in CHEAP.items():
        monkeypatch.setenv(name, value)

    def run(*arguments: str, stdin: str = "") -> Ran:
        monkeypatch.setattr("sys.stdin", io.StringIO(stdin))
        capsys.readouterr()
        code = main(arguments)
        return Ran(code, *capsys.readouterr())

    return run


@pytest.fixture
def start() -> Iterator[Callable[..., tuple[subprocess.Popen[str], str]]]:
    """Factory of servers without a signed-in user; returns the process and its printed address. ``alone``: a new process that
    imports everything itself."""
    running: list[subprocess.Popen[str]] = []

    def run(
        folder: Path, *arguments: str, alone: bool = False, **environment: str
    ) -> tuple[subprocess.Popen[str], str]:
        program = [str(Path(sys.executable).with_name("gss"))] if alone else [sys.executable, "-m", "gss"]
        command = [*program, "serve", "--port", "0", "--data", str(folder), *arguments]
        env = {**os.environ, **CHEAP, **environment}
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env))
        assert running[-1].stdout is not None
        line = next(line for line in running[-1].stdout if "://" in line)
        return running[-1], re.search(r"https?://\S+", line)[0]  # type: ignore[index]

    yield run
    for process in running:
        process.send_signal(signal.SIGINT)
        process.wait(60)
        assert process.stdout is not None
        process.stdout.close()


def test_each_start_without_users_prints_a_new_setup_link(start, shell, tmp_path):
    """A new start invalidates the earlier link. Only the owner can read the files. The audit log records the
    setup without the password.
    """
    folder = tmp_path / "data"
    first, old = start(folder, alone=True)
    first.send_signal(signal.SIGINT)
    first.wait(60)
    _, printed = start(folder)
    assert old.split("#")[1] != printed.split("#")[1]
    address, key = printed.split("/setup#")
    client = httpx2.Client(base_url=f"{address}/api", headers={"X-GSS": "1"}, timeout=30)
    assert client.get("/session").json()["set_up_needed"] is True
    body = {"token": old.split("#")[1], "name": "ann", "password": PASSWORD}
    assert client.post("/setup", json=body).status_code == 403
    made = client.post("/setup", json=body | {"token": key})
    assert (made.status_code, made.json()["role"]) == (200, "admin")
    assert client.get("/link").status_code == 200
    client.close()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    for path in folder.rglob("*"):
        assert not path.stat().st_mode & 0o077, path
    assert key not in "".join(path.read_text(errors="replace") for path in folder.glob("*") if path.is_file())
    exported = shell("audit", "export", "--data", str(folder)).stdout
    assert "session.set_up" in exported
    assert PASSWORD not in exported


def test_the_shell_creates_users_and_tokens_for_a_running_server(start, shell, tmp_path):
    """The shell adds users and tokens before the start and while the server runs. Revoked tokens and sessions
    with an old password end. A missing audit anchor is an error until it is accepted.
    """
    folder = tmp_path / "data"
    data = ["--data", str(folder)]
    added = shell("user", "add", "ann", "--role", "admin", "--password-stdin", *data, stdin=PASSWORD + "\n")
    assert (added.returncode, added.stdout) == (0, "ann is admin\n"), added.stderr
    short = shell("user", "add", "bob", "--role", "viewer", "--password-stdin", *data, stdin="short\n")
    assert (short.returncode, "Invalid password length" in short.stderr, "short" in short.stderr) == (2, True, False)
    _, address = start(folder)
    assert "setup" not in address
    key = shell("token", "add", "night", "--role", "viewer", "--days", "1", *data).stdout.strip()
    with httpx2.Client(base_url=f"{address}/api", timeout=30) as client:
        bearer = {"Authorization": f"Bearer {key}"}
        assert client.get("/link", headers=bearer).status_code == 200
        assert client.post("/link/close", headers=bearer).status_code == 403
        shell("token", "revoke", "night", *data)
        time.sleep(REMEMBERED_S)  # the server caches an identity for this time
        assert client.get("/link", headers=bearer).status_code == 401
        signed = client.post("/session", json={"name": "ann", "password": PASSWORD}, headers={"X-GSS": "1"})
        assert signed.status_code == 200
        assert shell("user", "disable", "ann", *data).returncode == 2, "the last admin"
        assert (
            shell("user", "password", "ann", "--password-stdin", *data, stdin="vega over the hills\n").returncode == 0
        )
        assert client.get("/link").status_code == 401
    whole = shell("audit", "verify", *data)
    assert (whole.returncode, "intact" in whole.stdout) == (0, True)
    assert "audit-anchor.jsonl confirms rows 1 to" in whole.stdout
    assert shell("audit", "verify", "--last-hash", "0" * 64, *data).returncode == 1
    (folder / "audit-anchor.jsonl").unlink()
    missing = shell("audit", "verify", *data)
    assert (missing.returncode, "gss audit accept" in missing.stderr) == (1, True)
    accepted = shell("audit", "accept", "--reason", "file removed in a test", *data)
    assert (accepted.returncode, "file removed in a test" in accepted.stdout) == (0, True)


def test_with_tls_files_the_server_speaks_https_and_sets_secure_cookies(start, tmp_path):
    """The server speaks HTTPS with the certificate and sets secure cookies. Plain HTTP gets no response."""
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    made = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "2",
    ]
    names = ["-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    subprocess.run([*made, "-keyout", key, "-out", certificate, *names], check=True, capture_output=True)
    _, printed = start(tmp_path / "data", GSS_TLS_CERTIFICATE=str(certificate), GSS_TLS_KEY=str(key))
    address, token = printed.split("/setup#")
    assert address.startswith("https://127.0.0.1:")
    trust = ssl.create_default_context(cafile=str(certificate))
    with httpx2.Client(base_url=address, verify=trust, timeout=30) as client:
        body = {"token": token, "name": "ann", "password": PASSWORD}
        reply = client.post("/api/setup", json=body, headers={"X-GSS": "1", "Origin": address})
        assert reply.status_code == 200, reply.text
        assert "Secure" in reply.headers["set-cookie"]
        assert "max-age" in reply.headers["strict-transport-security"]
        assert client.get("/api/link").status_code == 200
    with pytest.raises(httpx2.HTTPError):
        httpx2.get(address.replace("https", "http") + "/api/health", timeout=10)


@pytest.mark.parametrize(
    ("arguments", "addresses"),
    [
        (["--simulator", "cubestar", "--workers", "2"], ["/link"]),
        (
            ["--unit", "FM1=cubestar@simulator", "--unit", "EM-2=nos3@simulator"],
            ["/units/FM1/api/link", "/units/EM-2/api/link"],
        ),
    ],
    ids=["workers", "units"],
)
def test_workers_units_and_sensors_start_as_new_processes(start, shell, tmp_path, arguments, addresses):
    """Other tests fork these processes from a preloaded one. Here, each imports everything itself, the lines of all simulated
    sensors work, SIGINT ends all processes, and only the owner can read their files.
    """
    folder = tmp_path / "data"
    shell("user", "add", "ann", "--role", "admin", "--password-stdin", "--data", str(folder), stdin=PASSWORD + "\n")
    key = shell("token", "add", "night", "--role", "viewer", "--days", "1", "--data", str(folder)).stdout.strip()
    server, address = start(folder, *arguments, alone=True)
    base = address.split("/api")[0].rstrip("/")
    waiting, deadline = [a if a.startswith("/units") else f"/api{a}" for a in addresses], time.monotonic() + 150
    with httpx2.Client(base_url=base, headers={"Authorization": f"Bearer {key}"}, timeout=30) as client:
        while waiting and time.monotonic() < deadline:
            reply = client.get(waiting[0])
            if reply.status_code == 200 and reply.json()["rx"]["state"] == "up":
                waiting.pop(0)
            time.sleep(0.2)
    assert waiting == []
    started = _descendants(server.pid)
    assert len(started) >= 3
    server.send_signal(signal.SIGINT)
    assert server.wait(60) == 0
    deadline = time.monotonic() + 20
    while (left := [pid for pid in started if Path(f"/proc/{pid}").exists()]) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert left == []
    assert [path for path in (folder, *folder.rglob("*")) if path.stat().st_mode & 0o077] == []


def _descendants(pid: int) -> list[int]:
    """Return the processes that this process and its descendants started."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    own = [int(word) for task in tasks for word in (task / "children").read_text().split()]
    return own + [below for child in own for below in _descendants(child)]
