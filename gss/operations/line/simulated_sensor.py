"""A simulated sensor as a child process. It starts at once and gets ready while the server loads; one that dies is started again
on its flash, as a unit comes back after its supply was cut."""

from __future__ import annotations

import contextlib
import logging
import shlex
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from gss.domain.errors import GssError
from gss.domain.profiles import profile

WAIT_S = 60.0
AGAIN_S = (1.0, 2.0, 5.0, 15.0, 30.0)
"""Before each further start; one that ran for longer than the last of these counts as a first one again."""
log = logging.getLogger("gss.simulator")


class SimulatedSensor:
    """A started simulator; its line can be opened after :meth:`url` has returned."""

    def __init__(
        self, profile_name: str, folder: Path, baud: int, seed: int, framing: str = "cobs", options: str = ""
    ) -> None:
        profile(profile_name)
        folder.mkdir(parents=True, exist_ok=True)
        # A name of its own, so that the port can vanish and come back as a pulled plug does.
        self._line = folder / "line"
        command = [sys.executable, "-m", "gss.device.simulator", "--profile", profile_name, "--pty"]
        command += ["--state-dir", str(folder), "--baud", str(baud), "--seed", str(seed)]
        command += ["--symlink", str(self._line), *shlex.split(options)]
        # However the server ends, its end of standard input closes: no simulator is left behind with the flash in its hands.
        command += ["--exit-with-stdin"]
        if framing != "cobs":
            command += ["--framing", framing]
        self._command = command
        self._log_path = folder / "simulator.log"
        self._log = self._log_path.open("ab")
        self._stopping = threading.Event()
        self.told: Callable[[str], object] = log.warning
        """Hears that the simulator ended and that it is there again."""
        self._process = self._start()
        self._watcher: threading.Thread | None = None

    @property
    def pid(self) -> int:
        """Of the process that runs now."""
        return self._process.pid

    def _start(self) -> subprocess.Popen[str]:
        pipe, log = subprocess.PIPE, self._log
        return subprocess.Popen(self._command, stdin=pipe, stdout=pipe, stderr=log, text=True)  # noqa: S603 - our own

    def url(self) -> str:
        """Address of its line, as soon as it says READY; GssError when it ends before. From then on it is watched."""
        url = self._ready()
        self._watcher = threading.Thread(target=self._watch, name="simulator", daemon=True)
        self._watcher.start()
        return url

    def _ready(self) -> str:
        process = self._process
        if process.stdout is None:
            raise GssError("the simulator has no output")
        timer = threading.Timer(WAIT_S, process.kill)
        timer.start()
        try:
            for line in process.stdout:
                if line.startswith("READY "):
                    return line.split(maxsplit=1)[1].strip()
        finally:
            timer.cancel()
        raise GssError("the simulator did not start", expected="a line READY …", hint=f"see {self._log_path}")

    def _watch(self) -> None:
        """Start it again whenever it ends by itself, after ever longer pauses."""
        tries = 0
        while True:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=AGAIN_S[-1])
                tries += 1
            if self._stopping.is_set():
                return
            if self._process.poll() is None:
                tries = 0
                continue
            code = self._process.returncode
            _close(self._process)
            # The number of a dead terminal is soon that of another one: nothing may be opened behind the old name.
            self._line.unlink(missing_ok=True)
            pause_s = AGAIN_S[min(tries, len(AGAIN_S)) - 1]
            self._tell(f"the simulated sensor ended with code {code}; it is started again in {pause_s:g} s")
            if self._stopping.wait(pause_s):
                return
            self._process = self._start()
            try:
                self._ready()
                self._tell("the simulated sensor is there again, on the flash it had")
            except GssError as error:
                self._tell(str(error))

    def _tell(self, text: str) -> None:
        try:
            self.told(text)
        except GssError:
            log.exception("not recorded: %s", text)

    def stop(self) -> None:
        """End it; gently first."""
        self._stopping.set()
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=5)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        if self._watcher is not None:
            self._watcher.join(timeout=5)
        _close(self._process)
        self._log.close()


def _close(process: subprocess.Popen[str]) -> None:
    for end in (process.stdin, process.stdout):
        if end:
            end.close()


@contextlib.contextmanager
def simulated_sensor(
    profile_name: str, folder: Path, baud: int, seed: int, framing: str = "cobs", options: str = ""
) -> Iterator[SimulatedSensor]:
    """A simulator that ends with the block."""
    sensor = SimulatedSensor(profile_name, folder, baud, seed, framing, options)
    try:
        yield sensor
    finally:
        sensor.stop()
