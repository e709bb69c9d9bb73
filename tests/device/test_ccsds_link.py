"""CCSDS packets to and from the NOS3 star tracker software with the driver ``link``, also over TCP, UDP and ZeroMQ."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import pytest
import yaml
import zmq

from gss.device.driver import Driver, UnitSetup
from gss.device.link_driver import open_session
from gss.device.session_events import CommandUpdate, SessionEvent, Stage, Telemetry
from gss.device.transport import ByteStream, open_stream
from gss.domain.errors import LinkDown
from gss.instruments.dictionary.read_dictionary import parse_dictionary
from gss.instruments.link_file import LinkFile

COMMAND = (
    "  - {{name: {0}, code: {1}, subsystem: processor, purpose: p, idempotent: true, accept_s: 1, complete_s: 1}}\n"
)
DICTIONARY = (
    "version: 1\ndevice_model: nos3-software\ncommands:\n"
    + COMMAND.format("ENABLE", 2)
    + COMMAND.format("REQUEST_HOUSEKEEPING", 16)
    + COMMAND.format("REQUEST_DATA", 17)
    + """telemetry:
  - name: housekeeping
    code: 1
    purpose: p
    stale_after_s: 5
    fields:
      - {name: errors, type: u8}
      - {name: commands, type: u8}
      - {name: device_errors, type: u8}
      - {name: device_count, type: u8}
      - {name: enabled, type: bool}
      - {name: counter, type: u32}
  - name: attitude
    code: 2
    purpose: p
    stale_after_s: 5
    fields:
      - {name: q0, type: f64}
      - {name: q1, type: f64}
      - {name: q2, type: f64}
      - {name: q3, type: f64}
      - {name: valid, type: bool}
events: []
services: []
"""
)
HOUSEKEEPING = "09 35 C0 01 00 12 01 02 03 04 05 06 00 00 00 00 01 02 00 04 01 03 00 00 00"
HALF = "00 00 00 00 00 00 E0 3F"
DATA = f"09 36 C0 01 00 2A 01 02 03 04 05 06 00 00 00 00 {HALF} 00 00 00 00 00 00 E0 BF {HALF} {HALF} 01"


@pytest.fixture
def session(root: Path) -> Driver:
    """Session with the link.yaml of docs/instruments.md."""
    text = (root / "docs" / "instruments.md").read_text("utf-8")
    block = re.search(r"```yaml\n# ccsds_link.yaml\n(.*?)```", text, re.DOTALL)
    assert block
    rules = LinkFile.model_validate(yaml.safe_load(block[1]))
    driver = open_session(UnitSetup(parse_dictionary(DICTIONARY), rules, "nos3-cfs"))
    driver.link_up(0.0)
    return driver


@pytest.mark.parametrize(
    ("name", "wire"),
    [("ENABLE", "19 35 C0 00 00 01 02 10"), ("REQUEST_DATA", "19 36 C0 00 00 01 01 10")],
)
def test_requests_have_the_public_bytes(session: Driver, name: str, wire: str) -> None:
    """Requests have the primary header, function code and checksum that the flight software expects."""
    session.submit(session.encode(name, {}))
    assert session.poll(0.0)[0] == bytes.fromhex(wire)


def test_telemetry_is_read_from_packets_in_any_pieces(session: Driver) -> None:
    """Big-endian headers and little-endian content are decoded. The response completes its request; other packets are
    telemetry only."""
    session.submit(session.encode("REQUEST_DATA", {}))
    session.poll(0.0)
    both = bytes.fromhex(HOUSEKEEPING + DATA)
    events = [e for k in range(0, len(both), 7) for e in session.feed(both[k : k + 7], 0.1)]
    packets = {e.packet: e for e in events if isinstance(e, Telemetry)}
    assert packets["housekeeping"].values == {
        "errors": 1,
        "commands": 2,
        "device_errors": 0,
        "device_count": 4,
        "enabled": True,
        "counter": 3,
    }
    assert packets["housekeeping"].request_id == 0
    assert [packets["attitude"].values[f"q{k}"] for k in range(4)] == [0.5, -0.5, 0.5, 0.5]
    assert packets["attitude"].request_id == 1
    assert [e.stage for e in events if isinstance(e, CommandUpdate)] == [Stage.COMPLETED]


def test_packets_over_udp_reach_the_session(session: Driver) -> None:
    """A request is sent and a response received as datagrams on a real socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.1", 0))
        sensor.settimeout(10)
        stream = open_stream(f"udp://127.0.0.1:{sensor.getsockname()[1]}")
        session.submit(session.encode("REQUEST_DATA", {}))
        stream.write(session.poll(0.0)[0])
        request, ground = sensor.recvfrom(100)
        assert request == bytes.fromhex("19 36 C0 00 00 01 01 10")
        sensor.sendto(bytes.fromhex(DATA), ground)
        events = session.feed(stream.read(65536, 10.0), 0.1)
        assert any(isinstance(e, Telemetry) and e.packet == "attitude" for e in events)
        assert stream.read(65536, 0.01) == b""
        stream.close()
        with pytest.raises(LinkDown):
            stream.read(10, 0.01)


