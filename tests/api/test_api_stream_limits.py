"""How many event streams may be open: of one name, and of all; the next one hears why not, and everything else goes on."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from gss.api.stream.fanout import Fanout, wire
from gss.api.stream.route import EventStream
from gss.domain.errors import TooOften
from gss.operations.events import StreamCounts


def test_each_name_and_all_together_have_a_limit():
    """Who left makes room; nobody in particular, as a worker's own stream, is not counted against a name."""
    fanout = Fanout(StreamCounts(), each=2, most=3)
    first, _ = fanout.join("ann"), fanout.join("ann")
    with pytest.raises(TooOften, match="at most 2 of one user"):
        fanout.join("ann")
    fanout.join("bob")
    with pytest.raises(TooOften, match="at most 3 of everybody"):
        fanout.join("eve")
    fanout.join()
    assert fanout.counts.refused == 2
    fanout.leave(first)
    fanout.join("")
    with pytest.raises(TooOften):
        fanout.join("ann")


def test_one_too_many_is_answered_with_429_and_when_to_come_again():
    """The answer is a problem as every other, and nothing of a stream was begun."""

    async def run() -> list[Any]:
        fanout, sent = Fanout(StreamCounts(), each=1), []
        fanout.newest = wire("link", {}, None)
        fanout.join("ann")

        async def send(message: Any) -> None:
            sent.append(message)

        async def receive() -> Any:
            return {"type": "http.request"}

        state: dict[str, Any] = {}
        await EventStream(None, fanout, name="ann")({"type": "http", "state": state}, receive, send)  # type: ignore[arg-type]
        assert "too many" in state["detail"]
        assert len(fanout) == 1
        return sent

    start, body = asyncio.run(run())
    assert start["status"] == 429
    assert dict(start["headers"])[b"retry-after"] == b"10"
    assert json.loads(body["body"])["message"] == "too many event streams are open"


def test_who_is_gone_before_the_first_byte_does_not_count():
    """Else a few broken connections would keep somebody out for good."""

    async def run() -> int:
        fanout = Fanout(StreamCounts(), each=1)

        async def gone(_message: Any) -> None:
            raise OSError("gone")

        async def silent() -> Any:
            await asyncio.Event().wait()

        await EventStream(None, fanout, name="ann")({"type": "http", "state": {}}, silent, gone)  # type: ignore[arg-type]
        return len(fanout)

    assert asyncio.run(run()) == 0


def test_refused_streams_are_counted_and_written_once_a_minute(client):
    """A page that tries again and again fills neither the record nor the log of denials; the figure tells how often."""
    fanout = client.app.state.fanout
    listeners = [fanout.join("ann") for _ in range(20)]
    try:
        before = len(client.get("/api/audit", params={"action": "route."}).json())
        assert [client.get("/api/stream").status_code for _ in range(4)] == [429] * 4
        assert client.post("/api/commands/abort").status_code != 429
        figures = client.get("/metrics").text
    finally:
        for listener in listeners:
            fanout.leave(listener)
    assert "gss_streams_refused_total 4" in figures
    rows = client.get("/api/audit", params={"action": "route."}).json()
    assert len(rows) == before + 1
    assert (rows[0]["who"], rows[0]["result"]) == ("ann", "denied")


@pytest.mark.parametrize("path", ["/api/frames/", "/api/link/", "/api/session/", "/help/"])
def test_a_slash_too_many_leads_nowhere_else(client, path):
    """A redirect would name the address behind the proxy; it is not found, or the page that the pages' own script knows."""
    reply = client.get(path, headers={"Host": "localhost"}, follow_redirects=False)
    assert reply.status_code in (200, 404)
    assert "location" not in reply.headers
