"""Ports that are in use, that close, or that disappear and return."""

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
    """Function that starts a TCP server with one behaviour per connection and returns its address."""
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
    """A server that accepts and closes the connection gives a Conflict with a hint, not a line that opens repeatedly."""
    with pytest.raises(Conflict, match="closed the connection immediately") as error:
        open_stream(serve(lambda peer: peer.close()))
    assert "another program" in error.value.hint


def test_bytes_received_while_opening_are_not_lost(serve: Serve) -> None:
    """Data that a device sends during opening are received from the first byte."""
    peers_held: list[socket.socket] = []

    def greet(peer: socket.socket) -> None:
        peers_held.append(peer)
        time.sleep(0.05)  # pyserial empties the buffer when it connects
        peer.sendall(b"hello")

    stream = open_stream(serve(greet))
    received = b""
    for _ in range(20):
        received += stream.read(100, 0.1)
    assert received == b"hello"
    peers_held[0].close()
    with pytest.raises(LinkDown):
        use_until_gone(stream)
    stream.close()


def test_a_silent_device_is_not_an_error(serve: Serve) -> None:
    """A line to a device that sends nothing while it is opened is open."""
    peers_held: list[socket.socket] = []
    stream = open_stream(serve(peers_held.append))
    assert stream.read(10, 0.01) == b""
    stream.close()
    for peer in peers_held:
        peer.close()


def wait_for_openings() -> None:
    """Wait until no opening of an earlier test is in progress."""
    for thread in [thread for thread in threading.enumerate() if thread.name == "open line"]:
        thread.join(30)


def test_a_port_that_opens_after_the_deadline_is_closed(serve: Serve) -> None:
    """The caller gets LinkDown at the deadline, and a connection that opens later is closed."""
    peers: list[socket.socket] = []
    with pytest.raises(LinkDown, match=r"an open port within 0.01 s; got no answer"):
        open_stream(serve(peers.append), within_s=0.01)
    wait_for_openings()
    with peers[0] as peer:
        peer.settimeout(30)
        assert peer.recv(1) == b""


def test_hanging_openings_are_limited(serve: Serve) -> None:
    """Openings of a peer that never negotiates use a bounded number of threads. Lines can be opened again afterwards."""
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


def test_an_opening_whose_thread_cannot_start_is_not_counted(serve: Serve) -> None:
    """If no thread can be started for lack of memory, each opening is LinkDown. Lines can be opened again afterwards."""
    peers_held: list[socket.socket] = []
    url = serve(peers_held.append)
    before = threading.stack_size(1 << 47)  # more than a process can address
    try:
        for _ in range(UNFINISHED_MOST + 1):
            with pytest.raises(LinkDown, match="cannot open"):
                open_stream(url)
    finally:
        threading.stack_size(before)
    open_stream(url).close()
    for peer in peers_held:
        peer.close()


def test_a_terminal_has_one_owner_and_can_disappear_and_return(tmp_path: Path) -> None:
    """A terminal cannot be opened twice. If it disappears, the line is LinkDown, and opening it is NotFound.

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
    third = open_stream(name)
    os.close(slave)
    os.close(master)
    with pytest.raises(LinkDown):
        use_until_gone(third)
    third.close()
    adapter.unlink()
    with pytest.raises(NotFound):
        open_stream(name)
