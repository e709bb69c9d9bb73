"""Requests that no browser sends, byte for byte, against a real server: traversal, header injection, smuggling, floods of bytes.

SECURITY.md lists these classes with the date of the last run.
"""

from __future__ import annotations

from collections.abc import Iterator

import httpx2
import pytest

from tools.hostile_requests import REQUESTS, UNANSWERED, answers, check_harmless, statuses
from tools.served import Served, served

pytestmark = pytest.mark.timeout(400)


@pytest.fixture(scope="module", params=[(), ("--workers", "1")], ids=["one process", "a worker"])
def server(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Server that receives all requests of this file."""
    with served(tmp_path_factory.mktemp("attacked") / "data", *request.param) as server:
        yield server


@pytest.mark.parametrize("name", REQUESTS)
def test_a_hostile_request_is_rejected_or_harmless(server: Served, name: str) -> None:
    """The response contains no file of the host and no injected header. No second request and no other protocol
    is served.
    """
    received = answers(server.host_and_port, REQUESTS[name])
    check_harmless(name, received)
    codes = statuses(received)
    assert codes or name in UNANSWERED
    if codes and codes[0] < 300:
        assert b"content-security-policy" in received.partition(b"\r\n\r\n")[0].lower()


def test_the_server_still_works_afterwards(server: Served) -> None:
    """After all requests the server answers an admin and ABORT, and its log has no traceback."""
    with httpx2.Client(base_url=f"{server.address}/api", headers=server.headers, timeout=30) as client:
        assert client.get("/link").status_code == 200
        assert client.post("/commands/abort").status_code == 409
        assert client.get("/audit/verify").json()["problem"] == ""
    assert "Traceback" not in server.log(), server.log()[-3000:]
