"""Frames go to a slow store beside the line: telemetry is not late, nothing is lost, and no frame is told before it is there."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gss.domain.errors import StoreDown
from gss.operations.events import EventBus
from gss.operations.transfers.arrivals import MOST_WAITING, Writer
from gss.settings import Settings
from gss.store.blobs import BlobStore
from gss.wiring import Services, build


class SlowStore(BlobStore):
    """A folder that keeps everybody waiting until ``open`` is set, and refuses while it is ``broken``, or ``failures`` times."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self.open, self.asked, self.broken, self.failures = threading.Event(), 0, False, 0

    def put(self, data: bytes | memoryview) -> str:
        self.asked += 1
        assert self.open.wait(60)
        if self.broken or self.failures:
            self.failures = max(0, self.failures - 1)
            raise StoreDown("the bytes cannot be stored now")
        return super().put(data)


class Ground:
    """The whole ground on a sensor in memory, with a slow store for frames. The solver is left out: it is not asked about here."""

    def __init__(self, folder: Path, sensor: Any) -> None:
        self.folder, self.sensor = folder, sensor
        self.services: Services = build(Settings(data=folder))
        self.store = SlowStore(str(folder / "blobs"))
        self.services.frames._blobs = self.store
        self.services.frames._solve_later = lambda _frame_id: None  # type: ignore[method-assign]
        s = self.services
        s.transfers.start()
        s.commands.start()
        s.dispatcher.start()
        s.link.start()
        sensor.keep_pace_with(s.link.events)
        s.link.open_later(sensor.url)
        self.wait(lambda: any(view.row.kind == "catalogue" and view.row.finished for view in s.transfers.newest(9)))

    def wait(self, done: Callable[[], Any]) -> None:
        """Until something holds; the real time is only the limit after which a broken thing is given up."""
        limit_s = time.monotonic() + 60
        while not done():
            assert time.monotonic() < limit_s, [e.text for e in self.services.bus.after(0, 1000)][-8:]
            time.sleep(0.005)

    def image(self) -> None:
        """Have the sensor take one."""
        row = self.services.commands.send("TAKE_IMAGE", {}, confirm="", user="gss", source="server")
        self.wait(lambda: self.services.commands.get(row.id).result == "completed")

    def housekeeping(self) -> int:
        """Packets that are stored."""
        packets = self.services.telemetry.archive.packets("housekeeping", None, None, 1, None)
        return packets[0].id if packets else 0

    def downloads(self) -> list[Any]:
        """Rows of the transfers of frames, newest first."""
        return [view.row for view in self.services.transfers.newest(50) if view.row.kind == "frame"]

    def frames(self) -> list[Any]:
        """Rows of the frames, newest first."""
        return [frame for frame, _ in self.services.frames.page(50, 0)[1]]

    def stop(self) -> None:
        """In the order of the services."""
        self.services.stop()


@pytest.fixture
def ground(tmp_path: Path, sensor_in_memory: Callable[..., Any]) -> Iterator[Ground]:
    made = Ground(tmp_path, sensor_in_memory())
    yield made
    made.store.open.set()
    made.stop()


def test_telemetry_comes_while_a_frame_waits_for_its_store(ground: Ground) -> None:
    """Packets are stored one after the other; the frame has no row and its transfer is not over until its bytes are stored, and
    then both are there, with a link between them."""
    ground.image()
    ground.wait(lambda: ground.store.asked)
    before = ground.housekeeping()
    ground.wait(lambda: ground.housekeeping() > before + 10)
    (row,) = ground.downloads()
    assert (row.finished, row.frame_id, ground.frames()) == (None, None, [])
    ground.store.open.set()
    ground.wait(lambda: ground.downloads()[0].finished)
    (frame,), (row,) = ground.frames(), ground.downloads()
    assert (row.state, row.frame_id, frame.complete) == ("verified", frame.id, True)
    assert ground.services.frames.pixels(frame).shape == (frame.rows, frame.columns)
    assert ground.services.writer.waits == 0


