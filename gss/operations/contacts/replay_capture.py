"""Replay of the capture of a past contact at a selectable speed. Live data is never changed.

The replay has a separate telemetry board and separate event topics (``replay``, ``replay.telemetry``, ``replay.command``,
``replay.event``).
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gss.device.session_events import DeviceEvent, Telemetry
from gss.domain.errors import BadInput, Conflict, GssError, NotFound
from gss.instruments.dictionary.definitions import Dictionary
from gss.instruments.telemetry_roles import Status
from gss.operations.clock import Monotonic
from gss.operations.contacts.capture_decoder import CaptureDecoder, CommandSaid, Replayed
from gss.operations.events import EventBus
from gss.operations.line.capture_files import capture_files
from gss.operations.line.raw_capture import Record, capture_span, read_captures
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.telemetry import TelemetryBoard

SPEEDS = (0.1, 1000.0)
PUBLISH_EVERY_S = 0.2
MAX_NAP_S = 0.2
ACTIVE = ("running", "paused")
"""States in which a replay can be changed."""


@dataclass(frozen=True)
class ReplayState:
    """State of the replay. ``speed``: None for as fast as possible. ``at_s``: current position, Unix seconds of the contact."""

    state: str = "none"
    contact_id: int | None = None
    speed: float | None = None
    start_s: float | None = None
    end_s: float | None = None
    at_s: float | None = None
    packets: int = 0
    commands: int = 0
    events: int = 0
    damaged: int = 0
    foreign: int = 0
    reason: str = ""


@dataclass
class _Counts:
    """Position and counts of the replayed items."""

    at_s: float | None = None
    packets: int = 0
    commands: int = 0
    events: int = 0
    damaged: int = 0
    foreign: int = 0


@dataclass
class _Controls:
    """Settings of the operator. The playback thread reads them between two records. ``seek_s``: time to seek to, None
    if no seek is requested."""

    speed: float | None
    paused: bool = False
    seek_s: float | None = None
    stop: bool = False


class CaptureReplay:
    """Runs one replay at a time in a separate thread."""

    def __init__(
        self,
        dictionary: Dictionary,
        captures: Path,
        limits: LimitBook,
        bus: EventBus,
        monotonic_s: Monotonic,
        status: Status,
        framing: str = "cobs",
    ) -> None:
        self._dictionary, self._captures, self._rule, self._bus = dictionary, captures, limits.rule, bus
        self._monotonic_s, self._status, self._framing = monotonic_s, status, framing
        self._state = ReplayState()
        self._controls, self._counts = _Controls(None), _Counts()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self.board = TelemetryBoard(dictionary, limits.rule, {}, status)
        # The lambda reads self.board at each call because each pass through the capture creates a new board.
        limits.subscribe(lambda key: self.board.limits.limits_changed(key))

    # --- control --------------------------------------------------------------------------------------------------

    def start(self, contact_id: int, speed: float | None, from_s: float | None = None) -> ReplayState:
        """Stop the current replay and replay a contact from its beginning or from ``from_s``. Raises NotFound if the contact
        has no capture."""
        _check_speed(speed)
        files = capture_files(self._captures, contact_id)
        span = capture_span(files)
        if span is None:
            raise NotFound("no capture of this contact", got=str(contact_id), hint="retention removes old captures")
        self.stop()
        self._controls = _Controls(speed, seek_s=from_s)
        self._counts = _Counts(span[0])
        self._state = ReplayState("running", contact_id, speed, *span)
        self._thread = threading.Thread(target=self._run, args=(files,), name="capture-replay", daemon=True)
        self._thread.start()
        return self.state

    def change(
        self,
        *,
        speed: float | None = None,
        as_fast_as_possible: bool = False,
        paused: bool | None = None,
        at_s: float | None = None,
    ) -> ReplayState:
        """Change speed, pause or position. Arguments that are not given leave their setting unchanged. Raises Conflict if no
        replay is running."""
        _check_speed(speed)
        with self._changed:
            if self._state.state not in ACTIVE:
                raise Conflict("no replay is running", got=self._state.state, hint="start the replay again")
            if speed is not None or as_fast_as_possible:
                self._controls.speed = None if as_fast_as_possible else speed
            if paused is not None:
                self._controls.paused = paused
            if at_s is not None:
                self._controls.seek_s = at_s
            self._state = replace(
                self._state, speed=self._controls.speed, state="paused" if self._controls.paused else "running"
            )
            self._changed.notify_all()
        return self.state

    def stop(self) -> ReplayState:
        """Stop the replay. Its telemetry board stays available until the next replay."""
        with self._changed:
            self._controls.stop = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(timeout=5)
            self._thread = None
        if self._state.state in ACTIVE:
            self._publish(state="ended", reason="stopped")
        return self.state

    @property
    def state(self) -> ReplayState:
        """Current state of the replay."""
        return replace(self._state, **vars(self._counts))

    # --- playback thread ------------------------------------------------------------------------------------------

    def _run(self, files: list[Path]) -> None:
        try:
            while self._pass(files):
                pass
        except (OSError, GssError) as error:
            self._publish(state="failed", reason=f"{type(error).__name__}: {error}")

    def _pass(self, files: list[Path]) -> bool:
        """Replay the capture once. Return True if a seek requires another pass from the beginning."""
        decoder, self.board = (
            CaptureDecoder(self._dictionary, self._framing),
            TelemetryBoard(self._dictionary, self._rule, {}, self._status),
        )
        seek_s, self._controls.seek_s = self._controls.seek_s, None
        self._counts = _Counts()
        pace = _Pace(self._monotonic_s)
        published_s = -1e9
        unread: list[str] = []
        for record in read_captures(files, lambda path, count: unread.append(f"{count} bytes of {path.name}")):
            at_s = record[0]
            if seek_s is not None and at_s < seek_s:
                self._take(decoder, record, silent=True)
                if self._controls.stop:
                    return False
                continue
            if not self._wait(pace, at_s):
                return self._seek_requested()
            self._take(decoder, record, silent=False)
            if self._monotonic_s() - published_s >= PUBLISH_EVERY_S:
                published_s = self._monotonic_s()
                self._show(at_s)
        self._show(self._counts.at_s or 0.0)
        with self._changed:  # a seek after the last record still takes effect
            if self._seek_requested():
                return True
            reason = f"damaged: {', '.join(unread)} could not be read" if unread else "end of the capture"
            self._state = replace(self._state, state="ended", reason=reason)
        self._bus.publish("replay", self.state)
        return False

    def _seek_requested(self) -> bool:
        return self._controls.seek_s is not None and not self._controls.stop

    def _wait(self, pace: _Pace, at_s: float) -> bool:
        """Wait until the time ``at_s`` of the contact is due. Return False if the operator requested a stop or a seek."""
        with self._changed:
            while not self._controls.stop and self._controls.seek_s is None:
                if self._controls.paused:
                    pace.forget()
                    self._changed.wait()
                    continue
                left_s = pace.left_s(at_s, self._controls.speed)
                if left_s <= 0:
                    return True
                self._changed.wait(min(left_s, MAX_NAP_S))
            return False

    def _take(self, decoder: CaptureDecoder, record: Record, *, silent: bool) -> None:
        for replayed in decoder.feed(*record):
            self._publish_item(replayed, silent=silent)
        self._counts.at_s, self._counts.damaged, self._counts.foreign = record[0], decoder.damaged, decoder.foreign

    def _publish_item(self, replayed: Replayed, *, silent: bool) -> None:
        item, counts = replayed.item, self._counts
        if isinstance(item, Telemetry):
            self.board.take(item, datetime.fromtimestamp(replayed.at_s, UTC))
            counts.packets += 1
        elif isinstance(item, CommandSaid):
            counts.commands += item.stage == "sent"
            if not silent:
                self._bus.publish("replay.command", replayed)
        elif isinstance(item, DeviceEvent):
            counts.events += 1
            if not silent:
                self._bus.publish("replay.event", replayed)

    def _show(self, at_s: float) -> None:
        self._bus.publish("replay.telemetry", self.board.values(datetime.fromtimestamp(at_s, UTC)))
        self._bus.publish("replay", self.state)

    def _publish(self, **changes: Any) -> None:
        with self._changed:
            self._state = replace(self._state, **changes)
        self._bus.publish("replay", self.state)


class _Pace:
    """Maps times of the contact to this host's monotonic clock. A change of speed continues from the current position."""

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._anchor: tuple[float, float, float] | None = None

    def forget(self) -> None:
        """Discard the time reference. Called after a pause, whose duration must not count as playback time."""
        self._anchor = None

    def left_s(self, at_s: float, speed: float | None) -> float:
        """Return the seconds until the time ``at_s`` of the contact is due; 0 or less if it is due now."""
        if speed is None:
            self._anchor = None
            return 0.0
        now_s = self._monotonic_s()
        if self._anchor is None:
            self._anchor = (now_s, at_s, speed)
        elif self._anchor[2] != speed:
            since_s, from_s, old = self._anchor
            self._anchor = (now_s, min(at_s, from_s + (now_s - since_s) * old), speed)
        since_s, from_s, _ = self._anchor
        return since_s + (at_s - from_s) / speed - now_s


def _check_speed(speed: float | None) -> None:
    low, high = SPEEDS
    if speed is not None and not low <= speed <= high:
        raise BadInput("replay speed out of range", expected=f"{low:g} – {high:g}", got=f"{speed:g}")


def paced(items: Iterator[Replayed], speed: float | None, monotonic_s: Monotonic, sleep: Any) -> Iterator[Replayed]:
    """Yield the items, each at the time when it is due. If ``speed`` is None, yield them without delay."""
    _check_speed(speed)
    pace = _Pace(monotonic_s)
    for item in items:
        left_s = pace.left_s(item.at_s, speed)
        if left_s > 0:
            sleep(left_s)
        yield item
