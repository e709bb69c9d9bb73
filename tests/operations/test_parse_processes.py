"""Child processes that parse files: their results, their limits and their end."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from gss.domain.errors import BadInput, Busy, CorruptData, TooCostly
from gss.operations.frames.frame_files import ImportedFrame
from gss.operations.parsing.parse_processes import ParseProcesses, ParsingQueue
from gss.operations.parsing.parse_worker import ParseLimits
from gss.operations.parsing.plain_data import decode, encode, padding

SOURCE = """
    import ctypes, os, re, socket, sys, time
    from pathlib import Path
    from gss.domain.errors import BadInput, CorruptData

    def length(data): return len(data)
    def process(data): return os.getpid()
    def refuse(data): raise BadInput("no good", expected="a", got="b", hint="c")
    def damaged(data): raise CorruptData("damaged")
    def defect(data): raise ZeroDivisionError("oh")
    def hold_interpreter(data): re.match("(a+)+$", "a" * 60 + "b")
    def sleep(data): time.sleep(600)
    def allocate(data): return len(bytearray(1 << 40))
    def crash(data): ctypes.string_at(0)
    def leave(data): os._exit(0)
    def much(data): return bytes(3 << 20)
    def chatter(data): os.write(1, b"x" * 1000); print("y" * 1000, flush=True); return "quiet"
    def strange(data): return {1, 2}
    def inside(data):
        names = [f"/proc/self/fd/{n}" for n in os.listdir("/proc/self/fd")]
        return [os.readlink(name) for name in names if os.path.lexists(name)]
    def settings(data): return sorted(os.environ)
    def wait_for(data, path):
        Path(path + ".began").touch()
        while not Path(path).exists(): time.sleep(0.01)
        return "done"
"""
LIMITS = ParseLimits(memory_bytes=1 << 30, cpu_s=1.0, wall_s=60.0, result_bytes=2 << 20)


@pytest.fixture(scope="module", autouse=True)
def _new_processes(forked_parsers: Any) -> Iterator[None]:
    """Start each child as a new program."""
    forked_parsers.remove()
    yield
    forked_parsers.install()


@pytest.fixture
def parsers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Module with functions that a child process can import."""
    (tmp_path / "some_parsers.py").write_text(textwrap.dedent(SOURCE))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    sys.modules.pop("some_parsers", None)
    import some_parsers  # type: ignore[import-not-found]

    return some_parsers


@pytest.fixture
def parsing() -> Iterator[ParseProcesses]:
    """Child processes with small limits."""
    with ParseProcesses(LIMITS) as processes:
        yield processes


def until(true: Callable[[], Any]) -> None:
    """Wait at most 30 s until ``true()``."""
    for _ in range(3000):
        if true():
            return
        time.sleep(0.01)
    raise AssertionError("the condition was not met within 30 s")


def is_alive(pid: int) -> bool:
    """True if the process runs. An ended process that is not yet reaped does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@dataclass(frozen=True)
class Nested:
    """Everything that plain data can contain."""

    values: tuple[Any, ...]
    names: dict[int, str]


def test_plain_data_is_returned_unchanged() -> None:
    """Numbers, text, times, arrays, mappings and allowed dataclasses are returned unchanged."""
    pixels = np.arange(12, dtype=">u2").reshape(3, 4)
    frame = ImportedFrame(pixels, 16, None, datetime(2026, 1, 2, tzinfo=UTC), {"a": "b"})
    original = Nested(
        (frame, None, True, 1.5, float("inf"), "ü\n", b"\0\1", [1, []], np.zeros((0, 3)), {}), {7: "é", 9: ""}
    )
    text, buffers = encode(original)
    body = bytearray()
    for part in buffers:
        body += bytes(padding(len(body))) + part
    decoded = decode(text, body, {"Nested": Nested, "ImportedFrame": ImportedFrame})
    assert (decoded.values[0].pixels == pixels).all()
    assert decoded.values[0].taken_at == frame.taken_at
    assert decoded.values[1:8] == original.values[1:8]
    assert decoded.values[8].shape == (0, 3)
    assert decoded.names == original.names


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"[",
        b"[]",
        b'["object", "Path", {}]',
        b'["array", "|O", [1], 0, 8]',
        b'["array", "<f8", [1], 0, 8]',
        b'["array", "<f8", [-1], 0, -8]',
        b'["bytes", -1, 1]',
        b'["texts", 1, 2, 3]',
        b'["time", 3]',
    ],
)
def test_a_result_that_is_not_plain_data_is_rejected(text: bytes) -> None:
    """A result with other classes, objects or ranges outside its bytes raises ``CorruptData``."""
    with pytest.raises(CorruptData, match="result of the file parser"):
        decode(text, bytearray(4), {})


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("refuse", BadInput, "no good; expected a; got b. Try: c"),
        ("damaged", CorruptData, "damaged"),
        ("defect", BadInput, "ZeroDivisionError: oh"),
        ("strange", BadInput, "not plain data"),
        ("hold_interpreter", TooCostly, "processor time limit.*1 s"),
        ("allocate", TooCostly, "memory limit.*1024 MiB"),
        ("much", TooCostly, "result size limit.*2 MiB"),
        ("crash", BadInput, "SIGSEGV"),
        ("leave", BadInput, "exit code 0"),
    ],
)
def test_every_failure_is_one_clear_error(
    parsing: ParseProcesses, parsers: ModuleType, name: str, kind: type[Exception], words: str
) -> None:
    """A rejection, a defect, a crash and each exceeded limit give the caller one error with the reason. The next file is
    read."""
    for _ in range(2):  # also in a child that has read a file
        with pytest.raises(kind, match=f"(?s){words}"):
            parsing.parse(getattr(parsers, name), b"x")
        assert parsing.parse(parsers.length, b"12345") == 5


def test_a_waiting_parser_is_ended_by_the_time_limit(parsers: ModuleType) -> None:
    """A child that uses neither processor nor memory is ended by the time limit."""
    with ParseProcesses(ParseLimits(wall_s=3.0)) as parsing, pytest.raises(TooCostly, match=r"time limit.*3 s"):
        parsing.parse(parsers.sleep, b"")


def test_a_child_inherits_nothing_from_the_server(
    parsing: ParseProcesses, parsers: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A child has only pipes and the null device open and no settings in its environment. Its printed output is not in the
    result."""
    monkeypatch.setenv("GSS_DATABASE", "sqlite:///elsewhere.db")
    opened = parsing.parse(parsers.inside, b"")
    assert {name.split(":")[0] for name in opened} <= {"pipe", "/dev/null"}
    assert not [name for name in parsing.parse(parsers.settings, b"") if name.startswith("GSS_")]
    assert parsing.parse(parsers.chatter, b"") == "quiet"


