"""Internals of the event stream: messages are encoded once, queues are bounded, and event numbers reveal every loss."""

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
from gss.api.stream.broadcast import MAX_QUEUED, Broadcaster, Listener, Presenter, Wire, unnumbered, wire
from gss.api.stream.route import EventStream, resumed_after
from gss.operations.clock import utc_now
from gss.operations.events import EventBus
from gss.operations.metrics import StreamCounts
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate


@pytest.fixture
def bus(tmp_path) -> EventBus:
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    migrate(url)
    return EventBus(Database(open_engine(url)), utc_now)


class Connection:
    """An ASGI connection that collects sent messages and disconnects on demand."""

    def __init__(self, *, blocked: bool = False) -> None:
        self.sent: list[bytes] = []
        self.gone, self.accepts = asyncio.Event(), asyncio.Event()
        if not blocked:
            self.accepts.set()

    async def receive(self) -> dict[str, Any]:
        await self.gone.wait()
        return {"type": "http.disconnect"}

    async def send(self, message: Any) -> None:
        if "body" in message:
            await self.accepts.wait()
        self.sent.append(message.get("body", b""))

    def messages(self) -> list[tuple[str, Any, str]]:
        """Return (topic, payload, id) of each message."""
        messages = []
        for block in b"".join(self.sent).decode().split("\n\n"):
            fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
            if fields:
                messages.append((fields["event"], json.loads(fields["data"]), fields.get("id", "")))
        return messages


@asynccontextmanager
async def running_presenter(bus: EventBus, broadcaster: Broadcaster) -> AsyncIterator[None]:
    stopping = threading.Event()
    presenter = Presenter(bus, broadcaster, stopping)
    presenter.start(asyncio.get_running_loop())
    yield
    stopping.set()
    await asyncio.to_thread(presenter.stop)


async def wait_until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(20):
        while not condition():
            await asyncio.sleep(0.005)


def services(bus: EventBus) -> Any:
    return SimpleNamespace(base=SimpleNamespace(bus=bus))


def start_stream(bus: EventBus, broadcaster: Broadcaster, connection: Connection, **options: Any) -> Awaitable[None]:
    broadcaster.newest = broadcaster.newest or wire("link", {"n": 0}, "0.0")
    event_stream = EventStream(services(bus), broadcaster, **options)
    return asyncio.create_task(event_stream({"type": "http"}, connection.receive, connection.send))


def test_all_subscribers_share_the_bytes_of_a_message(bus):
    """A message is encoded once, and the queues of three subscribers contain the same object."""

    async def run() -> None:
        broadcaster = Broadcaster(StreamCounts())
        listeners = [broadcaster.join() for _ in range(3)]
        async with running_presenter(bus, broadcaster):
            bus.publish("limits", {"set": "flight", "key": None})
            await wait_until(lambda: listeners[0].ready.is_set())
            queues = [listener.take()[0] for listener in listeners]
        assert [len(messages) for messages in queues] == [1, 1, 1]
        assert queues[0][0] is queues[1][0] is queues[2][0]
        assert queues[0][0].data == b'event: limits\ndata: {"set":"flight","key":null}\nid: 0.1\n\n'

    asyncio.run(run())


def test_only_the_slow_subscriber_loses_the_oldest_messages():
    """A queue is limited in messages and bytes; the loss is counted for this subscriber alone."""
    broadcaster = Broadcaster(StreamCounts())
    slow, quick = broadcaster.join(), broadcaster.join()
    for k in range(MAX_QUEUED + 5):
        broadcaster.spread([Wire("x", b"%d" % k)])
        quick.take()
    messages, dropped = slow.take()
    assert (len(messages), dropped, messages[0].data) == (MAX_QUEUED, 5, b"5")
    assert slow.take() == ([], 0)
    large = Listener()
    large.put(Wire("x", bytes(10 << 20)) for _ in range(3))
    assert [len(large.take()[0])] == [1]


def test_a_dropped_message_is_announced_on_its_connection(bus):
    """A subscriber that lost messages receives their number before the next message."""

    async def run() -> None:
        broadcaster, connection = Broadcaster(StreamCounts()), Connection(blocked=True)
        task = start_stream(bus, broadcaster, connection)
        await wait_until(lambda: len(broadcaster) == 1)
        for k in range(MAX_QUEUED + 7):
            broadcaster.spread([wire("limits", k, f"0.{k}")])
        connection.accepts.set()
        await wait_until(lambda: len(connection.messages()) > MAX_QUEUED)
        connection.gone.set()
        await task
        received = connection.messages()
        assert received[:2] == [("link", {"n": 0}, ""), ("dropped", {"dropped": 7}, "")]
        assert [payload for topic, payload, _ in received if topic == "limits"] == list(range(7, MAX_QUEUED + 7))
        assert broadcaster.counts.dropped == 7

    asyncio.run(run())


