"""The reader of the line is watched, and what queues is bounded: nothing hangs or is lost without a word."""

from __future__ import annotations

import threading
import time

import pytest

from gss.device.dictionary_file import load_dictionary
from gss.domain.errors import LinkDown
from gss.operations.frames import frames as room
from gss.operations.frames.frames import FrameService
from gss.operations.line import link as link_room
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.line_events import LineEventQueue
from gss.operations.line.link import STALLED_AFTER_S, LinkService
from gss.store.blobs import BlobStore


class HangingStream:
    """A port whose driver never returns from a read, until somebody closes it."""

    url = "memory://hangs"

    def __init__(self) -> None:
        self.reading, self.closed = threading.Event(), threading.Event()

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        self.reading.set()
        self.closed.wait(30)
        raise LinkDown("closed under the read")

    def write(self, data: bytes) -> None:
        """Nobody takes it."""

    def close(self) -> None:
        self.closed.set()


def wait_for(what):
    limit_s = time.monotonic() + 20
    while not what():
        assert time.monotonic() < limit_s
        time.sleep(0.002)


@pytest.fixture
def line(database, bus, clock, tmp_path, monkeypatch):
    """A link whose ports hang; its time is the test's."""
    opened: list[HangingStream] = []

    def open_hanging(url: str) -> HangingStream:
        opened.append(HangingStream())
        return opened[-1]

    monkeypatch.setattr(link_room, "open_stream", open_hanging)
    now_s = [100.0]
    events = LineEventQueue(clock, lambda: now_s[0])
    link = LinkService(load_dictionary(), database, bus, tmp_path / "captures", clock, lambda: now_s[0], events)
    dispatcher = Dispatcher(events, bus, lambda: now_s[0], [link.handle])
    dispatcher.start()
    link.start()
    yield link, opened, now_s
    link.url = ""
    for stream in opened:
        stream.close()
    link.stop()
    dispatcher.stop()


def test_a_reader_that_hangs_loses_its_port_and_opens_the_line_anew(line, bus):
    """After the longest time that any call may take the port is closed, which ends the call; the contact ends, a new one begins."""
    link, opened, now_s = line
    link.open_later("memory://hangs")
    wait_for(lambda: opened and opened[0].reading.is_set())
    link.watch()
    assert (link.alive(), opened[0].closed.is_set()) == (True, False)
    now_s[0] += STALLED_AFTER_S + 1
    assert not link.alive()
    link.watch()
    wait_for(lambda: len(opened) == 2 and opened[1].reading.is_set())
    assert link.alive()
    wait_for(lambda: link.contact_id == 2)
    assert any("made no progress for 21 s" in event.text for event in bus.after(0, 100))


def test_a_reader_that_died_is_started_anew_and_told(line, bus, monkeypatch):
    """Whatever ended its thread, the line is read again."""
    link, opened, _ = line

    class Fatal(BaseException):
        """Nothing catches it."""

    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    monkeypatch.setattr(link, "_once", lambda: (_ for _ in ()).throw(Fatal()))
    wait_for(lambda: not link.alive())
    monkeypatch.undo()
    monkeypatch.setattr(link_room, "open_stream", lambda url: opened.append(HangingStream()) or opened[-1])
    link.open_later("memory://hangs")
    link.watch()
    wait_for(lambda: opened and opened[-1].reading.is_set())
    wait_for(lambda: any("was restarted" in event.text for event in bus.after(0, 100)))


def test_frames_that_come_faster_than_they_are_solved_are_left_out_and_told(
    database, bus, clock, tmp_path, monkeypatch
):
    """The queue is bounded: the oldest that wait are not solved by themselves, counted, and announced once."""
    import numpy as np

    monkeypatch.setattr(room, "MOST_WAITING", 3)
    go, solved = threading.Event(), []
    frames = FrameService(
        database, BlobStore(str(tmp_path / "blobs")), bus, None, None, clock, "reference", None, lambda _: None
    )

    def slow(frame_id: int) -> None:
        go.wait(20)
        solved.append(frame_id)

    monkeypatch.setattr(frames, "_solve_on_arrival", slow)
    values = {"number": None, "taken": clock(), "bits": 8, "profile": "cubestar"}
    ids = [frames.add_from_device(np.full((2, 4), k, np.uint8), values).id for k in range(8)]
    wait_for(lambda: frames.skipped + frames.waiting() in (7, 8))
    assert frames.skipped >= 4
    go.set()
    frames._pool.shutdown(wait=True)
    assert len(solved) + frames.skipped == 8
    assert solved[-3:] == ids[-3:]
    assert len([e for e in bus.after(0, 100) if "faster than they are solved" in e.text]) == 1
