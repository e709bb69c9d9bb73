"""Server and sensor are killed, and the line is disconnected, at every stage of transfers, commands and jobs: the content
arrives completely, no command is repeated, and states are correct.

A proxy between server and sensor reads every packet and can stop the data at a given one, so that a test kills a process
at a known stage.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import signal
import socket
import sqlite3
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gss.device.protocol.codec import decode
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.instruments.dictionary.read_dictionary import load_dictionary

pytestmark = pytest.mark.timeout(240)

DICTIONARY = load_dictionary()
SERVICES = {service.code: service.name for service in DICTIONARY.services if service.packet == "transfer"}
UP, DOWN = "up", "down"


def name_of(packet: Packet) -> str:
    if packet.type is PacketType.TRANSFER:
        return SERVICES[packet.code]
    if packet.type is PacketType.COMMAND:
        return DICTIONARY.command_of_code(packet.code).name
    return packet.type.name


class Tap:
    """Proxy on the line. ``hold``: direction and name of the packet that is held, and the number of such packets that pass
    first. ``held`` is set when a packet is held."""

    def __init__(self, sensor_port: Callable[[], int]) -> None:
        self._sensor_port = sensor_port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self.hold: tuple[str, str, int] | None = None
        self.held = threading.Event()
        self.packets: list[tuple[str, str, int, bytes]] = []
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                server, _ = self._listener.accept()
            except OSError:
                return
            sensor = self._connect()
            if sensor is None:
                server.close()
                continue
            self._open = [server, sensor]
            pumps = [
                threading.Thread(target=self._pump, args=(a, b, way), daemon=True)
                for a, b, way in ((server, sensor, UP), (sensor, server, DOWN))
            ]
            for pump in pumps:
                pump.start()
            for pump in pumps:
                pump.join()

    def _connect(self) -> socket.socket | None:
        try:
            return socket.create_connection(("127.0.0.1", self._sensor_port()), timeout=5)
        except OSError:
            return None

    def _pump(self, source: socket.socket, sink: socket.socket, way: str) -> None:
        receiver = LineReceiver(from_device=way == DOWN)
        try:
            while data := source.recv(4096):
                for packet in receiver.feed(data):
                    self.packets.append((way, name_of(packet), packet.request_id, packet.payload))
                    self._look(way, name_of(packet))
                if not (self.held.is_set() and self.hold and self.hold[0] == way):
                    sink.sendall(data)
        except OSError:
            pass
        finally:
            source.close()
            sink.close()

    def _look(self, way: str, name: str) -> None:
        """Drop the held packet and all data after it in its direction."""
        if self.hold is None or self.held.is_set() or (way, name) != self.hold[:2]:
            return
        if self.hold[2] > 0:
            self.hold = (way, name, self.hold[2] - 1)
        else:
            self.held.set()

    def wait(self) -> None:
        assert self.held.wait(30), f"{self.hold} did not arrive"

    def release(self) -> None:
        self.hold = None
        self.held.clear()

    def pull(self) -> None:
        """Disconnect and reconnect the line. Both ends detect it, and data in transit is lost."""
        for end in self._open:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self.release()

    def close(self) -> None:
        self._listener.close()
        for end in self._open:
            end.close()


@pytest.fixture
def tap(sensor) -> Iterator[Tap]:
    made = Tap(lambda: sensor.port)
    yield made
    made.close()


def online(console):
    return console.wait("the sensor", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)


def build(console, name: str, faint_mag: float) -> int:
    """Build a catalogue of the whole sky on the server and return its id."""
    body = {"name": name, "profile": "cubestar", "format": "cubestar", "faint_mag": faint_mag, "orbit": "none"}
    job = console.post("/catalogues", body, status=202)
    done = console.wait("the catalogue", lambda: _ended(console.get("/jobs"), job["id"]))
    return done["result"]["catalogue_id"]


def _ended(jobs, job_id):
    return next((j for j in jobs if j["id"] == job_id and j["state"] == "done"), None)


def ended(console, transfer_id: int, state: str):
    """Wait until the transfer has this state and return it. Fails if the transfer fails or is aborted."""

    def look():
        row = console.get(f"/transfers/{transfer_id}")
        assert row["state"] not in ("failed", "aborted"), row["reason"]
        return row if row["state"] == state else None

    return console.wait(f"the transfer to be {state}", look, 40)


def failed(console, transfer_id: int):
    """Wait until the transfer has failed and return it."""

    def look():
        row = console.get(f"/transfers/{transfer_id}")
        return row if row["state"] == "failed" else None

    return console.wait("the transfer to fail", look, 40)


UPLOAD_POINTS = {
    "opening": (UP, "OPEN_UPLOAD", 0),
    "transferring": (UP, "CHUNK", 8),
    "verifying": (UP, "VERIFY", 0),
    "before commit": (UP, "COMMIT", 0),
    "after commit": (DOWN, "COMMITTED", 0),
}
DOWNLOAD_POINTS = {"opening": (UP, "OPEN_DOWNLOAD", 0), "transferring": (DOWN, "CHUNK", 120)}
ALL_SENT = ("verifying", "before commit", "after commit")
"""Stages at which the device has received the whole upload."""
SENSOR_STAGES = ("transferring", "verifying", "after commit")
"""Stages that differ for a sensor: chunks are missing, all chunks are in flash, or the upload is committed."""


def hold_at(tap: Tap, point: tuple[str, str, int]) -> None:
    tap.held.clear()
    tap.hold = point


def commands_sent(tap: Tap) -> Counter:
    """Count the transmissions of each command that must not be repeated, by name and request id."""
    risky = {c.name for c in DICTIONARY.commands if not c.idempotent}
    return Counter((name, request_id) for way, name, request_id, _ in tap.packets if way == UP and name in risky)


def chunk_bytes(tap: Tap, way: str, since: int) -> int:
    """Return the bytes of content sent in one direction after the first ``since`` packets."""
    layout = DICTIONARY.service("CHUNK").fields
    seen = [p for w, name, _, p in tap.packets[since:] if (w, name) == (way, "CHUNK")]
    return sum(len(decode(layout, payload).values["data"]) for payload in seen)


def bank_content(folder: Path, bank: str, size: int) -> bytes:
    """Return the content of a bank in the simulator's flash file."""
    order = ("A", "B", "C", "golden")
    cells = (folder / "flash.bin").read_bytes()
    bank_bytes = 192 * 1024
    start = order.index(bank) * bank_bytes
    return cells[start : start + size]


