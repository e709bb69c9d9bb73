"""Compilation of the solver's loops while the server runs. It uses numpy until then, and the compiled loops afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from gss.operations.frames.loop_compiler import LoopCompiler

MARKED = """
from gss.pipeline.kernels import are_compiled, compiled_mark, kernels
print(kernels().name, are_compiled(), kernels(fast=True).name)
compiled_mark().touch()
print(kernels().name, are_compiled(), kernels(fast=False).name)
"""


NO_HOME = """
import os, pwd
os.environ.pop("HOME", None)
def unknown(uid):
    raise KeyError(uid)
pwd.getpwuid = unknown
from pathlib import Path
from gss.pipeline import kernels
kernels.LOOPS = Path("/proc/no-folder")
print(kernels.kernels().name)
"""

UNWRITABLE = """
from gss.pipeline.kernels import are_compiled, kernels
print(kernels().name, are_compiled())
kernels(fast=True)
"""


def compiler(program: str, bus: Any, *, compiled: bool = False) -> LoopCompiler:
    """Return a compiler that runs this program."""
    return LoopCompiler([sys.executable, "-c", program], lambda: compiled, bus)


def wait_for(state: str, of: LoopCompiler) -> None:
    """Wait until the state begins with this text."""
    for _ in range(400):
        if of.state.startswith(state):
            return
        time.sleep(0.05)
    pytest.fail(f"the state is still {of.state!r}")


def test_compiled_loops_are_the_default_once_they_are_marked(tmp_path: Path) -> None:
    """A new installation uses numpy until the loops are marked as compiled. A caller can select either at any time."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", MARKED], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["numpy False numba", "numba True numpy"]


def test_without_a_folder_for_compiled_loops_frames_are_solved_with_numpy() -> None:
    """If no folder can be written, numpy is the default. Selecting the compiled loops states what to do."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": "/proc/no-folder"}
    done = subprocess.run(
        [sys.executable, "-c", UNWRITABLE], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["numpy", "False"]
    assert "StoreDown: the compiled loops of the solver cannot be stored" in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_without_a_home_folder_frames_are_solved_with_numpy() -> None:
    """A user without a home folder, as in some containers, and a package that cannot be written: numpy is the default."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run([sys.executable, "-c", NO_HOME], env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout.split(), done.stderr) == (["numpy"], "")


def test_compiled_loops_are_not_compiled_again(bus: Any) -> None:
    """No child is started for loops that are compiled."""
    loops = compiler("raise SystemExit('started')", bus, compiled=True)
    loops.start()
    wait_for("compiled", loops)
    loops.stop()
    assert not [event for event in bus.after(0, 100) if event.kind == "solver"]


def test_progress_and_end_are_reported(bus: Any) -> None:
    """The state has the last line of the child's output. Two events report start and end."""
    loops = compiler("import sys; print('1 of 4', flush=True); sys.stdin.read(); import time; time.sleep(0.3)", bus)
    loops.start()
    wait_for("compiling: 1 of 4", loops)
    wait_for("compiled", loops)
    assert [event.severity for event in bus.after(0, 100) if event.kind == "solver"] == ["ok", "ok"]


def test_a_failure_is_reported_with_what_to_do(bus: Any) -> None:
    """A failure is reported with the child's last line as the reason, and the command to run."""
    loops = compiler("import sys; sys.exit('no space left on device')", bus)
    loops.start()
    wait_for("not compiled: no space left on device", loops)
    last = [event for event in bus.after(0, 100) if event.kind == "solver"][-1]
    assert (last.severity, last.text.endswith("Run gss compile")) == ("watch", True)


def test_stop_ends_the_child_immediately(bus: Any) -> None:
    """A server that stops does not wait for the compiler."""
    loops = compiler("print('1 of 4', flush=True); import time; time.sleep(600)", bus)
    loops.start()
    wait_for("compiling", loops)
    loops.stop()
    assert loops.state == "compiling: 1 of 4"
    assert [event.text for event in bus.after(0, 100) if event.kind == "solver"][1:] == []
