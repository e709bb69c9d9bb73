"""Ports that are in use, hang up, or disappear and return."""

from __future__ import annotations

import os
import socket
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gss.device.transport import UNFINISHED_MOST, ByteStream, open_stream
from gss.domain.errors import Conflict, LinkDown, NotFound

Serve = Callable[[Callable[[socket.socket], None]], str]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Starts TCP servers with one behaviour per connection and returns their addresses."""
    listeners: list[socket.socket] = []

    def start(do: Callable[[socket.socket], None]) -> str:
        listener = socket.create_server(("127.0.0.1", 0))
        listeners.append(listener)

        def accept() -> None:
            while True:
                try:
                    peer, _ = listener.accept()
                except OSError:
                    return
                do(peer)

        threading.Thread(target=accept, daemon=True).start()
        return f"socket://127.0.0.1:{listener.getsockname()[1]}"

    yield start
    for listener in listeners:
        listener.close()


def use_until_gone(stream: ByteStream) -> None:
    for _ in range(20):
        stream.read(100, 0.05)
        stream.write(b"x")


def test_a_device_server_for_one_client_rejects_the_second_with_a_hint(serve: Serve) -> None:
    """It accepts and hangs up: a Conflict with a hint, not a line that opens and closes in a loop."""
    with pytest.raises(Conflict, match="closed the connection immediately") as refused:
        open_stream(serve(lambda peer: peer.close()))
    assert "another program" in refused.value.hint


def test_bytes_received_while_opening_are_not_lost(serve: Serve) -> None:
    """Data that a device sends during opening are received from the first byte."""
    kept: list[socket.socket] = []

    def greet(peer: socket.socket) -> None:
        kept.append(peer)
        time.sleep(0.05)  # pyserial empties the buffer when it connects
        peer.sendall(b"hello")

    stream = open_stream(serve(greet))
    got = b""
    for _ in range(20):
        got += stream.read(100, 0.1)
    assert got == b"hello"
    kept[0].close()
    with pytest.raises(LinkDown):
        use_until_gone(stream)
    stream.close()


def test_a_silent_device_is_not_an_error(serve: Serve) -> None:
    """Silence while opening is permitted."""
    kept: list[socket.socket] = []
    stream = open_stream(serve(kept.append))
    assert stream.read(10, 0.01) == b""
    stream.close()
    for peer in kept:
        peer.close()


def wait_for_openings() -> None:
    """Wait until no opening of an earlier test is in progress."""
    for thread in [thread for thread in threading.enumerate() if thread.name == "open line"]:
        thread.join(30)


def test_a_port_that_opens_after_the_deadline_is_closed(serve: Serve) -> None:
    """The caller gets LinkDown in time, and the peer sees the late connection closed."""
    peers: list[socket.socket] = []
    with pytest.raises(LinkDown, match=r"an open port within 0.01 s; got no answer"):
        open_stream(serve(peers.append), within_s=0.01)
    wait_for_openings()
    with peers[0] as peer:
        peer.settimeout(30)
        assert peer.recv(1) == b""


def test_hanging_openings_are_limited(serve: Serve) -> None:
    """A peer that never negotiates uses a bounded number of threads; afterwards lines open again."""
    peers: list[socket.socket] = []
    silent = serve(peers.append)
    for _ in range(UNFINISHED_MOST):
        with pytest.raises(LinkDown):
            open_stream(silent.replace("socket", "rfc2217"), within_s=0.01)
    with pytest.raises(Conflict, match="too many openings of lines"):
        open_stream(silent)
    wait_for_openings()
    open_stream(silent).close()
    for peer in peers:
        peer.close()


def test_an_opening_whose_thread_cannot_start_frees_its_place(serve: Serve) -> None:
    """No memory for a thread's stack is LinkDown each time, and afterwards lines open again."""
    kept: list[socket.socket] = []
    url = serve(kept.append)
    before = threading.stack_size(1 << 47)  # more than a process can address
    try:
        for _ in range(UNFINISHED_MOST + 1):
            with pytest.raises(LinkDown, match="cannot open"):
                open_stream(url)
    finally:
        threading.stack_size(before)
    open_stream(url).close()
    for peer in kept:
        peer.close()


def test_a_terminal_has_one_owner_and_can_disappear_and_return(tmp_path: Path) -> None:
    """The second opening is a Conflict during the first; a missing port is LinkDown, then NotFound.

    The port has a separate name, as an adapter has, because the system reuses the terminal's number for the next
    process that opens a terminal.
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    adapter = tmp_path / "tracker"
    adapter.symlink_to(os.ttyname(slave))
    name = str(adapter)
    first = open_stream(name)
    with pytest.raises(Conflict, match="another process uses"):
        open_stream(name)
    os.write(master, b"abc")
    assert first.read(10, 1.0)[:1] == b"a"
    first.close()
    second = open_stream(name)
    second.close()
    again = open_stream(name)
    os.close(slave)
    os.close(master)
    with pytest.raises(LinkDown):
        use_until_gone(again)
    again.close()
    adapter.unlink()
    with pytest.raises(NotFound):
        open_stream(name)