def held_upload(console, tap: Tap, stage: str) -> tuple[int, str]:
    """Start the upload of a new catalogue and hold it at a stage. Return the id of the transfer and the hash of the content."""
    catalogue = build(console, stage, 3.0 + 0.1 * list(UPLOAD_POINTS).index(stage))
    content = console.get(f"/catalogues/{catalogue}")["sha256"]
    hold_at(tap, UPLOAD_POINTS[stage])
    transfer = console.post(f"/catalogues/{catalogue}/upload", {"bank": "B"})
    tap.wait()
    return transfer["id"], content


def arrived(console, transfer_id: int, content: str, sensor):
    """Wait until the upload is committed, check the content in flash, and return the transfer."""
    end = ended(console, transfer_id, "committed")
    assert end["sha256"] == content
    assert hashlib.sha256(bank_content(sensor.folder, "B", end["size"])).hexdigest() == content
    return end


def test_server_killed_at_any_stage_of_an_upload(serve, sensor, tap):
    """The next server finds the transfer paused by the restart, continues with the chunks on board, and commits."""
    server = serve("--device", tap.url)
    online(server.console)
    for stage in UPLOAD_POINTS:
        transfer, content = held_upload(server.console, tap, stage)
        server.kill()
        tap.release()
        mark = len(tap.packets)

        server = serve("--device", tap.url)
        end = arrived(server.console, transfer, content, sensor)
        assert any("the server restarted" in line for line in end["log"]), end["log"]
        again = chunk_bytes(tap, UP, mark)
        if stage in ALL_SENT:
            assert again == 0, f"{stage}: {again} B were sent although the device held all"
        elif stage == "transferring":
            assert 0 < again < end["size"], stage
    assert max(commands_sent(tap).values(), default=0) <= 1
    assert len([t for t in server.console.get("/transfers", limit=100) if t["direction"] == "up"]) == len(UPLOAD_POINTS)


