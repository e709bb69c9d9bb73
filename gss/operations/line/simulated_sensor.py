"""A simulated sensor in a child process. It starts immediately and initializes while the server loads. If it dies, it is
restarted with its flash content, as a unit restarts after a power cut."""

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

WAIT_S = 60.0
BUSY_HINT = "the machine is probably busy; start the server again later"
AGAIN_S = (1.0, 2.0, 5.0, 15.0, 30.0)
"""Pauses in seconds before successive restarts. After a process has run for longer than the last pause, the sequence
starts again."""
log = logging.getLogger("gss.simulator")


class SimulatedSensor:
    """A started simulator. Its line can be opened after :meth:`url` has returned."""

    def __init__(
        self, package: Path, folder: Path, baud: int, seed: int, framing: str = "cobs", options: str = ""
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        # With a fixed symlink, the port disappears and returns under the same name, as after pulling a plug.
        self._line = folder / "line"
        command = [sys.executable, "-m", "gss.device.simulator", "--instrument", str(package), "--pty"]
        command += ["--state-dir", str(folder), "--baud", str(baud), "--seed", str(seed)]
        command += ["--symlink", str(self._line), *shlex.split(options)]
        # The operating system closes the simulator's standard input when the server ends for any reason, and the
        # simulator then ends too.
        command += ["--exit-with-stdin"]
        if framing:
            command += ["--framing", framing]
        self._command = command
        self._log_path = folder / "simulator.log"
        self._log = self._log_path.open("ab")
        self._stopping = threading.Event()
        self._process = self._start()
        self._watcher: threading.Thread | None = None

    @property
    def pid(self) -> int:
        """Id of the current process."""
        return self._process.pid

    def _start(self) -> subprocess.Popen[str]:
        pipe, log = subprocess.PIPE, self._log
        return subprocess.Popen(self._command, stdin=pipe, stdout=pipe, stderr=log, text=True)  # noqa: S603 - our own

    def url(self) -> str:
        """Wait for READY and return the address of the simulator's line. Raises GssError if the process ends earlier or does
        not start in time."""
        return self._ready()

    def watch(self, report: Callable[[str], object]) -> None:
        """Start the thread that restarts the process when it ends. ``report``: called with a text when the simulator ends and
        when it runs again."""
        self._watcher = threading.Thread(target=self._keep_running, args=(report,), name="simulator", daemon=True)
        self._watcher.start()

    def _ready(self) -> str:
        process = self._process
        if process.stdout is None:
            raise GssError("the simulator has no output")
        timed_out = threading.Event()

        def give_up() -> None:
            timed_out.set()
            process.kill()

        timer = threading.Timer(WAIT_S, give_up)
        timer.start()
        try:
            for line in process.stdout:
                if line.startswith("READY "):
                    return line.split(maxsplit=1)[1].strip()
        finally:
            timer.cancel()
        if timed_out.is_set():
            raise GssError("the simulator did not start in time", expected=f"ready within {WAIT_S:g} s", hint=BUSY_HINT)
        raise GssError("the simulator ended before it was ready", hint=f"see {self._log_path}")

    def _keep_running(self, report: Callable[[str], object]) -> None:
        """Restart the process each time it ends, unless ``stop`` was called. The waiting time increases."""
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
            # The system can reuse the number of the closed terminal, so the old symlink must be removed.
            self._line.unlink(missing_ok=True)
            pause_s = AGAIN_S[min(tries, len(AGAIN_S)) - 1]
            self._report(report, f"the simulated sensor ended with code {code}; restarting in {pause_s:g} s")
            if self._stopping.wait(pause_s):
                return
            self._process = self._start()
            try:
                self._ready()
                self._report(report, "the simulated sensor was restarted with its previous flash")
            except GssError as error:
                self._report(report, str(error))

    def _report(self, report: Callable[[str], object], text: str) -> None:
        try:
            report(text)
        except GssError:
            log.exception("not recorded: %s", text)

    def stop(self) -> None:
        """Stop the process: terminate it, and kill it after 5 s."""
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
    for pipe in (process.stdin, process.stdout):
        if pipe:
            pipe.close()


@contextlib.contextmanager
def simulated_sensor(
    package: Path, folder: Path, baud: int, seed: int, framing: str = "cobs", options: str = ""
) -> Iterator[SimulatedSensor]:
    """Run a simulator for the duration of the block."""
    sensor = SimulatedSensor(package, folder, baud, seed, framing, options)
    try:
        yield sensor
    finally:
        sensor.stop()
