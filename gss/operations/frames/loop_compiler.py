"""Compiles the solver's loops while the server already works. Frames are solved with the numpy loops until then."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Sequence

from gss.operations.events import EventBus

EXIT_WITHIN_S = 2.0


def compile_command() -> list[str]:
    """Return the command that compiles the loops with the first installed camera that solves its test frames."""
    return [sys.executable, "-m", "gss", "compile", "--background"]


class LoopCompiler:
    """Runs ``command`` in a child process if the loops are not compiled yet. ``are_compiled``: returns True if the
    loops are compiled. It imports numba, which takes a second, so this class calls it on a separate thread."""

    def __init__(self, command: Sequence[str], are_compiled: Callable[[], bool], bus: EventBus) -> None:
        self._command, self._are_compiled, self._bus = command, are_compiled, bus
        self._lock, self._stopped = threading.Lock(), threading.Event()
        self._process: subprocess.Popen[str] | None = None
        self._thread = threading.Thread(target=self._run, name="compile loops", daemon=True)
        self.state = "not checked"

    def start(self) -> None:
        """Start the compilation in the background."""
        self._thread.start()

    def stop(self) -> None:
        """End the child process. Loops that are already compiled remain cached, and the next server compiles the other
        loops."""
        with self._lock:
            self._stopped.set()
            if self._process is not None:
                self._process.kill()
        if self._thread.ident is not None:
            self._thread.join(EXIT_WITHIN_S)

    def _run(self) -> None:
        try:
            compiled = self._are_compiled()
        except Exception as error:  # numba raises many types of exceptions; numpy then solves frames
            self.state = f"not compiled: {type(error).__name__}: {error}"
            return
        if compiled:
            self.state = "compiled"
            return
        with self._lock:
            if self._stopped.is_set():
                return
            self._process = subprocess.Popen(  # noqa: S603 - our own program
                self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
        self._bus.record("solver", "ok", "Compiling the solver's loops; frames are solved more slowly until then")
        line = ""
        with self._process as process:
            for line in process.stdout or ():
                self.state = f"compiling: {line.strip()}"
        if self._stopped.is_set():
            return
        if process.returncode == 0:
            self._bus.record("solver", "ok", "The solver's loops are compiled")
            self.state = "compiled"
        else:
            state = f"not compiled: {line.strip() or f'exit code {process.returncode}'}"
            self._bus.record("solver", "watch", f"The solver's loops are {state}. Run gss compile")
            self.state = state
