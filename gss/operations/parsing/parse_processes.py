"""Parsing of untrusted files in child processes. If a file makes a library hang, crash or exhaust the memory, only the
child process ends.

A file that was uploaded or named on the command line is parsed here if a library decodes it. Short texts (a TLE, a
manifest, rows of bench measurements) are limited in length and parsed in the server process.

A child is started as a new program, because ``fork`` would copy locks that other threads hold. The start takes 0.1 to
0.6 s, mostly for the import of astropy. A child inherits no open files, no sockets and no environment variables that
can contain secrets. It ends with the server. It is reused only if it could read its last file. The limits protect the
server from files that are too expensive to read. They are not a sandbox against code execution through a defect of a
library.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import BinaryIO, Self, TypeVar

from gss.domain.errors import BadInput, Busy, CorruptData, GssError, TooCostly
from gss.operations.parsing.parse_worker import HEAD, REFUSED, ParseJob, ParseLimits, read_into, write_message
from gss.operations.parsing.plain_data import decode

WORKER = "gss.operations.parsing.parse_worker"
SECRET_SETTINGS = ("GSS_", "AWS_", "PG")
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
"""Environment variables that reduce the reserved address space, which counts towards the memory limit. They disable
thread pools, and Arrow then uses the allocator of the system."""
MAX_REPLY_TEXT = 16 << 20
EXIT_WITHIN_S = 5.0
"""Maximum time from the end of the child's output to the end of its process."""
EXPECTED_ERRORS: dict[str, type[GssError]] = {"BadInput": BadInput, "CorruptData": CorruptData}
Result = TypeVar("Result")
log = logging.getLogger("gss.parsing")


@dataclass(frozen=True)
class ParsingQueue:
    """Limits of the queue. ``at_once``: files parsed concurrently. ``waiting``: additional requests that can wait. ``wait_s``:
    maximum waiting time.

    A waiting request occupies one of the server's 40 request threads. ABORT has a separate thread.
    """

    at_once: int = 2
    waiting: int = 14
    wait_s: float = 15.0


class ParseProcesses:
    """Starts child processes for files, reuses one idle child, and ends all children in :meth:`stop`. Thread-safe."""

    def __init__(self, limits: ParseLimits | None = None, turns: ParsingQueue | None = None) -> None:
        self._limits, self._turns = limits or ParseLimits(), turns or ParsingQueue()
        self._free = threading.BoundedSemaphore(self._turns.at_once)
        self._places = threading.BoundedSemaphore(self._turns.at_once + self._turns.waiting)
        self._lock = threading.Lock()
        self._children: set[_Child] = set()
        self._idle: _Child | None = None
        self._stopped = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def parse(
        self,
        function: Callable[..., Result],
        data: bytes,
        *arguments: object,
        classes: tuple[type, ...] = (),
        subject: str = "the file",
    ) -> Result:
        """Call ``function(data, *arguments)`` in a child and return its result. ``function``: a module-level function that
        returns plain data or one of the dataclasses ``classes``. ``arguments``: JSON values. ``subject``: name of the file in
        messages.

        Raises BadInput or CorruptData from the function. Raises BadInput also if the function failed in another way or the child
        crashed, TooCostly if a limit was reached, and Busy if the queue is full, no worker became free in time, no child could
        be started or the server is stopping.
        """
        job: ParseJob = {"function": f"{function.__module__}:{function.__qualname__}", "arguments": arguments}
        with self._turn():
            reply, body = self._ask(json.dumps(job).encode(), data, subject)
        if reply.startswith(REFUSED):
            raise self._error(json.loads(reply[1:]), subject)
        result: Result = decode(reply[1:], body, {kind.__name__: kind for kind in classes})
        return result

    def stop(self) -> None:
        """End all children. Pending requests raise Busy."""
        with self._lock:
            self._stopped = True
            children, idle, self._idle = list(self._children), self._idle, None
        for child in children:
            child.kill()
        if idle is not None:
            idle.end()
            self._forget(idle)

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        if not self._places.acquire(blocking=False):
            raise self._busy("the queue is full")
        try:
            if not self._free.acquire(timeout=self._turns.wait_s):
                raise self._busy(f"no free worker within {self._turns.wait_s:g} s")
            try:
                yield
            finally:
                self._free.release()
        finally:
            self._places.release()

    def _busy(self, got: str) -> Busy:
        return Busy(
            "the server is reading other files",
            expected=f"at most {self._turns.at_once} files at once",
            got=got,
            hint="send the file again in a few seconds",
            retry_after_s=self._turns.wait_s,
        )

    def _ask(self, job: bytes, data: bytes, subject: str) -> tuple[bytes, bytearray]:
        while True:
            child = self._take()
            answer = child.ask(job, data)
            if answer is not None:
                self._release(child, answer[0])
                return answer
            self._forget(child)
            if self._stopped:
                raise Busy("the server is stopping", hint="send the file again later", retry_after_s=self._turns.wait_s)
            if not child.ended_idle:
                raise self._killed(child, subject)

    def _take(self) -> _Child:
        with self._lock:
            if self._stopped:
                raise Busy("the server is stopping", hint="send the file again later", retry_after_s=self._turns.wait_s)
            child, self._idle = self._idle, None
            if child is None:
                child = self._start()
                self._children.add(child)
        return child

    def _start(self) -> _Child:
        try:
            return _Child(self._limits)
        except OSError as error:
            log.error("the file reader process could not be started: %s", error)
            raise Busy(
                "the file reader process could not be started",
                expected="free memory, processes and file descriptors",
                got=error.strerror or type(error).__name__,
                hint="send the file again later; if it persists, check the limits of the server",
                retry_after_s=self._turns.wait_s,
            ) from error

    def _release(self, child: _Child, reply: bytes) -> None:
        """Keep a child that could read its file for reuse, if no other child is idle. Otherwise end it. A child that
        rejected a file is always ended, because the rejected file can still occupy much memory."""
        with self._lock:
            if self._idle is None and not self._stopped and not reply.startswith(REFUSED):
                self._idle = child
                return
        child.end()
        self._forget(child)

    def _forget(self, child: _Child) -> None:
        with self._lock:
            self._children.discard(child)

    def _error(self, error: dict[str, str], subject: str) -> GssError:
        kind = error.pop("kind")
        if kind in EXPECTED_ERRORS:
            message = error.pop("message")
            return EXPECTED_ERRORS[kind](message, **error)
        if kind == "MemoryError":
            return self._too_costly(subject, "memory", f"{self._limits.memory_bytes >> 20} MiB")
        log.error("%s could not be read: %s", subject, error["log"])
        return BadInput(
            f"{subject} cannot be read",
            expected="a valid file of this format",
            got=error["got"][:200],
            hint="save it again with another program; the server's log has the details",
        )

    def _killed(self, child: _Child, subject: str) -> BadInput:
        if child.timed_out or child.code == -signal.SIGALRM:
            return self._too_costly(subject, "time", f"{self._limits.wall_s:g} s")
        if child.code == -signal.SIGXCPU:
            return self._too_costly(subject, "processor time", f"{self._limits.cpu_s:g} s")
        if child.reply_too_large:
            return self._too_costly(subject, "result size", f"{self._limits.result_bytes >> 20} MiB of content")
        end = signal.Signals(-child.code).name if child.code < 0 else f"exit code {child.code}"
        log.error("the reader process of %s ended with %s", subject, end)
        return BadInput(
            f"{subject} cannot be read: the reader process crashed or ran out of memory",
            expected=f"a file that can be read with {self._limits.memory_bytes >> 20} MiB of memory",
            got=end,
            hint="save it again with another program, or send a smaller file",
        )

    def _too_costly(self, subject: str, limit: str, amount: str) -> TooCostly:
        return TooCostly(
            f"{subject} is too expensive to read: the {limit} limit was reached",
            expected=f"at most {amount}",
            got="a higher value; the reader process was stopped",
            hint="send a smaller file, or save it uncompressed with another program",
        )


