"""Program of the child process that parses untrusted files: ``python -m gss.operations.parsing.parse_worker LIMITS``.

It reads jobs one at a time from standard input and answers on standard output. It ends after a file that it could not read,
after an idle time, and when its parent ends. The kernel enforces the limits, so they also apply inside a library that does not
return to the interpreter.
"""

from __future__ import annotations

import fcntl
import importlib
import json
import math
import os
import resource
import select
import signal
import struct
import sys
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, BinaryIO, TypedDict

from gss.domain.errors import BadInput, CorruptData
from gss.operations.parsing.plain_data import encode, padding

HEAD = struct.Struct("<QQ")
"""Header of a message: sizes of its JSON text and of the data that follows."""
READ, REFUSED = b"+", b"-"
"""First byte of an answer. READ: a result as plain data follows. REFUSED: an error as JSON follows."""
MAX_TEXT_LENGTH = 4000
NICE = 5
"""Niceness of the child. The line and ABORT have a higher priority. With an even lower priority, a small file could
reach the limit of elapsed time on a busy machine."""
MAX_FILES = 64


@dataclass(frozen=True)
class ParseLimits:
    """Limits for one file.

    ``memory_bytes``: address space of the child, including libraries. ``result_bytes``: size of the returned content.
    ``idle_s``: maximum time that a child waits for its next file.
    """

    memory_bytes: int = 3 << 30
    cpu_s: float = 30.0
    wall_s: float = 60.0
    result_bytes: int = 1 << 30
    idle_s: float = 60.0


class ParseJob(TypedDict):
    """A job for a child. ``function``: ``module:name`` of the function to call with the content of the file and
    ``arguments``."""

    function: str
    arguments: Sequence[Any]


def write_message(to: BinaryIO, text: bytes, data: Iterable[bytes | memoryview]) -> None:
    """Write one message. Padding is inserted between the pieces of data, but not after the last piece."""
    parts: list[bytes | memoryview] = []
    size = 0
    for part in data:
        parts += [bytes(padding(size)), part]
        size += padding(size) + memoryview(part).nbytes
    to.write(HEAD.pack(len(text), size) + text)
    for part in parts:
        to.write(part)
    to.flush()


def read_into(source: BinaryIO, size: int) -> bytearray | None:
    """Read exactly ``size`` bytes. Return None if the stream ends earlier."""
    data = bytearray(size)
    view = memoryview(data)
    done = 0
    while done < size:
        count = source.readinto(view[done:])  # type: ignore[attr-defined]
        if not count:
            return None
        done += count
    return data


def main() -> None:
    """Answer up to ``MAX_FILES`` jobs. End if no job arrives for ``idle_s``, or after a file that could not be read."""
    limits = ParseLimits(**json.loads(sys.argv[1]))
    source, answers = _own_streams()
    _limit(limits)
    for _ in range(MAX_FILES):
        if not select.select([source], [], [], limits.idle_s)[0]:
            return
        head = read_into(source, HEAD.size)
        sizes = HEAD.unpack(head) if head else (0, 0)
        text, data = read_into(source, sizes[0]), read_into(source, sizes[1])
        if not text or data is None:
            return
        _begin(source, limits)
        if select.select([source], [], [], 0)[0]:  # the parent ended after the job and before the signal was enabled
            return
        reply, buffers = _answer(json.loads(text), data)
        del data
        _end(source)
        write_message(answers, reply, buffers)
        if reply.startswith(REFUSED):
            return


def _own_streams() -> tuple[BinaryIO, BinaryIO]:
    """Return the two pipes. Text that a library prints is discarded, because it would corrupt the answers."""
    answers = os.fdopen(os.dup(1), "wb")
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, 1)
    os.close(null_device)
    return os.fdopen(os.dup(0), "rb", buffering=0), answers


def _limit(limits: ParseLimits) -> None:
    os.nice(NICE)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes,) * 2)
    for number in (signal.SIGXCPU, signal.SIGALRM, signal.SIGIO):
        signal.signal(number, signal.SIG_DFL)
    fcntl.fcntl(0, fcntl.F_SETOWN, os.getpid())


def _begin(source: BinaryIO, limits: ParseLimits) -> None:
    """Start the time limits. From this call on, the kernel kills the process if it exceeds a limit or its parent ends."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    soft = math.ceil(used.ru_utime + used.ru_stime + limits.cpu_s)
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.RLIM_INFINITY))
    signal.setitimer(signal.ITIMER_REAL, limits.wall_s)
    # The parent sends no further bytes before the answer, so SIGIO means that the parent closed the pipe.
    _signal_on_close(source, True)


def _end(source: BinaryIO) -> None:
    _signal_on_close(source, False)
    signal.setitimer(signal.ITIMER_REAL, 0)


def _signal_on_close(source: BinaryIO, on: bool) -> None:
    flags = fcntl.fcntl(source, fcntl.F_GETFL)
    fcntl.fcntl(source, fcntl.F_SETFL, flags | os.O_ASYNC if on else flags & ~os.O_ASYNC)


def _answer(job: ParseJob, data: bytearray) -> tuple[bytes, list[memoryview]]:
    """Return the result, or the reason for a failure: an expected error, too little memory, or a defect with its traceback."""
    try:
        module, _, name = job["function"].partition(":")
        content = bytes(data)
        data.clear()
        reply, buffers = encode(getattr(importlib.import_module(module), name)(content, *job["arguments"]))
        return READ + reply, buffers
    except (BadInput, CorruptData) as error:
        texts = {"message": error.message, "expected": error.expected, "got": error.got, "hint": error.hint}
        return _refusal(type(error).__name__, **texts), []
    except MemoryError:
        return _refusal("MemoryError"), []
    except Exception as error:  # a file can trigger a defect of GSS or of a library
        return _refusal("defect", got=f"{type(error).__name__}: {error}", log=traceback.format_exc()), []


def _refusal(kind: str, **texts: str) -> bytes:
    return (
        REFUSED + json.dumps({"kind": kind} | {name: text[:MAX_TEXT_LENGTH] for name, text in texts.items()}).encode()
    )


if __name__ == "__main__":
    main()
