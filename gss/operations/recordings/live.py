"""A live recording: each new frame, attitude, command, event and packet becomes a piece when it arrives."""

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
from gss.operations.recordings.stored import READ, Recordings
from gss.store import frames
from gss.store.engine import Database

AT_ONCE, EACH = 6, 2
"""Maximum number of concurrent live recordings, in all and of one user, because each renders its pictures separately."""
BEGIN_WITH = 10
"""Number of earlier frames in the first piece, so that something is visible at once."""
TOPICS = ("frame", "solution", "telemetry", "command", "event")


class LiveRecording:
    """The recording of one listener. ``piece`` blocks while drawing, never while waiting for data; call it in a thread after
    a wake."""

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
        """Return everything since the last piece as a complete .rrd; empty if nothing of it is shown."""
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
            self._small(message)
        for frame_id in sorted(frame_ids):
            self._frame(frame_id, picture=frame_id in pictures)
        return self._recorder.take()

    def begin(self, frame_ids: Iterable[int]) -> bytes:
        """Return the first piece: layout, sky, and these frames."""
        for frame_id in frame_ids:
            self._frame(frame_id, picture=True)
        return self._recorder.take()

    def _frame(self, frame_id: int, *, picture: bool) -> None:
        with contextlib.suppress(NotFound):  # removed meanwhile
            self._recordings.frame(self._recorder, frame_id, picture)

    def _small(self, message: Message) -> None:
        payload: Any = message.payload
        if message.topic == "event":
            self._recorder.event(payload)
        elif message.topic == "command" and payload.row.finished is not None:
            self._recorder.command(payload.row)
        elif message.topic == "telemetry":
            fresh = {
                v.name.rpartition(".")[2]: v.value for v in payload if v.packet == "housekeeping" and v.state != "stale"
            }
            self._recorder.telemetry(self._now(), {n: fresh[n] for n in READ if n in fresh})


class LiveRecordings:
    """Opens live recordings, up to ``AT_ONCE`` at a time and ``EACH`` of one user."""

    def __init__(self, recordings: Recordings, database: Database, bus: EventBus, now: Now) -> None:
        self._recordings, self._database, self._bus, self._now = recordings, database, bus, now
        self._open: Counter[str] = Counter()
        self._lock = threading.Lock()

    def open(self, wake: Callable[[], None], user: str) -> tuple[bytes, LiveRecording]:
        """Return the first piece with earlier frames, and the live recording. Raises Conflict if too many are open."""
        self._take_place(user)
        with contextlib.ExitStack() as unless_it_opens:
            unless_it_opens.callback(self._free_place, user)
            recorder = self._recordings.recorder("gss-live", Use.LIVE)
            live = LiveRecording(recorder, self._recordings, self._bus, self._now, wake, user)
            unless_it_opens.callback(live.close)
            with self._database.unit_of_work() as session:
                ids = [f.id for f in frames.page(session, BEGIN_WITH, 0)[1]]
            first = live.begin(reversed(ids))
            unless_it_opens.pop_all()
        return first, live

    def close(self, live: LiveRecording) -> None:
        """Close a live recording and free its place."""
        live.close()
        self._free_place(live.user)

    def _take_place(self, user: str) -> None:
        with self._lock:
            if self._open[user] >= EACH or self._open.total() >= AT_ONCE:
                expected = f"at most {EACH} of one user, {AT_ONCE} in all"
                raise Conflict("too many live recordings", expected=expected, hint="close another recording")
            self._open[user] += 1

    def _free_place(self, user: str) -> None:
        with self._lock:
            self._open[user] -= 1
            self._open += Counter()  # drops users without a recording