def test_events_of_many_threads_are_sent_in_the_order_of_their_numbers(bus):
    """A subscriber that received a number has received all smaller ones, so the number is enough to resume."""

    async def run() -> None:
        broadcaster = Broadcaster(StreamCounts())
        listener = broadcaster.join()
        async with running_presenter(bus, broadcaster):
            threads = [
                threading.Thread(target=lambda: [bus.record("k", "ok", "text") for _ in range(10)]) for _ in range(4)
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                await asyncio.to_thread(thread.join)
            seen: list[int | None] = []
            while len(seen) < 40:
                await wait_until(listener.ready.is_set)
                seen += [message.seq for message in listener.take()[0]]
        assert seen == list(range(1, 41))

    asyncio.run(run())


def test_a_returning_subscriber_gets_every_recorded_event_once(bus, monkeypatch):
    """The subscriber receives past, meanwhile recorded and new events without repetition or loss."""
    monkeypatch.setattr(stream, "PAGE", 3)
    for k in range(8):
        bus.record("k", "ok", f"{k + 1}")

    async def run() -> None:
        broadcaster, connection = Broadcaster(StreamCounts()), Connection()
        async with running_presenter(bus, broadcaster):
            task = start_stream(bus, broadcaster, connection, after=resumed_after("2.99"))
            bus.record("k", "ok", "9")
            await wait_until(lambda: any(topic == "link" for topic, _, _ in connection.messages()))
            bus.record("k", "ok", "10")
            await wait_until(lambda: connection.messages()[-1][2] == "10")
            connection.gone.set()
            await task
        assert [payload["seq"] for topic, payload, _ in connection.messages() if topic == "event"] == [*range(3, 11)]

    asyncio.run(run())


def test_a_number_of_another_database_resumes_at_the_newest(bus):
    """If the last received number is above the newest, as after a restore, the stream reports dropped events and sends new
    ones."""
    bus.record("k", "ok", "1")

    async def run() -> None:
        broadcaster, connection = Broadcaster(StreamCounts()), Connection()
        async with running_presenter(bus, broadcaster):
            task = start_stream(bus, broadcaster, connection, after=50)
            await wait_until(lambda: any(topic == "link" for topic, _, _ in connection.messages()))
            bus.record("k", "ok", "2")
            await wait_until(lambda: connection.messages()[-1][2] == "2")
            connection.gone.set()
            await task
        assert connection.messages()[0][0] == "dropped"

    asyncio.run(run())


def test_an_absence_longer_than_the_back_fill_is_reported(bus, monkeypatch):
    """The stream announces how many older events it does not send again."""
    monkeypatch.setattr(stream, "PAGE", 2)
    monkeypatch.setattr(stream, "PAGES", 2)
    for _ in range(9):
        bus.record("k", "ok", "")

    async def run() -> None:
        broadcaster, connection = Broadcaster(StreamCounts()), Connection()
        task = start_stream(bus, broadcaster, connection, after=1)
        await wait_until(lambda: len(connection.messages()) == 6)
        connection.gone.set()
        await task
        assert [m[2] for m in connection.messages()[:4]] == ["2", "3", "4", "5"]
        assert connection.messages()[4][:2] == ("dropped", {"dropped": 4})

    asyncio.run(run())


def test_a_stream_ends_when_its_session_does(bus):
    """The server checks the session while the stream is open and announces its end in the last message."""

    async def run() -> None:
        broadcaster, connection = Broadcaster(StreamCounts()), Connection()
        await start_stream(bus, broadcaster, connection, valid=lambda: "signed out")
        assert connection.messages()[-1][:2] == ("session", {"ended": "signed out"})
        assert len(broadcaster) == 0

    asyncio.run(run())


def test_a_stopping_server_ends_every_stream(bus):
    """When the broadcaster closes, open connections end, and new ones end at once."""

    async def run() -> None:
        broadcaster, connection, late = Broadcaster(StreamCounts()), Connection(), Connection()
        task = start_stream(bus, broadcaster, connection)
        await wait_until(lambda: len(broadcaster) == 1)
        broadcaster.close()
        await asyncio.wait_for(task, 10)
        await asyncio.wait_for(start_stream(bus, broadcaster, late), 10)

    asyncio.run(run())


def test_event_numbers_are_read_in_both_forms_only():
    """The numbers ``12`` and ``12.345`` continue after event 12. Any other text is ignored."""
    assert [resumed_after(text) for text in ("12", "12.345", "", "x", "-1", "1e3", "²", "9" * 40)] == [12, 12] + [
        None
    ] * 6
    assert unnumbered(wire("x", {"id": "a"}, "7.1")) == b'event: x\ndata: {"id":"a"}\n\n'
