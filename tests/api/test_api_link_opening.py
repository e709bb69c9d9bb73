"""Opening a link to a peer that does not answer blocks only that request."""

from __future__ import annotations

import socket
import threading
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from fastapi.testclient import TestClient

OPENINGS = 45
"""Number of requests; more than the framework has request threads."""


@pytest.fixture
def silent_port() -> Iterator[str]:
    """RFC 2217 address of a port that accepts connections and never answers."""
    with socket.create_server(("127.0.0.1", 0), backlog=OPENINGS) as listener:
        yield f"rfc2217://127.0.0.1:{listener.getsockname()[1]}"


def test_hanging_openings_leave_every_other_route_answering(client: TestClient, silent_port: str) -> None:
    """Of many simultaneous requests to open a link one waits, and the others are rejected with a reason. Routes that
    need a thread answer meanwhile.
    """
    with ThreadPoolExecutor(OPENINGS) as threads:
        openings = [threads.submit(client.post, "/api/link/open", json={"url": silent_port}) for _ in range(OPENINGS)]
        for path in ("/api/link", "/api/commands", "/api/contacts", "/api/frames"):
            assert client.get(path).status_code == 200
        assert not all(opening.done() for opening in openings), "the routes answered only after the openings"
    answers = [opening.result() for opening in openings]
    counts = Counter(answer.status_code for answer in answers)
    assert set(counts) == {409, 503}, counts
    assert counts[409] > OPENINGS - 5
    rejected = next(answer.json() for answer in answers if answer.status_code == 409)
    assert (rejected["message"], bool(rejected["hint"])) == ("Another line is being opened.", True)
    assert client.post("/api/link/open", json={"url": "/dev/ttyNOWHERE"}).status_code == 404
    assert [thread for thread in threading.enumerate() if thread.name == "open link"] == []
