"""Preloaded processes: one process imports everything once, and the commands of GSS that the tests start are forked from it.
There is one for servers, simulators and commands, and a smaller one for the processes that parse a file.

Only the imports are shared. A forked command is an ordinary child process of the process that started it, so it is waited
for and killed separately. Servers and units have such a preloaded process too, for the simulators and units they start.
Commands with other interpreter settings, and programs other than GSS, are started as usual.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import fcntl
import gc
import importlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import util
from pathlib import Path
from typing import Any

import anyio

ENOUGH = 1 << 18
MAX_FILES = 64
LONGEST_COMMAND = 4000
"""Bytes that the command line of a forked process can have in /proc."""
SET_CHILD_SUBREAPER = 36
"""Option of prctl(2) of Linux."""
SERVERS, PARSERS = "servers", "parsers"
COMMANDS = {SERVERS: ("gss", "gss.device.simulator"), PARSERS: ("gss.operations.parsing.parse_worker",)}
IMPORTED_BY_PARSERS = (
    "astropy.io.ascii",
    "astropy.io.fits",
    "astropy.io.votable",
    "astropy.table",
    "PIL.Image",
    "pyarrow.parquet",
    "gss.catalogue_tools.sources.star_lists",
    "gss.instruments.package",
    "gss.operations.catalogues.catalogue_files",
    "gss.operations.frames.frame_files",
    "gss.operations.frames.measured_list_files",
    "gss.operations.instruments.package_check",
    "gss.operations.parsing.parse_worker",
    "gss.orbit.read_attitude",
)
CHILDREN = re.compile("from multiprocessing[.](spawn|forkserver) import")
"""Programs of the Python processes that a server starts: API workers, units and the process that forks workers of studies."""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system"}
OWN_START = ("NUMBA_", "OMP_", "LD_", "PYTHON")
"""Settings that only a new process reads. PYTHONPATH is added to the path of a forked process."""
_exec = subprocess._fork_exec  # type: ignore[attr-defined]
_spawn = util.spawnv_passfds  # type: ignore[attr-defined]


class Forks:
    """Requests to a preloaded process, which starts at the first request. The process ends when the requesting process calls
    :meth:`end` or ends. ``kind``: SERVERS or PARSERS. ``channel``: of a process that runs."""

    def __init__(self, kind: str, channel: socket.socket | None = None) -> None:
        self._kind, self._channel, self._lock, self._pid = kind, channel, threading.Lock(), os.getpid()
        self._environment = os.environ | ONE_THREAD
        self._settings = _own_start(self._environment if kind == PARSERS else os.environ)
        self._process: subprocess.Popen[bytes] | None = None
        self._otherwise = _exec

    def install(self) -> None:
        """Let ``subprocess`` of this process fork the commands of this kind from the preloaded process, and
        ``multiprocessing`` those of servers."""
        self._otherwise = subprocess._fork_exec  # type: ignore[attr-defined]
        subprocess._fork_exec = self._fork_exec  # type: ignore[attr-defined]
        if self._kind == SERVERS:
            util.spawnv_passfds = self._spawn  # type: ignore[attr-defined]

    def remove(self) -> None:
        """Let this process start these commands as before :meth:`install`."""
        subprocess._fork_exec = self._otherwise  # type: ignore[attr-defined]
        if self._kind == SERVERS:
            util.spawnv_passfds = _spawn  # type: ignore[attr-defined]

    def end(self) -> None:
        """End the preloaded process, if it has started."""
        if self._process is not None and self._channel is not None:
            self._channel.close()
            self._process.wait(20)

    def _fork_exec(self, *options: Any) -> int:
        """Replacement for ``_posixsubprocess.fork_exec``."""
        command, kept, folder, settings = [os.fsdecode(word) for word in options[0]], *options[3:6]
        rows = [os.fsdecode(row).split("=", 1) for row in settings or ()]
        environment = dict(os.environ) if settings is None else dict(rows)
        error_pipe, new_session, others = options[13], options[15], options[16:22]
        ordinary = not any(other not in (None, -1) for other in others) and set(kept) == {error_pipe}
        if not ordinary or command[:1] != [sys.executable] or not self._forkable(command[1:], environment):
            return int(self._otherwise(*options))
        streams = [options[6], options[9], options[11]]
        files = {target: target if source == -1 else source for target, source in enumerate(streams)}
        where = os.fsdecode(folder) if folder is not None else os.getcwd()
        return self._ask(command[1:], environment, where, files, new_session)

    def _spawn(self, path: bytes, command: Sequence[str], kept: Sequence[int]) -> int:
        """Replacement for ``multiprocessing.util.spawnv_passfds``."""
        words = [os.fsdecode(word) for word in command][1:]
        at = words.index("-c") if "-c" in words else 0
        if os.getpid() != self._pid or not CHILDREN.match(words[at:][1]):
            return int(_spawn(path, command, kept))
        return self._ask(words[at:], dict(os.environ), os.getcwd(), {n: n for n in (0, 1, 2, *kept)}, False)

    def _forkable(self, words: Sequence[str], environment: dict[str, str]) -> bool:
        own = words[:1] == ["-m"] and words[1] in COMMANDS[self._kind]
        return own and os.getpid() == self._pid and _own_start(environment) == self._settings

    def _ask(
        self, words: Sequence[str], environment: dict[str, str], folder: str, files: dict[int, int], session: bool
    ) -> int:
        """Return the id of the new process, which becomes a child of this process when its first parent ends."""
        order = {"words": list(words), "environment": environment, "folder": folder, "session": session}
        text = json.dumps({**order, "files": list(files)}).encode()
        with self._lock:
            channel = self._channel = self._channel or self._started()
            _adopt(True)
            try:
                socket.send_fds(channel, [text], list(files.values()))
                return int(channel.recv(32))
            finally:
                _adopt(False)

    def _started(self) -> socket.socket:
        """Start the preloaded process, and return the channel to it."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        command = [sys.executable, __file__, str(theirs.fileno()), self._kind, " " * LONGEST_COMMAND]
        inherited, environment = [theirs.fileno()], self._environment
        self._process = subprocess.Popen(command, pass_fds=inherited, env=environment, stdin=subprocess.DEVNULL)
        theirs.close()
        return ours


