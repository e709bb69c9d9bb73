"""Frames are written to a slow store in the background: telemetry is not delayed, no frame is lost or reported early."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gss.device.session_events import Direction
from gss.domain.errors import Conflict, StoreDown
from gss.operations.events import EventBus
from gss.operations.transfers.arrivals import MAX_WAITING, Writer
from gss.settings import Settings
from gss.store.blobs import BlobStore
from gss.wiring.build import build
from gss.wiring.services import Services


class SlowStore(BlobStore):
    """Store that blocks every write until ``open`` is set, and fails while ``broken``, or ``failures`` times."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self.open, self.requested, self.broken, self.failures = threading.Event(), 0, False, 0

    def put(self, data: bytes | memoryview, item_bytes: int = 1) -> str:
        self.requested += 1
        assert self.open.wait(60)
        if self.broken or self.failures:
            self.failures = max(0, self.failures - 1)
            raise StoreDown("the bytes cannot be stored now")
        return super().put(data, item_bytes)


class Ground:
    """All ground services with a sensor in memory, with a slow store for frames and without the solver."""

    def __init__(self, folder: Path, sensor: Any) -> None:
        self.folder, self.sensor = folder, sensor
        self.services: Services = build(Settings(data=folder))
        self.store = SlowStore(str(folder / "blobs"))
        self.services.frames.frames._blobs = self.store
        self.services.frames.frames.queue.add = lambda *_: None  # type: ignore[method-assign]
        s = self.services
        s.transfers.transfers.start()
        s.commanding.commands.start()
        s.dispatcher.start()
        s.line.link.start()
        sensor.keep_pace_with(s.line.link.events)
        s.line.link.open_later(sensor.url)
        self.wait(
            lambda: any(view.row.kind == "catalogue" and view.row.finished for view in s.transfers.transfers.newest(9))
        )

    def wait(self, done: Callable[[], Any]) -> None:
        """Wait until ``done()`` is true. The timeout in real time only limits how long a failing test runs."""
        limit_s = time.monotonic() + 60
        while not done():
            assert time.monotonic() < limit_s, [e.text for e in self.services.base.bus.after(0, 1000)][-8:]
            time.sleep(0.005)

    def image(self) -> None:
        """Command the sensor to take an image."""
        row = self.services.commanding.commands.send("TAKE_IMAGE", {}, confirm="", user="gss", source="server")
        self.wait(lambda: self.services.commanding.commands.get(row.id).result == "completed")

    def housekeeping(self) -> int:
        """Return the number of stored packets."""
        packets = self.services.telemetry.telemetry.archive.packets("housekeeping", None, None, 1, None)
        return packets[0].id if packets else 0

    def downloads(self) -> list[Any]:
        """Return rows of the frame transfers, newest first."""
        return [view.row for view in self.services.transfers.transfers.newest(50) if view.row.kind == "frame"]

    def frames(self) -> list[Any]:
        """Return rows of the frames, newest first."""
        return [frame for frame, _ in self.services.frames.frames.page(50, 0)[1]]

    def stop(self) -> None:
        """Stop the services in their order."""
        self.services.stop()


@pytest.fixture
def ground(tmp_path: Path, sensor_in_memory: Callable[..., Any]) -> Iterator[Ground]:
    new_ground = Ground(tmp_path, sensor_in_memory())
    yield new_ground
    new_ground.store.open.set()
    new_ground.stop()


def test_telemetry_is_stored_while_a_frame_waits_for_its_store(ground: Ground) -> None:
    """Telemetry is stored while a frame waits for its store. Until its bytes are stored, the frame has no row and its
    transfer is not complete."""
    ground.image()
    ground.wait(lambda: ground.store.requested)
    before = ground.housekeeping()
    ground.wait(lambda: ground.housekeeping() > before + 10)
    (row,) = ground.downloads()
    assert (row.finished, row.frame_id, ground.frames()) == (None, None, [])
    ground.store.open.set()
    ground.wait(lambda: ground.downloads()[0].finished)
    (frame,), (row,) = ground.frames(), ground.downloads()
    assert (row.state, row.frame_id, frame.complete) == ("verified", frame.id, True)
    assert ground.services.frames.frames.pixels(frame).shape == (frame.rows, frame.columns)
    assert ground.services.transfers.writer.waits == 0


def test_frame_downloads_wait_while_the_queue_is_full(ground: Ground) -> None:
    """While the queue of frames to store is full, the next frame stays on board. It is downloaded afterwards."""
    begun = MAX_WAITING + 1
    for k in range(begun):
        ground.image()
        ground.wait(lambda k=k: len(ground.services.transfers.transfers._progress._storing) == k + 1)
    ground.wait(lambda: ground.services.transfers.writer.full)
    figures = ground.services.upkeep.metrics.text()
    assert f'gss_queue_depth{{queue="store"}} {MAX_WAITING}.0\n' in figures
    assert "gss_line_waits_total 0.0\n" in figures
    ground.image()
    before = ground.housekeeping()
    ground.wait(lambda: ground.housekeeping() > before + 5)
    assert len(ground.downloads()) == begun
    ground.store.open.set()
    ground.wait(lambda: len(ground.frames()) == begun + 1)
    ground.wait(lambda: all(row.state == "verified" for row in ground.downloads()))
    assert {row.frame_id for row in ground.downloads()} == {frame.id for frame in ground.frames()}


