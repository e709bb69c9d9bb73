"""The real simulator process and a real port, driven by the sans-IO session."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gss.device.session import HostSession
from gss.device.session_events import CommandUpdate, SessionEvent, Stage, TransferUpdate
from gss.device.transport import ByteStream, open_stream
from gss.instruments.dictionary.read_dictionary import load_dictionary

ENDS = (Stage.COMPLETED, Stage.FAILED, Stage.REJECTED, Stage.UNKNOWN)


@pytest.fixture(scope="module", autouse=True)
def _forked(forked: None) -> None:
    """Fork the simulators of these tests from a preloaded process."""


class Contact:
    """A session on an open port."""

    def __init__(self, url: str) -> None:
        self.stream: ByteStream = open_stream(url)
        self.host = HostSession(load_dictionary())
        self.host.link_up(time.monotonic())
        self.events: list[SessionEvent] = []

    def until(self, done: Callable[[], bool], seconds: float = 30.0) -> None:
        """Exchange data with the device until ``done()`` is true; fail after the timeout."""
        limit_s = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < limit_s, self.events[-5:]
            out, events = self.host.poll(time.monotonic())
            self.events += events
            if out:
                self.stream.write(out)
            data = self.stream.read(8192, 0.01)
            self.events += self.host.feed(data, time.monotonic())

    def do(self, name: str, **arguments: float | str | bool) -> CommandUpdate:
        """Send a command and wait for its end."""
        request_id = self.host.submit(self.host.encode(name, arguments))

        def end() -> list[CommandUpdate]:
            mine = [e for e in self.events if isinstance(e, CommandUpdate) and e.request_id == request_id]
            return [e for e in mine if e.stage in ENDS]

        self.until(lambda: bool(end()))
        return end()[-1]

    def finish(self, transfer_id: int) -> TransferUpdate:
        """Wait for the end of a transfer."""
        ends = ("verified", "committed", "failed", "aborted")
        self.until(lambda: self.host.transfer(transfer_id).state in ends)
        # One more turn, so that the events of the end are there too.
        self.events += self.host.poll(time.monotonic())[1]
        return self.host.transfer(transfer_id)


class Simulator:
    """Simulator process that has printed READY."""

    def __init__(self, *options: str) -> None:
        command = [
            sys.executable,
            "-m",
            "gss.device.simulator",
            "--instrument",
            "cubestar",
            "--exit-with-stdin",
            *options,
        ]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        first = self.process.stdout.readline().split()
        assert first[:1] == ["READY"], first
        self.url = first[1]

    def stop(self) -> int:
        """Stop the process with SIGTERM and return its exit code."""
        self.process.terminate()
        return self.process.wait(20)

    def clean_up(self) -> None:
        """Kill the process and close its pipes."""
        self.process.kill()
        self.process.wait(20)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()


@pytest.fixture
def simulator(tmp_path: Path) -> Iterator[Callable[..., Simulator]]:
    """Factory of simulators, which end after the test."""
    started: list[Simulator] = []

    def start(*options: str) -> Simulator:
        started.append(Simulator(*options))
        return started[-1]

    yield start
    for one in started:
        one.clean_up()


@pytest.fixture
def contact() -> Iterator[Callable[[str], Contact]]:
    """Factory of contacts, which are closed after the test."""
    opened: list[Contact] = []

    def open_contact(url: str) -> Contact:
        opened.append(Contact(url))
        opened[-1].until(lambda: opened[-1].host.hello is not None)
        return opened[-1]

    yield open_contact
    for one in opened:
        one.stream.close()
