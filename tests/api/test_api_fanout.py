"""The event stream's inside: bytes made once, mailboxes with an end, numbers that show every loss."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from gss.api.stream import route as stream
from gss.api.stream.fanout import MAILBOX, Fanout, Listener, Wire, unnumbered, wire
from gss.api.stream.presenter import Presenter
from gss.api.stream.route import EventStream, resumed_after
from gss.operations.clock import utc_now
from gss.operations.events import EventBus, StreamCounts
from gss.store.engine import Database, migrate, open_engine


@pytest.fixture
def bus(tmp_path) -> EventBus:
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    migrate(url)
    return EventBus(Database(open_engine(url)), utc_now)


class Connection:
    """An ASGI connection: collects what is sent, and hangs up when told."""

    def __init__(self, *, deaf: bool = False) -> None:
        self.sent: list[bytes] = []
        self.gone, self.hears = asyncio.Event(), asyncio.Event()
        if not deaf:
            self.hears.set()

    async def receive(self) -> dict[str, Any]:
        await self.gone.wait()
        return {"type": "http.disconnect"}

    async def send(self, message: Any) -> None:
        if "body" in message:
            await self.hears.wait()
        self.sent.append(message.get("body", b""))

    def messages(self) -> list[tuple[str, Any, str]]:
        """(topic, payload, id) of each."""
        found = []
        for block in b"".join(self.sent).decode().split("\n\n"):
            fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
            if fields:
                found.append((fields["event"], json.loads(fields["data"]), fields.get("id", "")))
        return found


@asynccontextmanager
async def presenting(bus: EventBus, fanout: Fanout) -> AsyncIterator[None]:
    stopping = threading.Event()
    presenter = Presenter(bus, fanout, stopping)
    presenter.start(asyncio.get_running_loop())
    yield
    stopping.set()
    await asyncio.to_thread(presenter.stop)


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(20):
        while not true():
            await asyncio.sleep(0.005)


def services(bus: EventBus) -> Any:
    return SimpleNamespace(bus=bus)


def follow(bus: EventBus, fanout: Fanout, connection: Connection, **given: Any) -> Awaitable[None]:
    fanout.newest = fanout.newest or wire("link", {"n": 0}, "0.0")
    answer = EventStream(services(bus), fanout, **given)
    return asyncio.create_task(answer({"type": "http"}, connection.receive, connection.send))


def test_all_listeners_share_the_bytes_of_a_message(bus):
    """A message is presented and written once; three mailboxes hold the same object."""

    async def run() -> None:
        fanout = Fanout(StreamCounts())
        listeners = [fanout.join() for _ in range(3)]
        async with presenting(bus, fanout):
            bus.publish("limits", {"set": "flight", "key": None})
            await until(lambda: listeners[0].ready.is_set())
            held = [listener.take()[0] for listener in listeners]
        assert [len(messages) for messages in held] == [1, 1, 1]
        assert held[0][0] is held[1][0] is held[2][0]
        assert held[0][0].data == b'event: limits\ndata: {"set":"flight","key":null}\nid: 0.1\n\n'

    asyncio.run(run())


def test_a_slow_listener_loses_the_oldest_and_no_one_else_does():
    """A mailbox ends at its number of messages and at its bytes; the loss is counted for this listener alone."""
    fanout = Fanout(StreamCounts())
    slow, quick = fanout.join(), fanout.join()
    for k in range(MAILBOX + 5):
        fanout.spread([Wire("x", b"%d" % k)])
        quick.take()
    messages, dropped = slow.take()
    assert (len(messages), dropped, messages[0].data) == (MAILBOX, 5, b"5")
    assert slow.take() == ([], 0)
    large = Listener()
    large.put(Wire("x", bytes(10 << 20)) for _ in range(3))
    assert [len(large.take()[0])] == [1]


def test_a_dropped_message_is_announced_on_its_connection(bus):
    """Who did not take what was sent hears how many messages are missing before the next one."""

    async def run() -> None:
        fanout, connection = Fanout(StreamCounts()), Connection(deaf=True)
        task = follow(bus, fanout, connection)
        await until(lambda: len(fanout) == 1)
        for k in range(MAILBOX + 7):
            fanout.spread([wire("limits", k, f"0.{k}")])
        connection.hears.set()
        await until(lambda: len(connection.messages()) > MAILBOX)
        connection.gone.set()
        await task
        told = connection.messages()
        assert told[:2] == [("link", {"n": 0}, ""), ("dropped", {"dropped": 7}, "")]
        assert [payload for topic, payload, _ in told if topic == "limits"] == list(range(7, MAILBOX + 7))
        assert fanout.counts.dropped == 7

    asyncio.run(run())


def test_events_of_many_threads_are_told_in_the_order_of_their_numbers(bus):
    """Whoever saw a number has seen all smaller ones, so that the number is enough to go on from."""

    async def run() -> None:
        fanout = Fanout(StreamCounts())
        listener = fanout.join()
        async with presenting(bus, fanout):
            threads = [
                threading.Thread(target=lambda: [bus.record("k", "ok", "text") for _ in range(10)]) for _ in range(4)
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                await asyncio.to_thread(thread.join)
            seen: list[int | None] = []
            while len(seen) < 40:
                await until(listener.ready.is_set)
                seen += [message.seq for message in listener.take()[0]]
        assert seen == list(range(1, 41))

    asyncio.run(run())


def test_who_comes_back_gets_every_recorded_event_once(bus, monkeypatch):
    """Pages of back-fill, then what happens: no event twice, none missing, whatever was recorded meanwhile."""
    monkeypatch.setattr(stream, "PAGE", 3)
    for k in range(8):
        bus.record("k", "ok", f"{k + 1}")

    async def run() -> None:
        fanout, connection = Fanout(StreamCounts()), Connection()
        async with presenting(bus, fanout):
            task = follow(bus, fanout, connection, after=resumed_after("2.99"))
            bus.record("k", "ok", "9")
            await until(lambda: any(topic == "link" for topic, _, _ in connection.messages()))
            bus.record("k", "ok", "10")
            await until(lambda: connection.messages()[-1][2] == "10")
            connection.gone.set()
            await task
        assert [payload["seq"] for topic, payload, _ in connection.messages() if topic == "event"] == [*range(3, 11)]

    asyncio.run(run())


def test_an_absence_longer_than_the_back_fill_is_told(bus, monkeypatch):
    """What is not sent again is announced with its number of events."""
    monkeypatch.setattr(stream, "PAGE", 2)
    monkeypatch.setattr(stream, "PAGES", 2)
    for _ in range(9):
        bus.record("k", "ok", "")

    async def run() -> None:
        fanout, connection = Fanout(StreamCounts()), Connection()
        task = follow(bus, fanout, connection, after=1)
        await until(lambda: len(connection.messages()) == 6)
        connection.gone.set()
        await task
        assert [m[2] for m in connection.messages()[:4]] == ["2", "3", "4", "5"]
        assert connection.messages()[4][:2] == ("dropped", {"dropped": 4})

    asyncio.run(run())


def test_a_stream_ends_when_its_session_does(bus):
    """The session is looked at while the stream lives; its end is said, and nothing comes after it."""

    async def run() -> None:
        fanout, connection = Fanout(StreamCounts()), Connection()
        await follow(bus, fanout, connection, valid=lambda: "signed out")
        assert connection.messages()[-1][:2] == ("session", {"ended": "signed out"})
        assert len(fanout) == 0

    asyncio.run(run())


def test_a_server_that_stops_lets_every_stream_end(bus):
    """Connections end by themselves, and those that come too late end at once."""

    async def run() -> None:
        fanout, connection, late = Fanout(StreamCounts()), Connection(), Connection()
        task = follow(bus, fanout, connection)
        await until(lambda: len(fanout) == 1)
        fanout.close()
        await asyncio.wait_for(task, 10)
        await asyncio.wait_for(follow(bus, fanout, late), 10)

    asyncio.run(run())


def test_numbers_are_read_in_both_forms_and_nothing_else_is():
    """``12`` and ``12.345`` go on after event 12; any other text is as if nothing had been sent."""
    assert [resumed_after(text) for text in ("12", "12.345", "", "x", "-1", "1e3", "²", "9" * 40)] == [12, 12] + [
        None
    ] * 6
    assert unnumbered(wire("x", {"id": "a"}, "7.1")) == b'event: x\ndata: {"id":"a"}\n\n'
