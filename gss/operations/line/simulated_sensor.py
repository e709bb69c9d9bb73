"""A simulated sensor as a child process. It starts at once and gets ready while the server loads."""

from __future__ import annotations

import contextlib
import shlex
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from gss.domain.errors import GssError
from gss.domain.profiles import profile

WAIT_S = 60.0


class SimulatedSensor:
    """A started simulator; its line can be opened after :meth:`url` has returned."""

    def __init__(
        self, profile_name: str, folder: Path, baud: int, seed: int, framing: str = "cobs", options: str = ""
    ) -> None:
        profile(profile_name)
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "gss.device.simulator", "--profile", profile_name, "--pty"]
        command += ["--state-dir", str(folder), "--baud", str(baud), "--seed", str(seed)]
        # A name of its own, so that the port can vanish and come back as a pulled plug does.
        command += ["--symlink", str(folder / "line"), *shlex.split(options)]
        # However the server ends, its end of standard input closes: no simulator is left behind with the flash in its hands.
        command += ["--exit-with-stdin"]
        if framing != "cobs":
            command += ["--framing", framing]
        self._log_path = folder / "simulator.log"
        self._log = self._log_path.open("ab")
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._log, text=True)  # noqa: S603

    def url(self) -> str:
        """Address of its line, as soon as it says READY; GssError when it ends before."""
        if self._process.stdout is None:
            raise GssError("the simulator has no output")
        timer = threading.Timer(WAIT_S, self._process.kill)
        timer.start()
        try:
            for line in self._process.stdout:
                if line.startswith("READY "):
                    return line.split(maxsplit=1)[1].strip()
        finally:
            timer.cancel()
        raise GssError("the simulator did not start", expected="a line READY …", hint=f"see {self._log_path}")

    def stop(self) -> None:
        """End it; gently first."""
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=5)
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        for end in (self._process.stdin, self._process.stdout):
            if end:
                end.close()
        self._log.close()


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