class _Child:
    """One child process and its two pipes."""

    def __init__(self, limits: ParseLimits) -> None:
        self._limits = limits
        self.timed_out = self.reply_too_large = False
        self._files = 0
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-m", WORKER, json.dumps(asdict(limits))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={k: v for k, v in os.environ.items() if not k.startswith(SECRET_SETTINGS)} | ONE_THREAD,
        )

    @property
    def code(self) -> int:
        """Exit code, negative for a signal. Waits for the end of the process."""
        return self._process.wait()

    @property
    def ended_idle(self) -> bool:
        """True if the child ended normally before it read the next job: its idle timeout expired, or it had read its
        maximum number of files."""
        return self._files > 1 and self.code == 0

    def ask(self, job: bytes, data: bytes) -> tuple[bytes, bytearray] | None:
        """Send a job and return the text and the data of the answer. Return None if the child process ended without an
        answer."""
        self._files += 1
        timer = threading.Timer(self._limits.wall_s, self._time_out)
        timer.start()
        answer = None
        try:
            answer = self._talk(job, data)
        except OSError:  # the child closed its end of the pipe
            pass
        finally:
            timer.cancel()
            if answer is None:
                self._await_end()
        return answer

    def _await_end(self) -> None:
        """Wait until the process ends, because its exit code shows why there is no answer. Kill it if it does not end in
        time, or at once if its answer was too large. Then close the pipes."""
        if not self.reply_too_large:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=EXIT_WITHIN_S)
        self.end()

    def _talk(self, job: bytes, data: bytes) -> tuple[bytes, bytearray] | None:
        requests, answers = self._pipes()
        write_message(requests, job, [data])
        head = read_into(answers, HEAD.size)
        if head is None:
            return None
        text_bytes, data_bytes = HEAD.unpack(head)
        if text_bytes > MAX_REPLY_TEXT or data_bytes > self._limits.result_bytes:
            self.reply_too_large = True
            return None
        text, body = read_into(answers, text_bytes), read_into(answers, data_bytes)
        return None if text is None or body is None else (bytes(text), body)

    def _pipes(self) -> tuple[BinaryIO, BinaryIO]:
        requests, answers = self._process.stdin, self._process.stdout
        if requests is None or answers is None:
            raise OSError("a child process without pipes")
        return requests, answers  # type: ignore[return-value]

    def _time_out(self) -> None:
        self.timed_out = True
        self.kill()

    def kill(self) -> None:
        """Kill the process. Pending requests receive no answer."""
        self._process.kill()

    def end(self) -> None:
        """Kill the process, wait for its end and close the pipes."""
        self.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe:
                with contextlib.suppress(OSError):
                    pipe.close()
