"""Live recordings: new frames, attitudes, commands, events and packets are sent to the viewer in pieces as they
arrive."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from gss.domain.errors import Conflict, NotFound
from gss.operations.clock import Now
from gss.operations.events import EventBus, Message, Subscription
from gss.operations.recordings.blueprints import Use
from gss.operations.recordings.recorder import Recorder
from gss.operations.recordings.stored import Recordings, recorded_fields
from gss.store import frames
from gss.store.engine import Database

MAX_OPEN, MAX_PER_USER = 6, 2
"""Maximum number of concurrent live recordings, in total and per user. Each recording renders its pictures
separately."""
BEGIN_WITH = 10
"""Number of earlier frames in the first piece, so that something is visible immediately."""
TOPICS = ("frame", "solution", "telemetry", "command", "event")


class LiveRecording:
    """The live recording of one viewer. ``piece`` blocks while it draws, but never waits for data. Call it in a
    background thread after each call of ``wake``."""

    def __init__(
        self, recorder: Recorder, recordings: Recordings, bus: EventBus, now: Now, wake: Callable[[], None], user: str
    ) -> None:
        self.user = user
        self._recorder, self._recordings, self._bus, self._now = recorder, recordings, bus, now
        self._mailbox: Subscription = bus.subscribe(wake)

    def close(self) -> None:
        """Stop listening."""
        self._bus.unsubscribe(self._mailbox)

    def piece(self) -> bytes:
        """Return the data received since the last piece as a complete .rrd; empty if none of the data is shown."""
        messages, dropped = self._mailbox.take()
        relevant = [m for m in messages if m.topic in TOPICS]
        if not relevant and not dropped:
            return b""
        # A frame and its solutions arrive as several messages, so it is drawn once, in its current state.
        frame_ids = {
            m.payload.id if m.topic == "frame" else m.payload.frame_id for m in relevant if m.topic in TOPICS[:2]
        }
        pictures = {m.payload.id for m in relevant if m.topic == "frame"}
        for message in relevant:
            self._add_message(message)
        for frame_id in sorted(frame_ids):
            self._frame(frame_id, picture=frame_id in pictures)
        return self._recorder.take()

    def begin(self, frame_ids: Iterable[int]) -> bytes:
        """Return the first piece, which contains the layout, the sky and the given frames."""
        for frame_id in frame_ids:
            self._frame(frame_id, picture=True)
        return self._recorder.take()

    def _frame(self, frame_id: int, *, picture: bool) -> None:
        with contextlib.suppress(NotFound):  # the frame was removed in the meantime
            self._recordings.frame(self._recorder, frame_id, picture)

    def _add_message(self, message: Message) -> None:
        payload: Any = message.payload
        if message.topic == "event":
            self._recorder.event(payload)
        elif message.topic == "command" and payload.row.finished is not None:
            self._recorder.command(payload.row)
        elif message.topic == "telemetry":
            status = self._recordings.status
            current_values = {
                v.name.rpartition(".")[2]: v.value for v in payload if v.packet == status.packet and v.state != "stale"
            }
            values = {q: current_values[name] for q, name in recorded_fields(status).items() if name in current_values}
            self._recorder.telemetry(self._now(), values)


class LiveRecordings:
    """Opens live recordings: at most ``MAX_OPEN`` at the same time and ``MAX_PER_USER`` per user."""

    def __init__(self, recordings: Recordings, database: Database, bus: EventBus, now: Now) -> None:
        self._recordings, self._database, self._bus, self._now = recordings, database, bus, now
        self._open: Counter[str] = Counter()
        self._lock = threading.Lock()

    def open(self, wake: Callable[[], None], user: str) -> tuple[bytes, LiveRecording]:
        """Return the first piece with earlier frames, and the live recording. Raises Conflict if too many recordings
        are open."""
        self._reserve(user)
        with contextlib.ExitStack() as cleanup:
            cleanup.callback(self._release, user)
            recorder = self._recordings.recorder("gss-live", Use.LIVE)
            live = LiveRecording(recorder, self._recordings, self._bus, self._now, wake, user)
            cleanup.callback(live.close)
            with self._database.unit_of_work() as session:
                ids = [f.id for f in frames.page(session, BEGIN_WITH, 0)[1]]
            first = live.begin(reversed(ids))
            cleanup.pop_all()
        return first, live

    def close(self, live: LiveRecording) -> None:
        """Close a live recording. It no longer counts against the limits."""
        live.close()
        self._release(live.user)

    def _reserve(self, user: str) -> None:
        with self._lock:
            if self._open[user] >= MAX_PER_USER or self._open.total() >= MAX_OPEN:
                expected = f"at most {MAX_PER_USER} per user and {MAX_OPEN} in total"
                raise Conflict("too many live recordings", expected=expected, hint="close another recording")
            self._open[user] += 1

    def _release(self, user: str) -> None:
        with self._lock:
            self._open[user] -= 1
            self._open += Counter()  # removes users without a recording