def answered(session: Driver, stream: ByteStream) -> None:
    """Read from the line until the response has completed the request and its packet was decoded."""
    events: list[SessionEvent] = []
    for _ in range(100):
        events += session.feed(stream.read(65536, 0.1), 0.1)
        if any(isinstance(e, CommandUpdate) and e.stage is Stage.COMPLETED for e in events):
            break
    packets = {e.packet: e.values for e in events if isinstance(e, Telemetry)}
    assert set(packets) == {"housekeeping", "attitude"}
    assert [packets["attitude"][f"q{k}"] for k in range(4)] == [0.5, -0.5, 0.5, 0.5]
    assert [e.stage for e in events if isinstance(e, CommandUpdate)] == [Stage.COMPLETED]
    stream.close()


def test_packets_over_tcp_reach_the_session(session: Driver) -> None:
    """A mission-control system receives a request and sends packets in pieces without relation to their borders."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        stream = open_stream(f"socket://127.0.0.1:{listener.getsockname()[1]}")
        remote, _ = listener.accept()
        with remote:
            remote.settimeout(10)
            session.submit(session.encode("REQUEST_DATA", {}))
            stream.write(session.poll(0.0)[0])
            assert remote.recv(8, socket.MSG_WAITALL) == bytes.fromhex("19 36 C0 00 00 01 01 10")
            both = bytes.fromhex(HOUSEKEEPING + DATA)
            for k in range(0, len(both), 11):
                remote.sendall(both[k : k + 11])
            answered(session, stream)


def test_packets_over_zeromq_reach_the_session(session: Driver) -> None:
    """A mission-control system receives a request as one message and sends one packet per message."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as remote:
        remote.setsockopt(zmq.RCVTIMEO, 10_000)
        remote.setsockopt(zmq.LINGER, 0)
        stream = open_stream(f"zmq://127.0.0.1:{remote.bind_to_random_port('tcp://127.0.0.1')}")
        session.submit(session.encode("REQUEST_DATA", {}))
        stream.write(session.poll(0.0)[0])
        assert remote.recv() == bytes.fromhex("19 36 C0 00 00 01 01 10")
        for packet in (HOUSEKEEPING, DATA):
            remote.send(bytes.fromhex(packet))
        answered(session, stream)


def test_without_a_peer_a_udp_line_is_silent() -> None:
    """UDP has no connection: without a peer, writes succeed and reads return no data."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    stream = open_stream(f"udp://127.0.0.1:{port}")
    for _ in range(3):
        stream.write(b"hello")
        assert stream.read(100, 0.05) == b""
    stream.close()


def test_a_host_without_address_is_rejected() -> None:
    """A host name that cannot be resolved is reported with the line's address."""
    with pytest.raises(LinkDown, match="cannot open udp://"):
        open_stream("udp://no-such-host.invalid:1234")