@contextmanager
def preloaded(kind: str) -> Iterator[Forks]:
    """Requests to a preloaded process of this kind, which ends with the context."""
    forks = Forks(kind)
    yield forks
    forks.end()


def _own_start(environment: Any) -> dict[str, str]:
    return {name: text for name, text in environment.items() if name.startswith(OWN_START) and name != "PYTHONPATH"}


def _adopt(yes: bool) -> None:
    """Let this process adopt the children of its descendants that end."""
    ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, int(yes), 0, 0, 0)


# --- the preloaded process -------------------------------------------------------------------------------------------


def load_parsers() -> None:
    """Import everything that is needed to parse a file."""
    for name in IMPORTED_BY_PARSERS:
        importlib.import_module(name)


def load_servers() -> None:
    """Import and read everything that a server or a simulator needs at its start, and load the solver's loops."""
    import uvicorn  # noqa: F401

    import gss.api.app
    import gss.api.serving
    import gss.cli
    import gss.device.simulator.program
    import gss.wiring.build
    from gss.catalogue_tools.sources.hipparcos import load_stars
    from gss.instruments.dictionary.read_dictionary import load_dictionary
    from gss.instruments.registry import shipped_camera
    from gss.operations.frames.solve import Solver, SolveRequest, warm_up_image

    gss.cli.full_parser()
    load_stars()
    load_dictionary()
    asyncio.run(anyio.sleep(0))
    camera = shipped_camera("cubestar")
    for chain in ("reference", "cubestar"):
        request = SolveRequest(chain=chain, profile="cubestar", exposure_s=camera.sensor.exposure_s)
        Solver(shipped_camera).solve(warm_up_image(camera), request)


def serve(channel: socket.socket) -> None:
    """Fork a process for each request, until the requesting process ends."""
    while True:
        order, files, _, _ = socket.recv_fds(channel, ENOUGH, MAX_FILES)
        if not order:
            return
        read, write = os.pipe()
        first = os.fork()
        if first == 0:
            pid = os.fork()
            if pid == 0:
                _live(json.loads(order), files)
            os.write(write, str(pid).encode())
            os._exit(0)
        os.waitpid(first, 0)
        for taken in (write, *files):
            os.close(taken)
        channel.send(os.read(read, 32))
        os.close(read)


def _live(order: dict[str, Any], received: list[int]) -> None:
    """Set streams, environment and signals of the new process, run its command, and exit."""
    code: Any = 1
    try:
        for number in (signal.SIGCHLD, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _place(order["files"], received)
        os.chdir(order["folder"])
        if order["session"]:
            os.setsid()
        os.environ.clear()
        os.environ.update(order["environment"])
        sys.path[:0] = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        sys.stdin = os.fdopen(0, "r", closefd=False)
        command = _command(order["words"])
        if order["words"][:2] == ["-m", "gss"] or order["words"][0] == "-c":
            _descend()
        code = command()
    except SystemExit as end:
        code = end.code
        if isinstance(code, str):
            sys.stderr.write(f"{code}\n")
            code = 1
    except BaseException:  # as the interpreter would end
        import traceback

        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(code or 0)


def _place(targets: list[int], received: list[int]) -> None:
    """Give the received files their numbers, and close all others."""
    above = max(*targets, *received) + 1
    moved = [fcntl.fcntl(number, fcntl.F_DUPFD, above) for number in received]
    os.closerange(0, above)
    for target, source in zip(targets, moved, strict=True):
        os.dup2(source, target)
        os.close(source)


def _command(words: list[str]) -> Callable[[], Any]:
    """Return the function of ``-m MODULE …`` or ``-c PROGRAM …``, with ``sys.argv`` and the command line in /proc set."""
    start, end = map(int, Path("/proc/self/stat").read_text().rpartition(")")[2].split()[45:47])
    shown = "\0".join([sys.executable, *words]).encode()[: end - start - 1]
    ctypes.memmove(start, shown.ljust(end - start, b"\0"), end - start)
    sys.argv = [words[1] if words[0] == "-m" else "-c", *words[2:]]
    if words[0] == "-c":
        return lambda: exec(words[1], {"__name__": "__main__"})  # noqa: S102 - as python -c
    if words[1] == "gss":
        from gss.cli import main as gss_main

        return lambda: gss_main(words[2:])
    if words[1] in COMMANDS[PARSERS]:
        from gss.operations.parsing.parse_worker import main as parse_main

        return parse_main
    from gss.device.simulator.program import main as simulator_main

    return lambda: simulator_main(words[2:])


def _descend() -> None:
    """Fork the preloaded process of this process, while it has no threads."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    if os.fork() == 0:
        _place([3, 0, 1, 2], [theirs.fileno(), *[os.open(os.devnull, os.O_RDWR)] * 3])
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        serve(socket.socket(fileno=3))
        os._exit(0)
    theirs.close()
    Forks(SERVERS, ours).install()


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    time.tzset()
    (load_parsers if sys.argv[2] == PARSERS else load_servers)()
    gc.freeze()  # a collection in a forked process would copy the memory of these objects
    serve(socket.socket(fileno=int(sys.argv[1])))
