"""The event stream as a browser reads it, and the shell beside the server."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from typing import Any

import pytest

pytestmark = pytest.mark.timeout(240)


def read_stream(console: Any, seen: dict[str, list], last_event_id: str, enough: threading.Event) -> None:
    """Collect messages by topic, as an EventSource does, until every expected topic was received."""
    import httpx2

    headers = console.headers | ({"Last-Event-ID": last_event_id} if last_event_id else {})
    with httpx2.stream("GET", f"{console.address}/api/stream", headers=headers, timeout=60) as reply:
        kind = ""
        for line in reply.iter_lines():
            if line.startswith("event:"):
                kind = line[6:].strip()
            elif line.startswith("data:"):
                seen.setdefault(kind, []).append(json.loads(line[5:]))
            if {"link", "telemetry", "command", "frame", "solution", "transfer", "event"} <= set(seen):
                enough.set()
                return


def test_stream_reports_every_event_and_resumes(serve):
    """The stream resumes after an event number and reports commands, transfers, frames and solutions."""
    console = serve("--simulator", "cubestar").console
    console.wait("the sensor", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)
    seen: dict[str, list] = {}
    enough = threading.Event()
    reader = threading.Thread(target=read_stream, args=(console, seen, "1", enough), daemon=True)
    reader.start()
    console.wait("the stream", lambda: "link" in seen)
    assert seen["event"][0]["seq"] == 2, "resumed after event 1"
    console.command("TAKE_IMAGE")
    assert enough.wait(60), f"only {sorted(seen)}"
    reader.join(10)
    results = [c["result"] for c in seen["command"] if c["name"] == "TAKE_IMAGE"]
    assert results == sorted(results, key=["queued", "released", "sent", "accepted", "started", "completed"].index)
    assert seen["transfer"][-1]["size"] == 512 * 1024
    assert seen["solution"][0]["outcome"] == "solved"


def gss(*arguments: str) -> subprocess.CompletedProcess:
    """Run the command line."""
    return subprocess.run([sys.executable, "-m", "gss", *arguments], capture_output=True, text=True, timeout=120)


def test_shell_builds_a_catalogue_and_gives_it_to_the_device(simulator, tmp_path):
    """The shell builds a catalogue and uploads and activates it on the port. An upload to the active bank is
    rejected.
    """
    image = tmp_path / "bank.img"
    built = gss("catalogue", "build", "--profile", "cubestar", "--mag-limit", "3.5", "--out", str(image), "--json")
    assert built.returncode == 0, built.stderr
    sent = gss("catalogue", "upload", str(image), "--device", simulator, "--bank", "A", "--activate", "--json")
    assert sent.returncode == 0, sent.stderr
    facts = json.loads(sent.stdout)
    assert (facts["active"], facts["sha256"]) == (True, json.loads(built.stdout)["sha256"])
    refused = gss("catalogue", "upload", str(image), "--device", simulator, "--bank", "A")
    assert refused.returncode == 2
    assert "active" in refused.stderr


def test_shell_refuses_what_the_device_cannot_take(simulator, tmp_path):
    """Another camera's catalogue, a damaged file, an unknown bank and a silent port each give one clear message."""
    image = tmp_path / "sunsat.img"
    assert gss("catalogue", "build", "--profile", "sunsat", "--mag-limit", "4", "--out", str(image)).returncode == 0
    other = gss("catalogue", "upload", str(image), "--device", simulator, "--bank", "A")
    assert (other.returncode, "another camera" in other.stderr) == (2, True)
    damaged = tmp_path / "damaged.img"
    damaged.write_bytes(b"GSSB" + image.read_bytes()[4:40])
    assert gss("catalogue", "upload", str(damaged), "--device", simulator, "--bank", "A").returncode in (1, 2)
    assert "A | B | C" in gss("catalogue", "upload", str(image), "--device", simulator, "--bank", "Z").stderr
    assert gss("catalogue", "upload", str(image), "--device", "socket://127.0.0.1:1", "--bank", "A").returncode == 1
