"""The link's reader is supervised and queues are bounded: nothing hangs or is lost without a report."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gss.device.session import HostSession
from gss.device.session_events import SessionEvent
from gss.domain.errors import Conflict, LinkDown
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.package_files import LinkFile
from gss.instruments.roles import default_roles
from gss.operations.commanding import aborts as aborts_room
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.aborts import Aborts
from gss.operations.commanding.command_record import CommandRecorder, CommandView
from gss.operations.frames import solve_queue as room
from gss.operations.line import link as link_room
from gss.operations.line import session_lock as lock_room
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.dispatcher import Dispatcher, LineEventQueue
from gss.operations.line.link import REPORT_EVERY_S, LinkService
from gss.store.models import Frame

STALLED_AFTER_S = 5.0


class HangingStream:
    """Port whose driver does not return from a read until the port is closed."""

    url = "memory://hangs"

    def __init__(self) -> None:
        self.reading, self.closed = threading.Event(), threading.Event()

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        self.reading.set()
        self.closed.wait(30)
        raise LinkDown("closed under the read")

    def write(self, data: bytes) -> None:
        """Ignore the bytes."""

    def close(self) -> None:
        self.closed.set()


def wait_for(what):
    limit_s = time.monotonic() + 20
    while not what():
        assert time.monotonic() < limit_s
        time.sleep(0.002)


@pytest.fixture
def line(database, bus, clock, tmp_path, monkeypatch):
    """Link whose ports hang, with the ports and the clock of the test."""
    opened: list[HangingStream] = []

    def open_hanging(url: str, baud: int) -> HangingStream:
        opened.append(HangingStream())
        return opened[-1]

    monkeypatch.setattr(link_room, "open_stream", open_hanging)
    now_s = [100.0]
    events = LineEventQueue(clock, lambda: now_s[0])
    rules = LinkFile(stalled_after_s=STALLED_AFTER_S)
    parts = (
        load_dictionary(),
        default_roles(load_dictionary()),
        database,
        bus,
        tmp_path / "captures",
        clock,
        lambda: now_s[0],
        events,
    )
    link = LinkService(*parts, rules=rules)
    dispatcher = Dispatcher(events, bus, lambda: now_s[0], [link.handle])
    dispatcher.start()
    link.start()
    yield link, opened, now_s
    link.url = ""
    for stream in opened:
        stream.close()
    link.stop()
    dispatcher.stop()


def test_the_port_of_a_hanging_reader_is_closed_and_reopened(line, bus):
    """If a read exceeds its maximum time, the port is closed, which ends the read and the contact, and opened again."""
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
    wait_for(lambda: link.contact_id == 1)
    assert any("The link thread made no progress for 6 s" in event.text for event in bus.after(0, 100))


class FaultyDriver(HostSession):
    """Driver with a defect: calls ``fault`` for received bytes."""

    def __init__(self, fault: Callable[[], object]) -> None:
        super().__init__(load_dictionary())
        self._fault = fault

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        self._fault()
        return super().feed(data, now_s)


class TalkingStream(HangingStream):
    """Port on which bytes arrive."""

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        self.reading.set()
        if self.closed.is_set():
            raise LinkDown("closed")
        return b"garbage"


@pytest.fixture
def faulty_line(database, bus, clock, tmp_path):
    """Function that starts a link with a faulty driver and returns the link, its ports and its clock."""
    started = []

    def start(fault: Callable[[], object]):
        opened, now_s, events = [], [100.0], LineEventQueue(clock, lambda: now_s[0])
        link = LinkService(
            *(
                load_dictionary(),
                default_roles(load_dictionary()),
                database,
                bus,
                tmp_path / "captures",
                clock,
                lambda: now_s[0],
                events,
            ),
            session=FaultyDriver(fault),
            rules=LinkFile(stalled_after_s=STALLED_AFTER_S),
            open_line=lambda url, baud: opened.append(TalkingStream()) or opened[-1],
        )
        dispatcher = Dispatcher(events, bus, lambda: now_s[0], [link.handle])
        dispatcher.start()
        link.start()
        link.open_later("memory://talks")
        started.append((link, dispatcher))
        return link, opened, now_s

    yield start
    for link, dispatcher in started:
        link.stop()
        dispatcher.stop()


def test_a_driver_that_raises_ends_the_contact_with_the_reason(faulty_line, bus):
    """If a driver raises an exception, the contact is interrupted with the reason, the received bytes are in the capture,
    and the port is opened again. Further attempts belong to the same contact and repeat the report once a minute."""

    def fault() -> None:
        raise ValueError("no such field")

    link, opened, now_s = faulty_line(fault)

    def reports() -> int:
        return [e.text for e in bus.after(0, 100)].count("the contact was ended: ValueError: no such field")

    wait_for(lambda: len(opened) >= 3)
    assert link.alive()
    assert opened[0].closed.is_set()
    wait_for(lambda: reports() == 1)
    assert link.contact_id in (1, None)
    now_s[0] += REPORT_EVERY_S + 1
    wait_for(lambda: reports() == 2)
    captured = b"".join(path.read_bytes() for path in link.capture.folder.rglob("*") if path.is_file())
    assert b"garbage" in captured


def test_a_driver_that_hangs_is_reported(faulty_line, bus):
    """If closing the port does not end a call of the driver, the next report names the driver and the action."""
    hanging, released = threading.Event(), threading.Event()
    link, opened, now_s = faulty_line(lambda: hanging.set() or released.wait(30))
    wait_for(hanging.is_set)
    for _ in range(2):
        now_s[0] += STALLED_AFTER_S + 1
        link.watch()
    assert "the driver of the instrument hangs" in link.stall
    released.set()
    assert opened[0].closed.is_set()
    wait_for(lambda: any("the driver of the instrument hangs: restart the unit" in e.text for e in bus.after(0, 100)))
    wait_for(lambda: len(opened) >= 2)
    wait_for(lambda: not link.stall)


def test_abort_and_other_requests_end_with_an_error_while_a_driver_hangs(
    faulty_line, bus, database, clock, tmp_path, monkeypatch
):
    """A driver that hangs holds the session. ABORT then reports that it was not sent, is not counted and not recorded; other
    threads get the same reason. Afterwards the session can be used again."""
    monkeypatch.setattr(aborts_room, "ABORT_WITHIN_S", 0.05)
    monkeypatch.setattr(lock_room, "LOCK_WITHIN_S", 0.05)
    hanging, released = threading.Event(), threading.Event()
    link, opened, _ = faulty_line(lambda: hanging.set() or released.wait(30))
    wait_for(hanging.is_set)
    writes, journal = DeferredWrites(), AbortJournal(tmp_path / "aborts.jsonl")
    recorder = CommandRecorder(database, bus, clock, lambda row: CommandView(row, False, False), link.events, writes)
    aborts = Aborts(link, recorder, bus, clock, writes, journal)
    with pytest.raises(
        Conflict, match=r"ABORT was not sent: the driver of the instrument has not responded for 0.05 s"
    ):
        aborts.issue("op", "abort")
    assert (aborts.count, journal.entries()) == (0, [])
    with pytest.raises(Conflict, match="nothing was sent: the driver"), link.lock:
        pytest.fail("the session is in use")
    released.set()
    wait_for(lambda: len(opened) == 1 and link.alive())
    monkeypatch.undo()
    aborts.issue("op", "abort")
    assert aborts.count == 1


def test_a_reader_that_died_is_restarted_and_reported(line, bus, monkeypatch):
    """A reader thread that ended with any exception is restarted, with an event."""
    link, opened, _ = line

    class Fatal(BaseException):
        """Exception that no handler catches."""

    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    monkeypatch.setattr(link, "_once", lambda: (_ for _ in ()).throw(Fatal()))
    wait_for(lambda: not link.alive())
    monkeypatch.undo()
    monkeypatch.setattr(link_room, "open_stream", lambda *_: opened.append(HangingStream()) or opened[-1])
    link.open_later("memory://hangs")
    link.watch()
    wait_for(lambda: opened and opened[-1].reading.is_set())
    wait_for(lambda: any("was restarted" in event.text for event in bus.after(0, 100)))


def test_frames_that_arrive_faster_than_they_are_solved_are_skipped_and_reported(bus, monkeypatch):
    """The queue of frames to solve is bounded. The oldest waiting frames are skipped, counted and reported."""
    monkeypatch.setattr(room, "MAX_WAITING", 3)
    go, solved = threading.Event(), []

    def slow(frame: Frame, pixels: Any) -> None:
        go.wait(20)
        solved.append(frame.id)

    queue = room.SolveQueue(slow, bus)
    for k in range(8):
        queue.add(Frame(id=k), np.full((2, 4), k, np.uint8))
    wait_for(lambda: queue.skipped + len(queue) in (7, 8))
    assert queue.skipped >= 4
    assert any("skipped" in event.text for event in bus.after(0, 100))
    go.set()
    queue._pool.shutdown(wait=True)
    assert len(solved) + queue.skipped == 8
    assert solved[-3:] == [5, 6, 7]
