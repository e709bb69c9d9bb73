"""Limits of open event streams per user and in total. A rejected stream gets the reason, and existing streams
continue.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from gss.api.stream.broadcast import Broadcaster, wire
from gss.api.stream.route import EventStream
from gss.domain.errors import RateLimited
from gss.operations.metrics import StreamCounts


def test_each_user_and_all_together_have_a_limit():
    """A closed stream frees its place. Anonymous streams, such as those of workers, do not count against a user."""
    broadcaster = Broadcaster(StreamCounts(), each=2, most=3)
    first, _ = broadcaster.join("ann"), broadcaster.join("ann")
    with pytest.raises(RateLimited, match="at most 2 for one user"):
        broadcaster.join("ann")
    broadcaster.join("bob")
    with pytest.raises(RateLimited, match="at most 3 for all users"):
        broadcaster.join("eve")
    broadcaster.join()
    assert broadcaster.counts.refused == 2
    broadcaster.leave(first)
    broadcaster.join("")
    with pytest.raises(RateLimited):
        broadcaster.join("ann")


def test_one_stream_too_many_gets_429_with_a_retry_time():
    """The response is a problem document with a retry time, and no part of the stream is sent."""

    async def run() -> list[Any]:
        broadcaster, sent = Broadcaster(StreamCounts(), each=1), []
        broadcaster.newest = wire("link", {}, None)
        broadcaster.join("ann")

        async def send(message: Any) -> None:
            sent.append(message)

        async def receive() -> Any:
            return {"type": "http.request"}

        state: dict[str, Any] = {}
        await EventStream(None, broadcaster, name="ann")({"type": "http", "state": state}, receive, send)  # type: ignore[arg-type]
        assert "too many" in state["detail"]
        assert len(broadcaster) == 1
        return sent

    start, body = asyncio.run(run())
    assert start["status"] == 429
    assert dict(start["headers"])[b"retry-after"] == b"10"
    assert json.loads(body["body"])["message"] == "Too many open event streams."


def test_a_client_that_left_before_the_first_byte_does_not_count():
    """A disconnected client frees its place. Otherwise a few broken connections would block a user permanently."""

    async def run() -> int:
        broadcaster = Broadcaster(StreamCounts(), each=1)

        async def gone(_message: Any) -> None:
            raise OSError("gone")

        async def silent() -> Any:
            await asyncio.Event().wait()

        await EventStream(None, broadcaster, name="ann")({"type": "http", "state": {}}, silent, gone)  # type: ignore[arg-type]
        return len(broadcaster)

    assert asyncio.run(run()) == 0


def test_rejected_streams_are_counted_and_logged_once_a_minute(client):
    """Repeated rejections add one row to the audit log, and the metrics count every rejection."""
    broadcaster = client.app.state.broadcaster
    listeners = [broadcaster.join("ann") for _ in range(20)]
    try:
        before = len(client.get("/api/audit", params={"action": "route."}).json())
        assert [client.get("/api/stream").status_code for _ in range(4)] == [429] * 4
        assert client.post("/api/commands/abort").status_code != 429
        figures = client.get("/metrics").text
    finally:
        for listener in listeners:
            broadcaster.leave(listener)
    assert "gss_streams_refused_total 4" in figures
    rows = client.get("/api/audit", params={"action": "route."}).json()
    assert len(rows) == before + 1
    assert (rows[0]["who"], rows[0]["result"]) == ("ann", "denied")


@pytest.mark.parametrize("path", ["/api/frames/", "/api/link/", "/api/session/", "/help/"])
def test_a_trailing_slash_does_not_redirect(client, path):
    """The response is a 404 or the console page, because a redirect would reveal the address behind the proxy."""
    reply = client.get(path, headers={"Host": "localhost"}, follow_redirects=False)
    assert reply.status_code in (200, 404)
    assert "location" not in reply.headers