def test_server_killed_at_any_stage_of_a_download(serve, sensor, tap):
    """Received content is on the server's disk and is not sent again. The frame is complete and stored once."""
    server = serve("--device", tap.url)
    online(server.console)
    # The server first reads the catalogue of the active bank, which is a download too.
    server.console.wait("the bank", lambda: (server.console.get("/link")["active_bank"] or {}).get("catalogue_id"))
    for stage, point in DOWNLOAD_POINTS.items():
        hold_at(tap, point)
        if stage == "transferring":
            tap.hold = (DOWN, "CHUNK", 300)
        number = server.console.command("TAKE_IMAGE")["values"]["frame_number"]
        tap.wait()
        transfer = server.console.get("/transfers")[0]
        assert transfer["kind"] == "frame"
        time.sleep(2.2 if stage == "transferring" else 0)  # progress is stored every two seconds
        server.kill()
        tap.release()
        mark = len(tap.packets)

        server = serve("--device", tap.url)
        end = ended(server.console, transfer["id"], "verified")
        frame = server.console.get(f"/frames/{end['frame_id']}")
        assert (frame["complete"], frame["number"], frame["sha256"]) == (True, number, end["sha256"])
        assert frame["exposure_s"] is not None
        again = chunk_bytes(tap, DOWN, mark)
        assert again < (0.6 if stage == "transferring" else 1.1) * end["size"], stage
    frames = server.console.get("/frames")["frames"]
    assert len({f["number"] for f in frames if f["complete"]}) == len([f for f in frames if f["complete"]]) == 2
    assert max(commands_sent(tap).values()) == 1


def test_sensor_killed_at_any_stage_of_an_upload(serve, sensor, tap):
    """Flash keeps its content: the transfer waits for the sensor, sends the remaining chunks, and commits."""
    server = serve("--device", tap.url)
    online(server.console)
    for stage in SENSOR_STAGES:
        transfer, content = held_upload(server.console, tap, stage)
        sensor.kill()
        tap.release()
        mark = len(tap.packets)
        sensor.start()
        end = arrived(server.console, transfer, content, sensor)
        assert any("link lost" in line for line in end["log"]), end["log"]
        if stage in ALL_SENT:
            assert chunk_bytes(tap, UP, mark) < 0.5 * end["size"], stage
    assert max(commands_sent(tap).values(), default=0) <= 1


def test_sensor_killed_during_a_frame_download(serve, sensor, tap):
    """Image memory is lost: the transfer fails with the reason, received rows are stored as a frame with missing rows."""
    server = serve("--device", tap.url)
    online(server.console)
    # The server first reads the catalogue of the active bank, which is a download too.
    server.console.wait("the bank", lambda: (server.console.get("/link")["active_bank"] or {}).get("catalogue_id"))
    for stage, point in DOWNLOAD_POINTS.items():
        hold_at(tap, point)
        server.console.command("TAKE_IMAGE")
        tap.wait()
        transfer = server.console.get("/transfers")[0]
        sensor.kill()
        tap.release()
        sensor.start()
        end = failed(server.console, transfer["id"])
        assert "no_image" in end["reason"]
        if stage == "transferring":
            frame = server.console.get(f"/frames/{end['frame_id']}")
            assert not frame["complete"]
            assert 0 < sum(last - first + 1 for first, last in frame["rows_held"]) < frame["rows"]
    assert max(commands_sent(tap).values()) == 1


def test_line_disconnected_at_any_stage_of_an_upload_and_of_a_download(serve, sensor, tap):
    """Disconnected and connected again: each transfer continues automatically and completes; no command is repeated."""
    server = serve("--device", tap.url)
    online(server.console)
    for stage in UPLOAD_POINTS:
        transfer, content = held_upload(server.console, tap, stage)
        mark = len(tap.packets)
        tap.pull()
        end = arrived(server.console, transfer, content, sensor)
        if stage in ALL_SENT:
            assert chunk_bytes(tap, UP, mark) == 0, stage
    for stage, point in DOWNLOAD_POINTS.items():
        online(server.console)
        hold_at(tap, point)
        number = server.console.command("TAKE_IMAGE")["values"]["frame_number"]
        tap.wait()
        transfer = server.console.get("/transfers")[0]
        tap.pull()
        end = ended(server.console, transfer["id"], "verified")
        frame = server.console.get(f"/frames/{end['frame_id']}")
        assert (frame["complete"], frame["number"], frame["sha256"]) == (True, number, end["sha256"]), stage
    assert max(commands_sent(tap).values()) == 1


COMMAND_POINTS = {
    "on its way": (UP, "TAKE_IMAGE", 0),
    "accepted": (DOWN, "REPORT", 0),
    "started": (DOWN, "REPORT", 1),
    "ended on board": (DOWN, "REPORT", 2),
}
SIMULATOR = "gss.device.simulator"
WITH_JOBS = ("on its way", "ended on board")
"""Stages at which a job runs and another one waits."""
EXPERIMENTS = {"names": ["moniteq-2-1", "liebe-2", "huffman-5-1"], "trials": 20, "seed": 3}


def end_of(console, job_id: int):
    """Wait until the job is done and return it. Fails if the job fails or is cancelled."""

    def look():
        job = console.get(f"/jobs/{job_id}")
        assert job["state"] not in ("failed", "cancelled"), job["text"]
        return job if job["state"] == "done" else None

    return console.wait("the job to end", look, 60)


