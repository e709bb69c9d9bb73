"""Uploads that could block the server or fill its memory are rejected, and ABORT works meanwhile."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from PIL import Image

from gss.operations.parsing.parse_processes import ParsingQueue
from gss.operations.parsing.parse_worker import ParseLimits

LISTS = [
    "unit.ecsv",
    "brackets.csv",
    "value.csv",
    "epoch.csv",
    "columns.vot",
    "wide.vot",
    "rows.vot",
    "columns.fits",
    "nested-line.ecsv",
]
FRAMES = ["planes.fits"]
"""Hostile frames. tests/cli reads more files of these formats in the same child processes."""
MAPPING = '{"epoch_jyear": 2000, "frame": "icrs"}'
BOUND_S = ParseLimits().wall_s + 5


@pytest.fixture
def admin(clients: dict[str, TestClient]) -> TestClient:
    """A client with all permissions."""
    return clients["admin"]


def send(client: TestClient, name: str, data: bytes) -> Any:
    """Upload a frame or star list. The mapping states the epoch, except for the file that tests epochs."""
    if name in FRAMES or name.endswith(".png"):
        return client.post("/api/frames/import", files={"file": (name, data)})
    form = {} if name == "epoch.csv" else {"mapping": MAPPING}
    return client.post("/api/catalogues/sources", files={"file": (name, data)}, data=form)


@pytest.mark.parametrize("name", [*LISTS, *FRAMES])
def test_a_hostile_file_is_rejected_while_abort_works(admin: TestClient, hostile: ModuleType, name: str) -> None:
    """The server rejects the file with the expected form within the time limit and answers ABORT and health
    meanwhile.
    """
    data, replies, began_s = hostile.content(name), [], time.monotonic()
    upload = threading.Thread(target=lambda: replies.append(send(admin, name, data)))
    upload.start()
    while True:
        uploading = upload.is_alive()
        requested_s = time.monotonic()
        assert admin.post("/api/commands/abort").status_code == 409  # the link is down
        assert admin.get("/api/health").status_code in (200, 503)
        assert time.monotonic() - requested_s < 10
        if not uploading:
            break
        upload.join(0.05)
    assert time.monotonic() - began_s < BOUND_S
    assert replies[0].status_code in (400, 409, 413, 422), replies[0].text
    assert all(replies[0].json()[part] for part in ("message", "expected", "got"))


def test_a_comment_of_blanks_is_read(admin: TestClient, hostile: ModuleType) -> None:
    """A comment with 40 000 blanks does not delay parsing; the list below it is read."""
    reply = send(admin, "blanks.csv", hostile.content("blanks.csv"))
    assert (reply.status_code, reply.json()["stars"]) == (201, 24)


def test_uploads_beyond_the_limit_are_rejected(app: FastAPI, admin: TestClient) -> None:
    """While every parser is in use, an upload is a 503 with the time to retry, and ABORT works."""
    places = app.state.services.base.parsing._places
    count = ParsingQueue().at_once + ParsingQueue().waiting
    taken = [places.acquire(blocking=False) for _ in range(count)]
    try:
        reply = send(admin, "a.csv", b"id,ra,dec,v\n1,2,3,4\n")
        assert (reply.status_code, reply.json()["message"]) == (503, "The server is reading other files.")
        assert int(reply.headers["retry-after"]) > 0
        assert admin.post("/api/commands/abort").status_code == 409
    finally:
        for _ in filter(None, taken):
            places.release()
    assert sum(taken) == count


def test_a_frame_is_unchanged_by_the_child_process(app: FastAPI, admin: TestClient) -> None:
    """The stored pixels of an imported picture equal those of the file."""
    pixels = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    reply = send(admin, "a.png", file.getvalue())
    assert reply.status_code == 201, reply.text
    frames = app.state.services.frames.frames
    assert (frames.pixels(frames.get(reply.json()["id"])) == pixels).all()


def test_stopping_the_server_ends_the_reading(
    app_of: Callable[..., FastAPI], signed_in: Callable[..., dict[str, str]], hostile: ModuleType
) -> None:
    """A stopping server rejects a file instead of reading it."""
    app = app_of({})
    headers = signed_in(app.state.services, "admin", "ann")
    client = TestClient(app, base_url="http://localhost", headers=headers, raise_server_exceptions=False)
    app.state.services.announce_stop()
    assert send(client, "blanks.csv", hostile.content("blanks.csv")).status_code == 503
