"""Mission time of a rehearsal, the simulated unit that follows this time, and the line between ground and unit.

Time advances in steps. Each step begins only after ground and unit have finished all work that was due. Therefore a
rehearsal runs as fast as the machine permits, and its results do not depend on the load of the machine.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from pathlib import Path

from gss.device.line_address import CAN
from gss.device.transport import ByteStream, open_stream
from gss.domain.errors import GssError, LinkDown
from gss.instruments.package_files import LinkFile
from gss.operations.clock import Clock

MONOTONIC_START_S = 1000.0
START_WITHIN_S = 120.0
ROUND_WITHIN_S = 60.0
URL = "rehearsal://simulated-unit"


class SteppedClock:
    """A clock that only the rehearsal advances."""

    def __init__(self, start: datetime) -> None:
        self._start, self._elapsed_s = start, 0.0

    def now(self) -> datetime:
        """Return mission time in UTC."""
        return self._start + timedelta(seconds=self._elapsed_s)

    def monotonic_s(self) -> float:
        """Return monotonic mission time in seconds."""
        return MONOTONIC_START_S + self._elapsed_s

    def advance(self, seconds: float) -> None:
        """Advance UTC and monotonic time."""
        self._elapsed_s += seconds

    @property
    def clock(self) -> Clock:
        """The clock for the wiring."""
        return Clock(self.now, self.monotonic_s)


class SteppedUnit:
    """A simulated unit in a child process, whose time advances by ``step`` and ``skip``."""

    def __init__(self, process: subprocess.Popen[str], stream: ByteStream) -> None:
        self._process, self.stream = process, stream

    def step(self, seconds: float) -> None:
        """Advance the unit. The data that it sends in this time can be read afterwards."""
        self._order(f"step {seconds:.6f}")

    def skip(self, seconds: float) -> None:
        """Set the unit's clock forward in one jump. The data that it would have sent in this time are lost."""
        self._order(f"skip {seconds:.6f}")

    def _order(self, order: str) -> None:
        if self._process.stdin is None or self._process.stdout is None:
            raise GssError("the simulated unit has no input or output")
        try:
            self._process.stdin.write(f"{order}\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline().strip()
        except OSError as error:
            raise GssError("the simulated unit ended", got=str(error)) from error
        if not answer.startswith("time "):
            raise GssError(
                "the simulated unit did not confirm a step", expected="time T", got=answer or "the unit ended"
            )


@contextlib.contextmanager
def stepped_unit(
    package: Path, link: LinkFile, folder: Path, baud: int, seed: int, options: Sequence[str]
) -> Iterator[SteppedUnit]:
    """Run a simulated unit with new flash during the ``with`` block. ``baud`` 0: use the instrument's rate. Raises
    GssError."""
    folder.mkdir(parents=True, exist_ok=True)
    line_option = ["--can", "0"] if link.framing == CAN else ["--tcp", "0"]
    command = [sys.executable, "-m", "gss.device.simulator", "--instrument", str(package), *line_option]
    command += ["--baud", str(baud or link.baud), "--seed", str(seed), "--stepped", "--paced", *options]
    with (folder / "simulator.log").open("ab") as log:
        process = subprocess.Popen(  # noqa: S603 - a fixed command of GSS
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
        )
    timer = threading.Timer(START_WITHIN_S, process.kill)
    timer.start()
    try:
        ready = process.stdout.readline() if process.stdout else ""
        if not ready.startswith("READY "):
            raise GssError("the simulated unit did not start", hint=f"see {log.name}")
        timer.cancel()
        stream = open_stream(ready.split(maxsplit=1)[1].strip(), baud or link.baud)
        try:
            yield SteppedUnit(process, stream)
        finally:
            stream.close()
    finally:
        timer.cancel()
        process.kill()
        process.wait()
        for end in (process.stdin, process.stdout):
            if end:
                end.close()


class RehearsalLine:
    """The ground's end of the line. It always connects to the simulated unit, regardless of the address. Each read
    waits until the rehearsal grants a round. Outside a pass, data in both directions are lost.

    ``in_view``: true while the signal is present; ``lost``: bytes that the ground sent without a signal; ``up``,
    ``down``: bytes carried.
    """

    url = URL

    def __init__(self, unit: ByteStream) -> None:
        self._unit = unit
        self._condition = threading.Condition()
        self._granted, self._waiting, self._ended = False, False, False
        self.in_view, self.wrote = False, False
        self.lost = self.up = self.down = 0

    def open(self, url: str, baud: int) -> ByteStream:
        """Return this line. The arguments are ignored."""
        del url, baud
        return self

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Wait for the next round and return the data that the unit has sent. Raises LinkDown at the end of the
        rehearsal."""
        del timeout_s
        with self._condition:
            self._waiting = True
            self._condition.notify_all()
            self._condition.wait_for(lambda: self._granted or self._ended)
            if self._ended:
                raise LinkDown("the rehearsal has ended")
            self._granted = self._waiting = False
        data = self._unit.read(max_bytes, 0)
        self.down += len(data) if self.in_view else 0
        return data if self.in_view else b""

    def write(self, data: bytes) -> None:
        """Send bytes to the unit. The bytes are lost if no signal is present."""
        if not self.in_view:
            self.lost += len(data)
            return
        self._unit.write(data)
        self.up, self.wrote = self.up + len(data), True

    def close(self) -> None:
        """Do nothing, because the rehearsal owns the unit."""

    def round(self) -> None:
        """Let the ground read and write once, and wait until it has finished. Raises GssError after ROUND_WITHIN_S
        seconds."""
        with self._condition:
            if self._condition.wait_for(lambda: self._waiting, ROUND_WITHIN_S):
                self._granted = True
                self._condition.notify_all()
                if self._condition.wait_for(lambda: self._waiting and not self._granted, ROUND_WITHIN_S):
                    return
        raise GssError("the rehearsal stopped", got=f"the line made no progress for {ROUND_WITHIN_S:g} s")

    def end(self) -> None:
        """End the line: a waiting read raises LinkDown."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()
