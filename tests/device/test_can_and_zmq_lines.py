"""Lines over a CAN bus and over ZeroMQ, on real sockets and a real pseudo-terminal."""

from __future__ import annotations

import os
import socket
import tty
from collections.abc import Callable, Iterator

import can
import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.can_frames import RECORD, CanFrame, CanReader
from gss.device.transport import ByteStream, open_stream
from gss.domain.errors import LinkDown, NotFound

GROUP = "239.74.163.2"
ANSWER = CanFrame(0x5AC, bytes.fromhex("4F00400002000000"))


def wait_for(stream: ByteStream, enough: Callable[[bytes], bool]) -> bytes:
    """Read until ``enough`` is true. There is no deadline here: the timeout of the test applies."""
    data = b""
    while not enough(data):
        data += stream.read(4096, 0.05)
    return data


@pytest.fixture
def bus() -> Iterator[tuple[can.BusABC, str]]:
    """Another program on a bus on this machine, and the address of that bus."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        port = taken.getsockname()[1]
    other = can.Bus(GROUP, interface="udp_multicast", port=port, fd=False, hop_limit=0)
    yield other, f"can://udp_multicast/{GROUP}:{port}"
    other.shutdown()


frames = st.builds(CanFrame, st.integers(0, 0x7FF), st.binary(max_size=8), st.just(False), st.booleans()) | st.builds(
    CanFrame, st.integers(0, 0x1FFF_FFFF), st.binary(max_size=8), st.just(True), st.booleans()
)


@settings(deadline=None)
@given(st.lists(frames, max_size=6), st.lists(st.integers(1, 40), max_size=8))
def test_records_are_read_from_pieces_of_any_length(sent: list[CanFrame], cuts: list[int]) -> None:
    """All frames are read unchanged and in order, however the bytes are divided."""
    data, reader, received = b"".join(f.record() for f in sent), CanReader(), []
    for cut in cuts:
        received += reader.feed(data[:cut])
        data = data[cut:]
    received += reader.feed(data)
    assert (received, reader.unframed) == (sent, 0)


@settings(deadline=None)
@given(st.binary(max_size=64))
def test_a_reader_recovers_after_any_bytes(noise: bytes) -> None:
    """After arbitrary bytes the reader loses at most three records and reads all further ones."""
    reader = CanReader()
    reader.feed(noise)
    received = reader.feed(ANSWER.record() * 8)
    assert received[-5:] == [ANSWER] * 5


def test_a_record_has_the_head_of_a_capture_file() -> None:
    """A record has the same header as in a capture file of type LINKTYPE_CAN_SOCKETCAN."""
    assert ANSWER.record() == bytes.fromhex("000005AC 08000000 4F00400002000000")
    assert CanFrame(0x1234, b"\1", extended=True).record()[:4] == bytes.fromhex("80001234")
    assert RECORD.size == 16


def test_frames_pass_a_bus_that_two_programs_share(bus: tuple[can.BusABC, str]) -> None:
    """Frames pass in both directions, with identifiers of both lengths. An incomplete record waits for its remaining
    bytes."""
    other, url = bus
    stream = open_stream(url)
    record = ANSWER.record()
    stream.write(record[:5])
    stream.write(record[5:] + CanFrame(0x1ABCDEF0, b"", extended=True).record())
    received = [other.recv(5.0), other.recv(5.0)]
    assert [(m.arbitration_id, m.is_extended_id, bytes(m.data)) for m in received if m is not None] == [
        (0x5AC, False, ANSWER.data),
        (0x1ABCDEF0, True, b""),
    ]
    for k in range(50):
        other.send(can.Message(arbitration_id=0x1AC, data=bytes([k]), is_extended_id=False))
    data = wait_for(stream, lambda data: bytes([49]) + bytes(7) == data[-8:])
    assert [f.data[0] for f in CanReader().feed(data) if f.id == 0x1AC] == list(range(50))
    stream.close()
    stream.close()
    with pytest.raises(LinkDown, match="was lost"):
        stream.read(16, 0.0)


def test_noise_on_the_bus_gives_no_frames(bus: tuple[can.BusABC, str]) -> None:
    """Datagrams without a frame are dropped, and the next frame is read."""
    other, url = bus
    stream = open_stream(url)
    port = int(url.rsplit(":", 1)[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
        noise.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        for data in (b"\xc1", b"\x81\xa1a\x01", b"plain text"):
            noise.sendto(data, (GROUP, port))
    other.send(can.Message(arbitration_id=0x72C, data=b"\5", is_extended_id=False))
    data = wait_for(stream, lambda data: bool(data))
    assert CanReader().feed(data) == [CanFrame(0x72C, b"\5")]
    stream.close()


def test_a_serial_adapter_carries_frames() -> None:
    """Frames are written and read as the text of an SLCAN adapter. Damaged lines are dropped, and the line ends when the
    port disappears."""
    master, slave = os.openpty()
    tty.setraw(slave)
    stream = open_stream(f"can://slcan{os.ttyname(slave)}", 1_000_000)
    stream.write(ANSWER.record())
    text = b""
    while b"t5AC" not in text:
        text += os.read(master, 100)
    assert b"S8\r" in text.split(b"t5AC")[0]
    assert b"t5AC84F00400002000000\r" in text
    os.write(master, b"tXYZ\r\xff\xfe\r")
    for _ in range(3):
        assert stream.read(100, 0.02) == b""
    os.write(master, b"t72C105\r")
    data = wait_for(stream, lambda data: bool(data))
    assert CanReader().feed(data) == [CanFrame(0x72C, b"\5")]
    os.close(slave)
    os.close(master)
    with pytest.raises(LinkDown, match="was lost"):
        wait_for(stream, lambda _: False)
    stream.close()


def test_a_bus_that_cannot_be_opened_is_reported_with_a_hint() -> None:
    """A missing interface is reported with a hint, and so is a missing adapter port."""
    with pytest.raises(LinkDown, match="cannot open can://socketcan/nocan7") as error:
        open_stream("can://socketcan/nocan7")
    assert "ip link set" in error.value.hint
    with pytest.raises(NotFound, match="there is no port /dev/no-adapter"):
        open_stream("can://slcan/dev/no-adapter")


@pytest.fixture
def far_end() -> Iterator[tuple[zmq.Socket[bytes], str]]:
    """The socket of a mission-control system, and its address."""
    context = zmq.Context()
    remote = context.socket(zmq.DEALER)
    port = remote.bind_to_random_port("tcp://127.0.0.1")
    yield remote, f"zmq://127.0.0.1:{port}"
    remote.close(linger=0)
    context.term()


def test_bytes_and_packets_pass_zeromq(far_end: tuple[zmq.Socket[bytes], str]) -> None:
    """Each write sends one message. Messages with one or several parts are read as one stream of bytes."""
    remote, url = far_end
    stream = open_stream(url)
    packet = bytes.fromhex("1935C00000010210")
    stream.write(packet)
    assert remote.recv() == packet
    remote.send(packet)
    remote.send_multipart([b"\1\2", b"\3"])
    assert wait_for(stream, lambda data: len(data) >= 11) == packet + b"\1\2\3"
    remote.send(bytes(100))
    assert stream.read(60, 5.0) + stream.read(60, 5.0) == bytes(100)
    assert stream.read(60, 0.0) == b""
    stream.close()
    stream.close()
    with pytest.raises(LinkDown, match="was lost"):
        stream.write(b"x")


def test_a_zeromq_line_ends_when_the_other_end_closes(far_end: tuple[zmq.Socket[bytes], str]) -> None:
    """All received data are read before the line reports that the other end closed."""
    remote, url = far_end
    stream = open_stream(url)
    stream.write(b"hello")
    assert remote.recv() == b"hello"
    remote.send(b"last")
    remote.close(linger=5000)
    assert wait_for(stream, lambda data: data == b"last")
    with pytest.raises(LinkDown, match="the other end closed"):
        wait_for(stream, lambda _: False)
    stream.close()


def test_only_a_zeromq_socket_opens_the_line() -> None:
    """Opening the line fails for a silent server after the deadline, for a closed port and for an unknown host."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with pytest.raises(LinkDown, match="cannot open"):
            open_stream(f"zmq://127.0.0.1:{port}", within_s=0.2)
    with pytest.raises(LinkDown, match=r"refused|no answer"):
        open_stream(f"zmq://127.0.0.1:{port}")
    with pytest.raises(LinkDown, match="cannot open"):
        open_stream("zmq://no-such-host.invalid:5555", within_s=1.0)