def test_server_killed_at_each_state_of_a_command_and_of_a_job(serve, sensor, tap, tmp_path):
    """A command's result becomes unknown or is read from a late report, and it is never resent; queued or running jobs
    continue automatically with the results of an uninterrupted run.
    """
    server = serve("--device", tap.url)
    online(server.console)
    whole = end_of(server.console, server.console.post("/campaigns/experiments", EXPERIMENTS)["id"])["result"]
    left: list[int] = []
    for stage, point in COMMAND_POINTS.items():
        if stage in WITH_JOBS:
            running = server.console.post("/campaigns/experiments", EXPERIMENTS)["id"]
            left += [running, server.console.post("/admin/backups", status=202)["id"]]
            console = server.console
            console.wait("a chunk", lambda c=console, job=running: c.get(f"/jobs/{job}")["done"] >= 100)
        hold_at(tap, point)
        sent = server.console.post("/commands", {"name": "TAKE_IMAGE", "arguments": {"exposure_ms": 20}})
        tap.wait()
        server.kill()
        if stage in WITH_JOBS:
            kept = job_row(tmp_path / "data" / "gss.db", running)
            assert (kept["state"], kept["chunks"] >= 1) == ("running", True), stage
        tap.release()
        server = serve("--device", tap.url)
        online(server.console)
        row = server.console.get(f"/commands/{sent['id']}")
        assert row["result"] in ("unknown", "completed"), stage
        if row["result"] == "unknown":
            server.console.post(f"/commands/{row['id']}/resolve", {"note": "checked the frames"}, status=200)
        if stage in WITH_JOBS:
            assert end_of(server.console, running)["result"] == whole, stage
    names = [end_of(server.console, job)["result"].get("name") for job in left[1::2]]
    assert sorted(names) == sorted(made["name"] for made in server.console.get("/admin/backups"))
    assert max(commands_sent(tap).values()) == 1


def job_row(path: Path, job_id: int) -> dict:
    """Return the state of a job, and its number of completed chunks, from the database of a killed server."""
    with sqlite3.connect(path) as connection:
        state, checkpoint = connection.execute("SELECT state, checkpoint FROM jobs WHERE id = ?", (job_id,)).fetchone()
    connection.close()
    return {"state": state, "chunks": len(json.loads(checkpoint or "{}").get("experiments", []))}


def test_a_killed_simulator_is_started_again_by_the_server(serve, tmp_path, signed_in):
    """After kill -9 of the simulator, twice, the server starts it again with its flash and it answers. A server on a restored
    backup has the same frames."""
    server = serve("--simulator", "cubestar")
    online(server.console)
    frame = server.console.command("TAKE_IMAGE")["values"]["frame_number"]
    server.console.wait("the frame", lambda: server.console.get("/frames")["frames"])
    for _ in range(2):
        (child,) = children(server.process.pid, SIMULATOR)
        os.kill(child, signal.SIGKILL)
        others = ([], [child])
        server.console.wait("another", lambda not_=others: children(server.process.pid, SIMULATOR) not in not_)
        server.console.wait("the line", lambda: server.console.get("/link")["connected"])
        online(server.console)
        assert server.console.command("GET_STATUS")["result"] == "completed"
    texts = [event["text"] for event in server.console.get("/events", limit=200)]
    assert len([t for t in texts if "simulated sensor ended with code -9" in t]) == 2
    made = end_of(server.console, server.console.post("/admin/backups", status=202)["id"])["result"]["name"]
    frames = server.console.get("/frames")["frames"]
    assert [f["number"] for f in frames] == [frame]
    server.stop()

    from gss.cli import main

    shutil.move(tmp_path / "data", tmp_path / "lost")
    assert main(["restore", str(tmp_path / "lost" / "backups" / made), "--into", str(tmp_path / "data")]) == 0
    before, server.console.headers = server.console.headers, signed_in(tmp_path / "data")
    back = serve()
    old = back.console.http.get("/frames", headers=before)
    assert old.status_code == 401, "a session from the backup is still valid"
    assert [(f["id"], f["sha256"]) for f in back.console.get("/frames")["frames"]] == [
        (f["id"], f["sha256"]) for f in frames
    ]
    assert back.console.http.get(f"/frames/{frames[0]['id']}/image.png").status_code == 200
    report = end_of(back.console, back.console.post("/admin/check-store", status=202)["id"])["result"]
    assert report["whole"], report["findings"]


def children(pid: int, words: str) -> list[int]:
    """Return the running child processes whose command line contains these words."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and words in (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode():
                found.append(int(folder.name))
    return found
