"""Replays the capture of a past contact at any speed into a separate view. Live data is never changed.

The replay has its own board and its own topics (``replay``, ``replay.telemetry``, ``replay.command``, ``replay.event``).
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


@dataclass(frozen=True)
class ReplayState:
    """State of the replay. ``speed`` None: as fast as possible. ``at_s``: Unix seconds of the replayed contact."""

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
    """Counts of what the thread has replayed so far."""

    at_s: float | None = None
    packets: int = 0
    commands: int = 0
    events: int = 0
    damaged: int = 0
    foreign: int = 0


@dataclass
class _Orders:
    """The operator's requests, which the thread checks between two records. ``seek_s``: time to seek to."""

    speed: float | None
    paused: bool = False
    seek_s: float | None = None
    stop: bool = False


class CaptureReplay:
    """Runs one replay at a time on a separate thread."""

    def __init__(
        self,
        dictionary: Dictionary,
        captures: Path,
        limits: LimitBook,
        bus: EventBus,
        monotonic_s: Monotonic,
        framing: str = "cobs",
    ) -> None:
        self._dictionary, self._captures, self._rule, self._bus = dictionary, captures, limits.rule, bus
        self._monotonic_s, self._framing = monotonic_s, framing
        self._state = ReplayState()
        self._orders, self._counts = _Orders(None), _Counts()
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self.board = TelemetryBoard(dictionary, limits.rule, {})
        limits.subscribe(lambda key: self.board.limits.limits_changed(key))  # not bound: each pass has a new board

    # --- control --------------------------------------------------------------------------------------------------

    def start(self, contact_id: int, speed: float | None, from_s: float | None = None) -> ReplayState:
        """Replay a contact from its beginning or from ``from_s``. Stops the replay in progress. Raises NotFound without a
        capture."""
        _check_speed(speed)
        files = capture_files(self._captures, contact_id)
        span = capture_span(files)
        if span is None:
            raise NotFound("no capture of this contact", got=str(contact_id), hint="retention removes old captures")
        self.stop()
        self._orders = _Orders(speed, seek_s=from_s)
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
        """Change speed, pause or position; what is not given remains unchanged. Raises Conflict if nothing is being
        replayed."""
        _check_speed(speed)
        if self._thread is None or not self._thread.is_alive():
            raise Conflict("no replay is running", got=self._state.state, hint="start the replay again")
        with self._changed:
            if speed is not None or as_fast_as_possible:
                self._orders.speed = None if as_fast_as_possible else speed
            if paused is not None:
                self._orders.paused = paused
            if at_s is not None:
                self._orders.seek_s = at_s
            self._state = replace(
                self._state, speed=self._orders.speed, state="paused" if self._orders.paused else "running"
            )
            self._changed.notify_all()
        return self.state

    def stop(self) -> ReplayState:
        """Stop the replay; its board is kept until the next one."""
        with self._changed:
            self._orders.stop = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(timeout=5)
            self._thread = None
        if self._state.state in ("running", "paused"):
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
        """Run once through the capture. Return True if a seek needs another pass from the beginning."""
        decoder, self.board = (
            CaptureDecoder(self._dictionary, self._framing),
            TelemetryBoard(self._dictionary, self._rule, {}),
        )
        seek_s, self._orders.seek_s = self._orders.seek_s, None
        self._counts = _Counts()
        player = _Pace(self._monotonic_s)
        published_s = -1e9
        unread: list[str] = []
        for record in read_captures(files, lambda path, count: unread.append(f"{count} bytes of {path.name}")):
            at_s = record[0]
            if seek_s is not None and at_s < seek_s:
                self._take(decoder, record, silent=True)
                if self._orders.stop:
                    return False
                continue
            if not self._wait(player, at_s):
                return self._goes_elsewhere()
            self._take(decoder, record, silent=False)
            if self._monotonic_s() - published_s >= PUBLISH_EVERY_S:
                published_s = self._monotonic_s()
                self._show(at_s)
        self._show(self._counts.at_s or 0.0)
        self._publish(
            state="ended", reason=f"damaged: {', '.join(unread)} could not be read" if unread else "the capture's end"
        )
        return False

    def _goes_elsewhere(self) -> bool:
        return self._orders.seek_s is not None and not self._orders.stop

    def _wait(self, player: _Pace, at_s: float) -> bool:
        """Wait until ``at_s`` of the contact is due. Return False if the operator requested a stop or a seek."""
        with self._changed:
            while not self._orders.stop and self._orders.seek_s is None:
                if self._orders.paused:
                    player.forget()
                    self._changed.wait()
                    continue
                left_s = player.left_s(at_s, self._orders.speed)
                if left_s <= 0:
                    return True
                self._changed.wait(min(left_s, MAX_NAP_S))
            return False

    def _take(self, decoder: CaptureDecoder, record: Record, *, silent: bool) -> None:
        for replayed in decoder.feed(*record):
            self._one(replayed, silent=silent)
        self._counts.at_s, self._counts.damaged, self._counts.foreign = record[0], decoder.damaged, decoder.foreign

    def _one(self, replayed: Replayed, *, silent: bool) -> None:
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
        self._state = replace(self._state, **changes)
        self._bus.publish("replay", self.state)


class _Pace:
    """Maps times of the contact to this host's monotonic clock. A change of speed continues from the current position."""

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._anchor: tuple[float, float, float] | None = None

    def forget(self) -> None:
        """Exclude the time until the next call: the replay is paused."""
        self._anchor = None

    def left_s(self, at_s: float, speed: float | None) -> float:
        """Seconds to wait; 0 or less if due now."""
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
    """Yield the same items, each when it is due; without delay if ``speed`` is None."""
    _check_speed(speed)
    pace = _Pace(monotonic_s)
    for item in items:
        left_s = pace.left_s(item.at_s, speed)
        if left_s > 0:
            sleep(left_s)
        yield item
