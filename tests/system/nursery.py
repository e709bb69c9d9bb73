"""Preloaded processes: one process imports everything once, and each server or simulator of the tests is forked from
it.

They are ordinary processes and can be killed separately; only the four seconds of imports are shared.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

ENOUGH = 1 << 16


class Hatched:
    """A forked process, with the interface of subprocess.Popen."""

    def __init__(self, pid: int, stdout: io.TextIOWrapper) -> None:
        self.pid, self.stdout, self.returncode = pid, stdout, None
        self.ended = threading.Event()

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        if not self.ended.wait(timeout):
            raise subprocess.TimeoutExpired("hatched", timeout or 0)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)


class Nursery:
    """Interface of the tests to the preloaded process."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        command = [sys.executable, __file__, str(theirs.fileno())]
        self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], env=environment)
        theirs.close()
        self._lock, self._pids, self._born = threading.Lock(), threading.Event(), 0
        self._children: dict[int, Hatched] = {}
        self._exits: dict[int, int] = {}
        threading.Thread(target=self._listen, daemon=True).start()

    def hatch(self, what: str, arguments: list[str], environment: dict[str, str], stderr: int) -> Hatched:
        """Start ``gss`` or ``simulator`` with these arguments."""
        read, write = os.pipe()
        with self._lock:
            self._pids.clear()
            order = json.dumps({"what": what, "arguments": arguments, "environment": environment}).encode()
            socket.send_fds(self._socket, [order], [write, stderr])
            os.close(write)
            assert self._pids.wait(120), "the nursery does not answer"
            child = Hatched(self._born, os.fdopen(read, "r"))
            self._children[child.pid] = child
            if child.pid in self._exits:
                self._over(child.pid, self._exits.pop(child.pid))
        return child

    def _listen(self) -> None:
        for line in self._socket.makefile("r"):
            word, pid, code = line.split()
            if word == "born":
                self._born = int(pid)
                self._pids.set()
            else:
                self._over(int(pid), int(code))

    def _over(self, pid: int, code: int) -> None:
        child = self._children.pop(pid, None)
        if child is None:
            self._exits[pid] = code
            return
        child.returncode = code
        child.ended.set()

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(timeout=20)


# --- the process itself ----------------------------------------------------------------------------------------------


def load() -> None:
    """Import and read everything that a server or a simulator needs at its start."""
    import uvicorn  # noqa: F401

    import gss.api.app
    import gss.cli
    import gss.device.simulator.__main__
    import gss.wiring.build
    from gss.catalogue_tools.sources.hipparcos import load_stars
    from gss.instruments.dictionary.read_dictionary import load_dictionary

    gss.cli.full_parser()
    load_stars()
    load_dictionary()


def main(descriptor: int) -> None:
    """Fork on each request of the tests and report started and ended processes."""
    load()
    channel = socket.socket(fileno=descriptor)
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    while True:
        ready, _, _ = select.select([channel, woken], [], [], 5.0)
        if woken in ready:
            os.read(woken, ENOUGH)
        _report_ended(channel)
        if channel not in ready:
            continue
        order, descriptors, _, _ = socket.recv_fds(channel, ENOUGH, 2)
        if not order:
            return
        pid = os.fork()
        if pid == 0:
            signal.set_wakeup_fd(-1)
            for open_end in (woken, wake):
                os.close(open_end)
            channel.close()
            _live(json.loads(order), descriptors)
        for taken in descriptors:
            os.close(taken)
        channel.sendall(f"born {pid} 0\n".encode())


def _report_ended(channel: socket.socket) -> None:
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        channel.sendall(f"dead {pid} {os.waitstatus_to_exitcode(status)}\n".encode())


def _live(order: dict[str, Any], descriptors: list[int]) -> None:
    """Set streams, environment and signals of the child process, run its command, and exit."""
    code = 1
    try:
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for target, source in enumerate((nothing, *descriptors)):
            os.dup2(source, target)
        for source in (nothing, *descriptors):
            os.close(source)
        os.environ.clear()
        os.environ.update(order["environment"])
        sys.path[:0] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        sys.argv = [order["what"], *order["arguments"]]
        code = _run(order["what"], order["arguments"])
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:  # as the interpreter would end
        import traceback

        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(code)


def _run(what: str, arguments: list[str]) -> int:
    if what == "gss":
        from gss.cli import main as gss_main

        return gss_main(arguments)
    from gss.device.simulator.__main__ import main as simulator_main

    return int(simulator_main(arguments) or 0)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))
    time.tzset()
    main(int(sys.argv[1]))
