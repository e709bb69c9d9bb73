"""Authentication of packets to the device: forged, replayed and unsigned ones are never executed; keys can be replaced."""

from __future__ import annotations

import hmac
import itertools
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.cli import main
from gss.device.link_keys import PacketCounter, new_link_keys, read_link_keys, with_new_key, write_link_keys
from gss.device.protocol.authentication import LinkKeys, PacketSigner, PacketVerifier
from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import LineSender, with_crc
from gss.device.session import HostSession
from gss.device.session_events import Stage
from gss.domain.errors import BadInput

if TYPE_CHECKING:
    from conftest import Bench

KEYS = LinkKeys({0: bytes(range(32)), 1: bytes(range(32, 64))}, 0)
PREFIX = 0x1234


def receiver(keys: LinkKeys = KEYS, accepted: int = 0) -> LineReceiver:
    """Return the device's end of a line with keys."""
    return LineReceiver(from_device=False, framing="cobs", verifier=PacketVerifier(keys, accepted))


def sender(keys: LinkKeys | None = KEYS, first: int = 1) -> LineSender:
    """Return the ground's end; it does not sign without keys."""
    signer = PacketSigner(keys, itertools.count(first).__next__) if keys else None
    return LineSender(to_device=True, prefix=PREFIX, signer=signer)


def test_the_bytes_of_the_trailer_are_those_of_the_document() -> None:
    """Clause 2.5, computed here from the standard library alone."""
    frame = sender(first=7).packet(PacketType.COMMAND, 2, 5, b"")
    from cobs import cobs

    packet = cobs.decode(frame.strip(b"\0"))
    assert packet[:2] == bytes([0x19, 0x81])
    body, head, mac = packet[:20], packet[20:29], packet[29:45]
    assert head == bytes([0]) + (7).to_bytes(8, "big")
    assert mac == hmac.digest(bytes(range(32)), body + head, "sha256")[:16]
    assert int.from_bytes(packet[4:6], "big") == len(packet) - 7


def test_a_signed_packet_is_accepted_once() -> None:
    """The same bytes again, and all with a lower counter, are dropped and counted."""
    line, end = sender(), receiver()
    frames = [line.packet(PacketType.COMMAND, 2, n, b"x") for n in range(1, 4)]
    assert [p.payload for p in end.feed(frames[0] + frames[2])] == [b"x", b"x"]
    assert end.feed(b"".join(frames)) == []
    assert end.unauthenticated == 3


def test_unsigned_and_wrongly_signed_packets_are_dropped() -> None:
    """Another key, a key in the other slot, an empty slot, and no trailer."""
    stranger = LinkKeys({0: bytes(32)}, 0)
    exchanged = LinkKeys({0: KEYS.keys[1]}, 0)
    end = receiver(LinkKeys({0: KEYS.keys[0]}, 0))
    for keys in (None, stranger, exchanged, LinkKeys(KEYS.keys, 1)):
        assert end.feed(sender(keys, 100).packet(PacketType.COMMAND, 2, 1, b"")) == []
    assert end.unauthenticated == 4


def test_forged_packets_are_never_accepted() -> None:
    """20 000 changed or invented packets with a valid CRC (seed 3); tools/forged_packets.py runs a million."""
    from tools.forged_packets import OLD, forged

    end = receiver(accepted=OLD)
    accepted = sum(len(end.feed(frame)) for frame in forged(KEYS, 20_000, np.random.default_rng(3)))
    assert (accepted, end.unauthenticated + end.unknown + end.too_short + end.deframer.too_long) == (0, 20_000)


def test_both_slots_are_accepted_while_a_key_is_replaced() -> None:
    """The ground changes the slot, the device has both; a removed key is no longer accepted."""
    end = receiver()
    assert len(end.feed(sender(KEYS, 1).packet(PacketType.COMMAND, 2, 1, b""))) == 1
    assert len(end.feed(sender(LinkKeys(KEYS.keys, 1), 2).packet(PacketType.COMMAND, 2, 2, b""))) == 1


