"""Start, restart and stop child processes: API workers or units."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess

from gss.domain.errors import Conflict
from gss.operations.clock import monotonic_s

FIRST_WAIT_S, MAX_WAIT_S = 0.2, 10.0
RECHECK_S = 1.0
"""Time between two checks of a process that cannot be started."""
STEADY_S = 30.0
STOP_WITHIN_S = 3.5
"""Time limit for stopping the child processes. It is shorter than the limit for stopping the link process
(gss.api.stopping)."""


@dataclass(frozen=True)
class ProcessState:
    """State of a supervised process. ``pid``: None while it does not run; ``restarts``: number of restarts since the
    supervisor started; ``last_end``: reason of the last exit, "" if it has not exited; ``start_s``: monotonic time of
    its start in seconds, None while it does not run; ``obstacle``: why it is not started, "" if it can be started."""

    pid: int | None = None
    restarts: int = 0
    last_end: str = ""
    start_s: float | None = None
    obstacle: str = ""


def no_obstacle(_name: str) -> str:
    """Return "": the process can always be started."""
    return ""


class Supervisor:
    """Keeps processes running until :meth:`stop`. ``targets``: picklable functions by process name; ``report``: called
    with a text when a process has ended or cannot be started; ``obstacle``: returns for the name of a process why it
    would end at once, or "". While there is an obstacle, the process is not started and the check is repeated."""

    def __init__(
        self,
        targets: Mapping[str, Callable[[], None]],
        report: Callable[[str], None],
        obstacle: Callable[[str], str],
    ) -> None:
        self._targets, self._report, self._obstacle = targets, report, obstacle
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._processes: dict[str, SpawnProcess] = {}
        self._states = dict.fromkeys(targets, ProcessState())
        self._requested: dict[str, str] = {}
        """Cause of a requested restart by process name, until the process has ended."""
        self._threads = [threading.Thread(target=self._keep_running, args=(name,), daemon=True) for name in targets]

    def start(self) -> None:
        """Start the processes."""
        for thread in self._threads:
            thread.start()

    def state(self, name: str) -> ProcessState:
        """Return the state of a process."""
        with self._lock:
            return self._states[name]

    def restart(self, name: str, cause: str) -> None:
        """End a process, which is then started again. A process that runs longer than ``STOP_WITHIN_S`` is killed, so
        that a process that hangs is restarted too. ``cause``: reason of the exit in the state and in the report. Raises
        Conflict if the process does not run."""
        with self._lock:
            if self._states[name].pid is None:
                raise Conflict(f"{name} does not run", hint="it is started automatically as soon as it can run")
            process, self._requested[name] = self._processes[name], cause
        process.terminate()
        # The thread of the process reads its exit code; to join it here too would be a race for this code.
        if not wait([process.sentinel], STOP_WITHIN_S):
            process.kill()

    def stop(self) -> None:
        """Let the processes complete their requests. Kill processes that run longer than ``STOP_WITHIN_S``."""
        self._stopping.set()
        with self._lock:
            processes = list(self._processes.values())
        for process in processes:
            process.terminate()
        end_s = monotonic_s() + STOP_WITHIN_S
        for process in processes:
            process.join(max(0.0, end_s - monotonic_s()))
            if process.exitcode is None:
                process.kill()
                process.join()

    def _keep_running(self, name: str) -> None:
        wait_s = 0.0
        while not self._stopping.wait(wait_s):
            if not self._can_start(name):
                wait_s = RECHECK_S
                continue
            since_s = monotonic_s()
            process = self._start_process(name)
            if process is None:
                return
            process.join()
            if self._stopping.is_set():
                return
            code = process.exitcode or 0
            with self._lock:
                requested = self._requested.pop(name, "")
                cause = requested or (f"signal {-code}" if code < 0 else f"code {code}")
                self._states[name] = ProcessState(None, self._states[name].restarts + 1, cause)
            self._report(f"{name} ended ({cause}); restarting it")
            steady = bool(requested) or monotonic_s() - since_s > STEADY_S
            wait_s = 0.0 if steady else min(MAX_WAIT_S, max(FIRST_WAIT_S, 2 * wait_s))

    def _can_start(self, name: str) -> bool:
        """Check for an obstacle, store it in the state, and report a new one."""
        obstacle = self._obstacle(name)
        with self._lock:
            before = self._states[name].obstacle
            self._states[name] = replace(self._states[name], obstacle=obstacle)
        if obstacle and obstacle != before:
            self._report(f"{name} cannot start: {obstacle}")
        return not obstacle

    def _start_process(self, name: str) -> SpawnProcess | None:
        """Return a new process, or None if the supervisor is stopping."""
        with self._lock:
            if self._stopping.is_set():
                return None
            process = multiprocessing.get_context("spawn").Process(target=self._targets[name])
            process.start()
            self._processes[name] = process
            self._states[name] = replace(self._states[name], pid=process.pid, start_s=monotonic_s())
            return process
