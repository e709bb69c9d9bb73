"""The files of the Rerun viewer are read from the SDK's library, without a server and without a port."""

from __future__ import annotations

import io
import socket
import subprocess
import sys
import time
from pathlib import Path

import httpx2
import pytest

from gss.domain.errors import GssError
from gss.operations.frames import rerun_viewer
from gss.operations.frames.rerun_viewer import (
    FILES,
    PROGRAM,
    PROGRAM_BEGIN,
    SCRIPT,
    SCRIPT_BEGIN,
    SCRIPT_END,
    RerunViewer,
    program,
    script,
)

SERVE = """
import sys, time, rerun
rerun.init("viewer")
rerun.serve_web_viewer(web_port=int(sys.argv[1]), open_browser=False)
time.sleep(120)
"""


def served(port: int, name: str) -> bytes:
    """Return a file from the SDK's own server, as soon as it answers."""
    limit_s = time.monotonic() + 60
    while True:
        try:
            return httpx2.get(f"http://127.0.0.1:{port}/{name}", timeout=60).raise_for_status().content
        except httpx2.TransportError:
            if time.monotonic() > limit_s:
                raise
            time.sleep(0.2)


def test_the_files_are_those_of_the_sdk_and_no_port_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both files equal, byte for byte, those that the SDK's own server returns. GSS reads them without a socket and without
    another process.
    """
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    process = subprocess.Popen([sys.executable, "-c", SERVE, str(port)])
    try:
        expected = {name: served(port, name) for name in FILES}
    finally:
        process.kill()
        process.wait()

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("a socket or a process is not needed")

    monkeypatch.setattr(socket, "socket", forbidden)
    monkeypatch.setattr(subprocess, "Popen", forbidden)
    with rerun_viewer._library().open("rb") as library:
        assert {SCRIPT: script(library), PROGRAM: program(library)} == expected


@pytest.mark.parametrize(
    ("library", "reason"),
    [
        (b"", "was not found"),
        (SCRIPT_BEGIN + b"without an end", "the end of re_viewer.js"),
        (SCRIPT_BEGIN + SCRIPT_END, "asm"),
        (SCRIPT_BEGIN + SCRIPT_END + PROGRAM_BEGIN, "unknown section at byte 8"),
        (
            SCRIPT_BEGIN + SCRIPT_END + PROGRAM_BEGIN + b"\x01\x02\x60\x00" + b"<!doctype html>",
            "unknown section at byte 12",
        ),
        (SCRIPT_BEGIN + SCRIPT_END + PROGRAM_BEGIN + b"\x01\xff\xff\xff\xff\xff\xff", "unknown section at byte 8"),
    ],
    ids=["empty", "endless script", "no program", "truncated program", "other section", "endless size"],
)
def test_a_library_of_another_form_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: bytes, reason: str
) -> None:
    """A library without the files, or with others than expected, gives an error with its reason and stores nothing."""
    other = tmp_path / "rerun_bindings.abi3.so"
    other.write_bytes(bytes(5000) + library)
    monkeypatch.setattr(rerun_viewer, "_library", lambda: other)
    with pytest.raises(GssError, match="does not contain the viewer") as raised:
        RerunViewer(tmp_path / "cache").file("re_viewer_bg.wasm")
    assert reason in raised.value.got
    assert not list((tmp_path / "cache").rglob("*wasm.gz"))


def test_a_pattern_across_two_blocks_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The position is correct for every alignment of the pattern and the blocks that are searched."""
    monkeypatch.setattr(rerun_viewer, "SEARCH_BYTES", 7)
    for before in range(30):
        assert rerun_viewer._find(io.BytesIO(bytes(before) + b"pattern" + bytes(9)), b"pattern") == before