def test_a_child_is_reused_only_after_a_successful_read(parsing: ParseProcesses, parsers: ModuleType) -> None:
    """The same process reads two valid files. After a rejection another process is used."""
    first = parsing.parse(parsers.process, b"")
    assert parsing.parse(parsers.process, b"") == first
    with pytest.raises(BadInput):
        parsing.parse(parsers.refuse, b"")
    assert parsing.parse(parsers.process, b"") != first
    assert not is_alive(first)


def test_an_idle_child_ends_and_the_next_file_is_read(parsers: ModuleType) -> None:
    """An idle child ends automatically, and a later file is read by a new one."""
    with ParseProcesses(ParseLimits(idle_s=0.1)) as parsing:
        first = parsing.parse(parsers.process, b"")
        until(lambda: not is_alive(first))
        assert parsing.parse(parsers.process, b"") != first


def test_too_many_files_are_rejected_and_a_stop_ends_all(parsers: ModuleType, tmp_path: Path) -> None:
    """While one file is read and one waits, a third is rejected as busy. A stop ends the first two with an error."""
    errors: list[Exception] = []
    with ParseProcesses(turns=ParsingQueue(at_once=1, waiting=1, wait_s=60.0)) as parsing:

        def read() -> None:
            try:
                parsing.parse(parsers.wait_for, b"", str(tmp_path / "never"))
            except Busy as error:
                errors.append(error)

        threads = [threading.Thread(target=read) for _ in range(2)]
        for thread in threads:
            thread.start()
        until((tmp_path / "never.began").exists)
        until(lambda: parsing._places._value == 0)
        with pytest.raises(Busy, match="reading other files") as refused:
            parsing.parse(parsers.length, b"")
        assert refused.value.retry_after_s > 0
        parsing.stop()
        for thread in threads:
            thread.join(30)
    assert [str(error)[:22] for error in errors] == ["the server is stopping"] * 2
    with pytest.raises(Busy):
        parsing.parse(parsers.length, b"")


def test_a_file_that_waits_too_long_is_rejected(parsers: ModuleType, tmp_path: Path) -> None:
    """A file that waits longer than the limit for a worker is rejected."""
    with ParseProcesses(turns=ParsingQueue(at_once=1, waiting=1, wait_s=0.1)) as parsing:
        thread = threading.Thread(target=lambda: parsing.parse(parsers.wait_for, b"", str(tmp_path / "go")))
        thread.start()
        until((tmp_path / "go.began").exists)
        with pytest.raises(Busy, match=r"no free worker within 0\.1 s"):
            parsing.parse(parsers.length, b"")
        (tmp_path / "go").touch()
        thread.join(30)


@pytest.mark.parametrize("function", ["wait_for", "hold_interpreter"])
def test_a_child_ends_with_its_parent(parsers: ModuleType, tmp_path: Path, function: str) -> None:
    """If the server is killed, a child that reads a file ends, also in code that does not return to the interpreter."""
    more = f", {str(tmp_path / 'x')!r}" if function == "wait_for" else ""
    program = "import some_parsers as p; from gss.operations.parsing.parse_processes import ParseProcesses as P; "
    program += f"P().parse(p.{function}, b''{more})"
    parent = subprocess.Popen([sys.executable, "-c", program])
    children = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
    until(lambda: children.read_text().split())
    child = int(children.read_text().split()[0])
    if function == "wait_for":
        until((tmp_path / "x.began").exists)
    else:  # also if the child has not begun after this time, it must end
        time.sleep(1.0)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    until(lambda: not is_alive(child))


def test_a_child_that_cannot_be_started_is_reported_as_busy(parsing: ParseProcesses, parsers: ModuleType) -> None:
    """If no child can be started for lack of file descriptors, the caller gets Busy with a retry time. Files are read
    again afterwards."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    for _ in range(ParsingQueue().at_once + 1):
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
        try:
            with pytest.raises(Busy, match="could not be started") as refused:
                parsing.parse(parsers.length, b"abc")
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert refused.value.retry_after_s > 0
    assert parsing.parse(parsers.length, b"abc") == 3