def test_a_failing_store_is_reported_and_ends_the_transfer(ground: Ground) -> None:
    """If the store fails, an event records it and the transfer fails. It can be resumed."""
    ground.store.broken = True
    ground.store.open.set()
    ground.image()
    ground.wait(lambda: ground.downloads() and ground.downloads()[0].finished)
    assert ground.frames() == []
    words = "was received but is not usable: the bytes cannot be stored now"
    ground.wait(lambda: any(words in event.text for event in ground.services.base.bus.after(0, 1000)))
    ground.wait(lambda: ground.downloads()[0].state == "failed")
    ground.store.broken = False
    ground.services.transfers.transfers.resume(ground.downloads()[0].id)
    ground.wait(lambda: ground.downloads()[0].state == "verified")
    assert [frame.id for frame in ground.frames()] == [ground.downloads()[0].frame_id]


def test_two_requests_at_the_same_time_resume_a_transfer_once(ground: Ground, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two users resume a failed transfer at the same time: the session starts it once, and the other request is rejected."""
    ground.store.broken = True
    ground.store.open.set()
    ground.image()
    ground.wait(lambda: ground.downloads() and ground.downloads()[0].state == "failed")
    (row,), link = ground.downloads(), ground.services.line.link
    sessions, start = [], link.session.transfers.start_download
    rejected: list[Conflict] = []

    def counted(*arguments: Any, **options: Any) -> int:
        sessions.append(start(*arguments, **options))
        return sessions[-1]

    def resume() -> None:
        try:
            ground.services.transfers.transfers.resume(row.id)
        except Conflict as error:
            rejected.append(error)

    monkeypatch.setattr(link.session.transfers, "start_download", counted)
    with link.hold_events():
        requests = [threading.Thread(target=resume) for _ in range(2)]
        for request in requests:
            request.start()
        time.sleep(0.2)  # so that both requests wait for the events
    for request in requests:
        request.join(10.0)
    assert (len(sessions), len(rejected)) == (1, 1)


def test_a_short_store_failure_loses_no_frame(ground: Ground) -> None:
    """After a short store failure the frame is stored, because writing is retried."""
    ground.store.failures = 2
    ground.store.open.set()
    ground.image()
    ground.wait(lambda: ground.downloads() and ground.downloads()[0].state == "verified")
    assert [frame.id for frame in ground.frames()] == [ground.downloads()[0].frame_id]
    assert ground.store.failures == 0


def test_a_frame_that_arrives_while_the_database_is_down_is_stored_later(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The session reports received content only once, so the report waits for the database."""
    ground.store.open.set()
    progress, failures = ground.services.transfers.transfers._progress, []
    read_row = progress._row

    def fails_twice(row_id: int) -> Any:
        if len(failures) < 2:
            failures.append(row_id)
            raise StoreDown("the database is locked")
        return read_row(row_id)

    monkeypatch.setattr(progress, "_row", fails_twice)
    ground.image()
    ground.wait(lambda: ground.downloads() and ground.downloads()[0].state == "verified")
    assert len(failures) == 2
    assert [frame.id for frame in ground.frames()] == [ground.downloads()[0].frame_id]
    assert not progress.busy(Direction.DOWN)


def test_content_without_a_storing_service_is_not_reported_as_complete(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a defect between link and store, the transfer fails, and its content can be downloaded again."""
    ground.store.open.set()

    def defect(*_: Any) -> Any:
        raise RuntimeError("a defect")

    with monkeypatch.context() as patched:
        patched.setattr("gss.operations.intake.frame_intake.picture_of", defect)
        ground.image()
        ground.wait(lambda: ground.downloads() and ground.downloads()[0].state == "failed")
    ground.services.transfers.transfers.resume(ground.downloads()[0].id)
    ground.wait(lambda: ground.downloads()[0].state == "verified")
    assert len(ground.frames()) == 1


def test_a_server_stop_does_not_wait_for_a_hanging_store(ground: Ground, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server stops although the store does not respond. The frame's transfer is not complete, and the next server
    downloads it again."""
    monkeypatch.setattr("gss.operations.transfers.transfers.STORE_WITHIN_S", 0.2)
    ground.image()
    ground.wait(lambda: ground.store.requested)
    ground.services.line.link.stop()
    ground.services.transfers.transfers.stop()
    (row,) = ground.downloads()
    assert (row.finished, row.frame_id, ground.frames()) == (None, None, [])
    following = Ground(ground.folder, ground.sensor)
    following.store.open.set()
    following.wait(lambda: following.downloads()[0].finished)
    (frame,), (row,) = following.frames(), following.downloads()
    assert (row.state, row.frame_id, frame.complete) == ("verified", frame.id, True)
    following.stop()


def test_frames_beyond_the_queue_limit_are_counted_and_recorded(bus: EventBus) -> None:
    """If the queue is full, the caller waits, which is counted and recorded. All items are written in order."""
    now_s = [0.0]
    go, begun, done = threading.Event(), threading.Event(), []

    def monotonic_s() -> float:
        value = now_s[0]
        go.set()  # the writer reads the time when it begins to wait
        return value

    writer = Writer(monotonic_s, bus, max_waiting=1)

    def first() -> None:
        begun.set()
        assert go.wait(30)
        now_s[0] = 7.0
        done.append(1)

    writer.submit(first)
    assert begun.wait(30)
    writer.submit(lambda: done.append(2))
    assert (writer.full, writer.waits) == (True, 0)
    last = writer.submit(lambda: done.append(3))
    writer.finish(30)
    assert last.done()
    assert (done, writer.waits, writer.waited_s) == ([1, 2, 3], 1, 7.0)
    assert [event.text for event in bus.after(0, 10)] == ["Received data arrives faster than it is stored"]