def test_a_whole_session_with_authentication(make_bench: Callable[..., Bench]) -> None:
    """HELLO, a command, a download and ABORT; after a reset the recorded command is still refused."""
    bench = make_bench(keys=KEYS)
    bench.until(lambda: bench.host.hello is not None)
    recorded: list[bytes] = []
    feed = bench.device.feed
    bench.device.feed = lambda data, now_s: recorded.append(data) or feed(data, now_s)  # type: ignore[method-assign]
    assert bench.do("TAKE_IMAGE").stage is Stage.COMPLETED
    bench.device.feed = feed  # type: ignore[method-assign]
    assert bench.bring("frame", 0)
    assert bench.do("RESET").stage is Stage.COMPLETED
    bench.run(10.0)
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED
    frames = bench.memory.record.frames
    bad = bench.status()["frames_bad"]
    bench.device.feed(b"".join(recorded), bench.now_s)
    bench.run(5.0)
    assert bench.memory.record.frames == frames == 1
    assert bench.status()["frames_bad"] > bad
    assert bench.memory.record.accepted_counter > 0


def test_a_ground_without_keys_gets_no_answer(make_bench: Callable[..., Bench]) -> None:
    """Telemetry still arrives: it is not signed."""
    bench = make_bench(keys=KEYS)
    bench.host, bench.events = HostSession(bench.dictionary), []
    bench.host.link_up(bench.now_s)
    bench.run(10.0)
    assert bench.host.hello is None
    assert bench.telemetry("housekeeping")


def test_the_counter_rises_over_restarts_and_a_clock_set_back(tmp_path: Path) -> None:
    """Each value is above all earlier ones, whatever the clock does and wherever the program ended."""
    path, clock = tmp_path / "counter", [1_000_000]
    values = []
    for time_us in (1_000_000, 1_000_001, 500_000, 30_000_000, 0):
        clock[0] = time_us
        counter = PacketCounter(path, lambda: clock[0])
        values += [counter() for _ in range(3)]
    assert values == sorted(set(values))


def test_key_files_are_private_and_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Made by the command line; readable by others, broken or short files are refused with the reason."""
    path = tmp_path / "link.keys"
    assert main(["link-keys", str(path), "--new"]) == 0
    assert main(["link-keys", str(path), "--new"]) == 2
    assert main(["link-keys", str(path), "--activate", "1"]) == 2
    assert main(["link-keys", str(path), "--add"]) == 0
    assert main(["link-keys", str(path), "--activate", "1"]) == 0
    keys = read_link_keys(path)
    assert (keys.active, len(keys.keys)) == (1, 2)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    shown = capsys.readouterr()
    assert all(key.hex() not in shown.out + shown.err + repr(keys) for key in keys.keys.values())
    path.chmod(0o644)
    with pytest.raises(BadInput, match="other users"):
        read_link_keys(path)
    path.chmod(0o600)
    for text in ("", "{}", '{"active": 0, "keys": {"0": "00"}}', '{"active": 1, "keys": {}}', "[1]"):
        path.write_text(text)
        with pytest.raises(BadInput):
            read_link_keys(path)


def test_a_new_key_leaves_the_active_one(tmp_path: Path) -> None:
    """The other slot gets a new key each time."""
    first = new_link_keys()
    second, third = with_new_key(first), with_new_key(with_new_key(first))
    assert second.keys[0] == third.keys[0] == first.keys[0]
    assert second.keys[1] != third.keys[1]
    write_link_keys(tmp_path / "k", second)
    assert read_link_keys(tmp_path / "k") == second


def test_a_crc_alone_does_not_authenticate() -> None:
    """A packet with the signed APID, any trailer and a valid CRC is dropped."""
    from cobs import cobs

    packet = bytearray(cobs.decode(sender().packet(PacketType.COMMAND, 2, 5, b"").strip(b"\0")))
    packet[-10] ^= 1
    end = receiver()
    assert end.feed(b"\0" + cobs.encode(with_crc(bytes(packet[:-4]))) + b"\0") == []
    assert end.unauthenticated == 1