def test_no_more_frames_are_begun_than_may_wait_and_all_that_came_are_stored(ground: Ground) -> None:
    """One is being stored and a few wait; the next stays on board until there is room for it."""
    begun = MOST_WAITING + 1
    for k in range(begun):
        ground.image()
        ground.wait(lambda k=k: len(ground.services.transfers._storing) == k + 1)
    ground.wait(lambda: ground.services.writer.full)
    figures = ground.services.upkeep.metrics.text()
    assert f'gss_queue_depth{{queue="store"}} {MOST_WAITING}\n' in figures
    assert "gss_line_waits_total 0\n" in figures
    ground.image()
    before = ground.housekeeping()
    ground.wait(lambda: ground.housekeeping() > before + 5)
    assert len(ground.downloads()) == begun
    ground.store.open.set()
    ground.wait(lambda: len(ground.frames()) == begun + 1)
    ground.wait(lambda: all(row.state == "verified" for row in ground.downloads()))
    assert {row.frame_id for row in ground.downloads()} == {frame.id for frame in ground.frames()}


def test_a_store_that_refuses_is_told_and_ends_the_transfer(ground: Ground) -> None:
    """The line goes on, and the record says what was lost."""
    ground.store.broken = True
    ground.store.open.set()
    ground.image()
    ground.wait(lambda: ground.downloads() and ground.downloads()[0].finished)
    assert ground.frames() == []
    texts = [e.text for e in ground.services.bus.after(0, 1000)]
    assert any("was received, but cannot be used: the bytes cannot be stored now" in text for text in texts), texts
    ground.wait(lambda: ground.downloads()[0].state == "failed")
    ground.store.broken = False
    ground.services.transfers.resume(ground.downloads()[0].id)
    ground.wait(lambda: ground.downloads()[0].state == "verified")
    assert [frame.id for frame in ground.frames()] == [ground.downloads()[0].frame_id]


def test_a_store_that_is_down_for_a_moment_loses_no_frame(ground: Ground) -> None:
    """Storing is tried again before the transfer is reported as over."""
    ground.store.failures = 2
    ground.store.open.set()
    ground.image()
    ground.wait(lambda: ground.downloads() and ground.downloads()[0].state == "verified")
    assert [frame.id for frame in ground.frames()] == [ground.downloads()[0].frame_id]
    assert ground.store.failures == 0


def test_content_that_no_service_stores_is_not_reported_as_complete(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A defect between the line and the store: the transfer fails, and its content can be downloaded again."""
    ground.store.open.set()

    def defect(*_: Any) -> Any:
        raise RuntimeError("a defect")

    with monkeypatch.context() as patched:
        patched.setattr("gss.operations.intake.frame_intake.picture_of", defect)
        ground.image()
        ground.wait(lambda: ground.downloads() and ground.downloads()[0].state == "failed")
    ground.services.transfers.resume(ground.downloads()[0].id)
    ground.wait(lambda: ground.downloads()[0].state == "verified")
    assert len(ground.frames()) == 1


def test_the_end_of_the_server_does_not_wait_for_a_store_that_hangs(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What hangs has no row and its transfer is not over: the next server brings it down again, once."""
    monkeypatch.setattr("gss.operations.transfers.transfers.STORE_WITHIN_S", 0.2)
    ground.image()
    ground.wait(lambda: ground.store.asked)
    ground.services.link.stop()
    ground.services.transfers.stop()
    (row,) = ground.downloads()
    assert (row.finished, row.frame_id, ground.frames()) == (None, None, [])
    following = Ground(ground.folder, ground.sensor)
    following.store.open.set()
    following.wait(lambda: following.downloads()[0].finished)
    (frame,), (row,) = following.frames(), following.downloads()
    assert (row.state, row.frame_id, frame.complete) == ("verified", frame.id, True)
    following.stop()


def test_what_comes_when_nothing_more_may_wait_is_counted_and_recorded(bus: EventBus) -> None:
    """Bounded memory, nothing dropped, in the order of arrival."""
    now_s = [0.0]
    writer = Writer(lambda: now_s[0], bus, most=1)
    go, begun, done = threading.Event(), threading.Event(), []

    def first() -> None:
        begun.set()
        assert go.wait(30)
        now_s[0] = 7.0
        done.append(1)

    writer.submit(first)
    assert begun.wait(30)
    writer.submit(lambda: done.append(2))
    assert (writer.full, writer.waits) == (True, 0)
    threading.Timer(0.05, go.set).start()
    last = writer.submit(lambda: done.append(3))
    writer.finish(30)
    assert last.done()
    assert (done, writer.waits, writer.waited_s) == ([1, 2, 3], 1, 7.0)
    assert [event.text for event in bus.after(0, 10)] == ["received content is not stored as fast as it arrives"]
