"""Simulated time: at real speed, at another speed, or stepped by commands."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Protocol

from gss.domain.callbacks import never
from gss.domain.errors import BadInput

FASTEST = 1000.0
MAX_STEP_S = 86_400.0
MAX_SKIP_S = 14 * 86_400.0
TICK_S = 0.01
SETTLE_TURNS = 3
MAX_ORDER_BYTES = 200


class SimulatedClock:
    """Simulated seconds since the start. ``real``: the real clock. While the clock is stopped, only ``advance`` changes
    the time."""

    def __init__(
        self, speed: float = 1.0, *, stopped: bool = False, real: Callable[[], float] = time.monotonic
    ) -> None:
        self._speed, self._real, self.stopped = _checked_speed(speed), real, stopped
        self._base_s, self._since_s = 0.0, real()

    def __call__(self) -> float:
        """Return the simulated seconds now."""
        return self._base_s if self.stopped else self._base_s + (self._real() - self._since_s) * self._speed

    def utc_zero_s(self) -> float:
        """Return UTC at simulated time zero, as Unix time; valid only while time runs at real speed."""
        return time.time() - self()

    def hold(self) -> None:
        """Stop the clock."""
        self._base_s, self.stopped = self(), True

    def run(self, speed: float | None = None) -> None:
        """Run with the real clock. ``speed``: new speed; None keeps the speed."""
        new_speed = self._speed if speed is None else _checked_speed(speed)
        self._base_s, self._since_s, self._speed, self.stopped = self(), self._real(), new_speed, False

    def advance(self, seconds: float) -> None:
        """Step a stopped clock. Raises BadInput while it runs."""
        if not self.stopped:
            raise BadInput("the clock is running", expected="pause before step")
        self._base_s += seconds


class Paced(Protocol):
    """Interface of an object that simulated time drives: the terminal."""

    paced: bool

    def run_once(self, wait_s: float, extra_handles: list[int] | None = None) -> list[int]: ...


class TimeControl:
    """Time commands, one per line: ``step SECONDS``, ``skip SECONDS``, ``run [SPEED]``, ``pause``, ``time``.

    Each command is answered by one line: ``time T``, ``running``, ``paused T`` or ``error …``. A step advances in ticks
    of 10 ms; bytes received on the line are read before the first tick. Therefore the same commands at the same times
    produce the same bytes. A skip advances the time in one tick. Events during a skip are only approximated, as after a
    pause of the process.
    """

    def __init__(self, clock: SimulatedClock, terminal: Paced, stopping: Callable[[], bool] = never) -> None:
        self._clock, self._terminal, self._stopping = clock, terminal, stopping
        self._partial_line = b""

    def feed(self, data: bytes) -> Iterator[str]:
        """Execute complete commands and yield their answers."""
        *lines, self._partial_line = (self._partial_line + data).split(b"\n")
        self._partial_line = self._partial_line[-MAX_ORDER_BYTES:]
        for line in lines:
            words = line.decode("utf-8", "replace").split()
            if words:
                yield self._execute(words[0], words[1:])

    def _execute(self, order: str, words: list[str]) -> str:
        try:
            if order == "step" and len(words) == 1:
                self._step(_number(words[0], MAX_STEP_S))
                return f"time {self._clock():.6f}"
            if order == "skip" and len(words) == 1:
                self._clock.advance(_number(words[0], MAX_SKIP_S))
                self._terminal.run_once(0.0)
                return f"time {self._clock():.6f}"
            if order == "run" and len(words) <= 1:
                self._clock.run(_number(words[0], FASTEST) if words else None)
                self._terminal.paced = True
                return "running"
            if order == "pause" and not words:
                self._clock.hold()
                self._terminal.paced = False
                return f"paused {self._clock():.6f}"
            if order == "time" and not words:
                return f"time {self._clock():.6f}"
        except BadInput as error:
            return f"error {error}"
        return "error unknown order; expected step SECONDS | skip SECONDS | run [SPEED] | pause | time"

    def _step(self, seconds: float) -> None:
        for _ in range(SETTLE_TURNS):
            self._terminal.run_once(0.0)
        ticks = max(1, round(seconds / TICK_S))
        for _ in range(ticks):
            self._clock.advance(seconds / ticks)
            self._terminal.run_once(0.0)
            if self._stopping():
                return


def _number(text: str, maximum: float) -> float:
    try:
        value = float(text)
    except ValueError:
        raise BadInput("the number cannot be read", expected="digits", got=text) from None
    if not 0 < value <= maximum:
        raise BadInput("number is out of range", expected=f"above 0, at most {maximum:g}", got=text)
    return value


def _checked_speed(speed: float) -> float:
    if not 0 < speed <= FASTEST:
        raise BadInput("speed is out of range", expected=f"above 0, at most {FASTEST:g}", got=f"{speed:g}")
    return speed
