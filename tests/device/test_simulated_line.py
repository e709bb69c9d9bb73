"""Faults of the simulated line: each kind counted, changeable while open, and through a real terminal."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from gss.device.simulator.faults import BURST_BYTES, FaultCounts, FaultRates, LineControl, LineFaults
from gss.device.simulator.terminal import DeviceLine, PtyLine, TcpLine, Terminal
from gss.domain.errors import BadInput

DATA = bytes(range(256)) * 400


class EchoDevice:
    """A device that stores received bytes and sends what the test provides."""

    def __init__(self) -> None:
        self.received, self.to_say = b"", []  # type: bytes, list[bytes]

    def feed(self, data: bytes, now_s: float) -> None:
        self.received += data

    def next_frame(self, now_s: float) -> bytes | None:
        return self.to_say.pop(0) if self.to_say else None

    def advance(self, now_s: float) -> None:
        pass


class World:
    """A terminal on a line with a clock that the test advances."""

    def __init__(self, line: DeviceLine, baud: int = 0, rates: FaultRates | None = None) -> None:
        self.now_s, self.device, self.line = 0.0, EchoDevice(), line
        self.control = LineControl(rates, 5)
        self.terminal = Terminal(line, self.device, lambda: self.now_s, baud / 10, self.control)  # type: ignore[arg-type]

    def turns(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / 0.01))):
            self.now_s += 0.01
            self.terminal.run_once(0.001)


@pytest.fixture
def pty(tmp_path: Path) -> Iterator[PtyLine]:
    line = PtyLine(tmp_path / "port")
    yield line
    line.close()


@pytest.fixture
def tcp() -> Iterator[TcpLine]:
    line = TcpLine(0)
    yield line
    line.close()


def _hung_up(handle: int) -> bool:
    """True if reading returns the end or an error, depending on the system."""
    try:
        return os.read(handle, 10) == b""
    except OSError:
        return True


def _pieces(data: bytes, apply: Callable[[bytes], bytes]) -> bytes:
    return b"".join(apply(data[i : i + 1000]) for i in range(0, len(data), 1000))


@pytest.mark.parametrize(
    ("rates", "count"),
    [
        (FaultRates(bit_error_rate=1e-3), "bits_flipped"),
        (FaultRates(burst_rate=0.05), "bursts"),
        (FaultRates(drop_rate=0.05), "pieces_dropped"),
        (FaultRates(duplicate_rate=0.05), "pieces_doubled"),
    ],
)
def test_each_fault_comes_at_its_rate_and_is_counted(rates: FaultRates, count: str) -> None:
    """The counter of the fault has the number of affected bytes, the others stay 0, and the seed reproduces it."""
    line, again = LineFaults(rates, 3), LineFaults(rates, 3)
    spoiled = _pieces(DATA, line.apply)
    assert spoiled == _pieces(DATA, again.apply) != DATA
    counted = vars(line.counts)
    assert {name for name, number in counted.items() if number} == {count}
    expected = 8 * len(DATA) * 1e-3 if count == "bits_flipped" else len(DATA) / 1000 * 16 * 0.05
    assert counted[count] == pytest.approx(expected, rel=0.3)
    if count == "pieces_dropped":
        assert (len(DATA) - len(spoiled)) / 64 == pytest.approx(counted[count], rel=0.1)
    if count == "bits_flipped":
        wrong = np.unpackbits(np.frombuffer(spoiled, np.uint8) ^ np.frombuffer(DATA, np.uint8)).sum()
        assert 0.98 * counted[count] < wrong <= counted[count]


def test_a_burst_is_short_and_in_one_place() -> None:
    """At most sixteen neighbouring bytes change, and the length remains."""
    line = LineFaults(FaultRates(burst_rate=1.0), 8)
    for _ in range(50):
        piece = bytes(64)
        changed = np.flatnonzero(np.frombuffer(line.apply(piece), np.uint8))
        assert len(changed) == 0 or changed[-1] - changed[0] < BURST_BYTES
    assert line.counts.bursts == 50


def test_delayed_bytes_arrive_in_order_and_late() -> None:
    """No byte arrives before the delay has passed. After the delay is removed, delayed bytes still arrive before later ones."""
    line = LineFaults(FaultRates(delay_s=0.5), 1)
    assert line.carry(b"one", 10.0) == b""
    assert line.carry(b"two", 10.2) == b""
    assert line.carry(b"", 10.49) == b""
    assert line.carry(b"", 10.5) == b"one"
    line.rates = FaultRates()
    assert line.carry(b"three", 10.6) == b""
    assert line.carry(b"", 10.71) == b"twothree"
    assert line.carry(b"four", 10.72) == b"four"
    assert line.counts.bytes_delayed == 11


def test_rates_change_by_name_and_direction() -> None:
    """Only the named rate of the named direction changes; invalid input changes nothing."""
    control = LineControl(FaultRates(drop_rate=0.1), 2)
    control.set("up", bit_error_rate=1e-4)
    control.set(delay_s=0.2)
    assert control.up.rates == FaultRates(bit_error_rate=1e-4, drop_rate=0.1, delay_s=0.2)
    assert control.down.rates == FaultRates(drop_rate=0.1, delay_s=0.2)
    for wrong in ({"direction": "sideways"}, {"loudness": 1.0}, {"drop_rate": 1.5}, {"delay_s": float("nan")}):
        with pytest.raises(BadInput):
            control.set(**wrong)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="disconnection is out of range"):
        control.disconnect(0.0)
    assert control.up.rates.drop_rate == 0.1
    control.clear()
    assert control.up.rates == control.down.rates == FaultRates()
    assert control.up.counts == FaultCounts()


def test_faults_set_while_the_line_is_open_take_effect(tcp: TcpLine) -> None:
    """A real connection transfers all blocks, then loses every block of the downlink only, then transfers all again."""
    world = World(tcp)
    with socket.create_connection(("127.0.0.1", int(tcp.url.rsplit(":", 1)[1]))) as peer:
        peer.settimeout(2)
        world.turns(0.02)
        world.device.to_say = [b"hello"]
        world.turns(0.02)
        assert peer.recv(100) == b"hello"
        world.control.set("down", drop_rate=1.0)
        world.device.to_say = [b"lost"]
        peer.sendall(b"up")
        world.turns(0.05)
        world.control.clear()
        world.device.to_say = [b"back"]
        world.turns(0.02)
        assert peer.recv(100) == b"back"
        assert world.device.received == b"up"
        assert world.control.down.counts.pieces_dropped == 1


def test_delay_applies_both_ways_and_keeps_the_data_rate(tcp: TcpLine) -> None:
    """A second of bytes takes a second and arrives after the delay."""
    world = World(tcp, 9600, FaultRates(delay_s=0.3))
    with socket.create_connection(("127.0.0.1", int(tcp.url.rsplit(":", 1)[1]))) as peer:
        peer.setblocking(False)
        world.turns(0.02)
        world.device.to_say = [bytes(96)] * 10
        peer.send(bytes(480))
        came: list[tuple[float, int]] = []
        for _ in range(150):
            world.turns(0.01)
            try:
                came.append((world.now_s, len(peer.recv(4096))))
            except BlockingIOError:
                continue
        assert sum(n for _, n in came) == 960
        assert came[0][0] == pytest.approx(0.33, abs=0.03)
        assert came[-1][0] == pytest.approx(1.33, abs=0.06)
        assert world.device.received == bytes(480)


def test_a_stall_blocks_the_line_and_is_counted(tcp: TcpLine) -> None:
    """No byte arrives during the stall; all of them arrive afterwards."""
    world = World(tcp, 0, FaultRates(stall_rate=100.0, stall_s=0.5))
    with socket.create_connection(("127.0.0.1", int(tcp.url.rsplit(":", 1)[1]))) as peer:
        peer.sendall(b"later")
        world.now_s = 1.0
        world.turns(0.3)
        world.control.clear()
        world.turns(0.6)
        assert world.device.received == b"later"
        assert world.control.up.counts.stalls >= 1


def test_a_cut_tcp_line_drops_the_connection_and_is_restored(tcp: TcpLine) -> None:
    """The peer reads end of file; new connections are rejected meanwhile; afterwards the same port works."""
    world = World(tcp)
    address = ("127.0.0.1", int(tcp.url.rsplit(":", 1)[1]))
    with socket.create_connection(address) as peer:
        peer.settimeout(2)
        world.turns(0.02)
        world.control.disconnect(1.0)
        world.device.to_say = [b"last words"]
        world.turns(0.1)
        assert peer.recv(100) == b"last words"
        world.turns(0.2)
        assert peer.recv(100) == b""
        world.device.to_say = [b"into the void"]
    with socket.create_connection(address) as early:
        early.settimeout(2)
        world.turns(0.1)
        assert early.recv(100) == b""
    world.turns(1.0)
    assert world.control.disconnects == 1
    assert world.control.down.counts.bytes_lost_disconnected == len(b"into the void")
    with socket.create_connection(address) as late:
        late.settimeout(2)
        world.turns(0.02)
        world.device.to_say = [b"again"]
        world.turns(0.02)
        assert late.recv(100) == b"again"


def test_a_cut_named_port_disappears_and_returns(pty: PtyLine, tmp_path: Path) -> None:
    """The symlink is removed and the open port hangs up; later the same name is a working port."""
    world, name = World(pty), tmp_path / "port"
    handle = os.open(name, os.O_RDWR | os.O_NOCTTY)
    world.control.disconnect(0.5)
    world.turns(0.3)
    assert not name.exists()
    assert _hung_up(handle)
    os.close(handle)
    world.turns(0.6)
    handle = os.open(name, os.O_RDWR | os.O_NOCTTY)
    os.write(handle, b"hello")
    world.turns(0.05)
    assert world.device.received == b"hello"
    os.close(handle)


def test_a_nameless_port_only_stops_transferring() -> None:
    """A pseudo-terminal without a name remains open without transferring data, because it could not be opened again."""
    line = PtyLine()
    world = World(line)
    handle = os.open(line.url, os.O_RDWR | os.O_NOCTTY)
    world.control.disconnect(0.5)
    world.turns(0.3)
    os.write(handle, b"lost bytes")
    world.turns(0.2)
    world.turns(0.5)
    os.write(handle, b"now")
    world.turns(0.05)
    assert world.device.received == b"now"
    os.close(handle)
    line.close()


def test_bytes_wait_for_a_reader_that_pauses_for_seconds(pty: PtyLine, tmp_path: Path) -> None:
    """No byte is lost while the buffer is full for four seconds. If no one reads for longer, the lost bytes are counted."""
    world, frames = World(pty), [bytes([i % 251]) * 100 for i in range(400)]
    handle = os.open(tmp_path / "port", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    world.device.to_say = list(frames)
    world.turns(4.0)
    received = b""
    while len(received) < 40_000:
        world.turns(0.01)
        received += os.read(handle, 65536)
    assert received == b"".join(frames)
    assert world.control.down.counts == FaultCounts()
    world.device.to_say = list(frames)
    world.turns(8.0)
    assert world.control.down.counts.bytes_lost_unread > 0
    os.close(handle)
