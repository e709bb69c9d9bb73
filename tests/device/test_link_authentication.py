"""Authentication of packets to the device: forged, replayed and unsigned packets are dropped, and keys can be replaced."""

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
from gss.device.link_keys import RESERVE_US, PacketCounter, new_link_keys, read_link_keys, with_new_key, write_link_keys
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
    """Return the device's receiver of a line with keys."""
    return LineReceiver(from_device=False, framing="cobs", verifier=PacketVerifier(keys, accepted))


def sender(keys: LinkKeys | None = KEYS, first: int = 1) -> LineSender:
    """Return the ground's sender, which signs if it has keys."""
    signer = PacketSigner(keys, itertools.count(first).__next__) if keys else None
    return LineSender(to_device=True, prefix=PREFIX, signer=signer)


def test_the_bytes_of_the_trailer_are_those_of_the_document() -> None:
    """The trailer has the bytes of clause 2.5, computed here with the standard library."""
    frame = sender(first=7).packet(PacketType.COMMAND, 2, 5, b"")
    from cobs import cobs

    packet = cobs.decode(frame.strip(b"\0"))
    assert packet[:2] == bytes([0x19, 0x81])
    body, head, mac = packet[:20], packet[20:29], packet[29:45]
    assert head == bytes([0]) + (7).to_bytes(8, "big")
    assert mac == hmac.digest(bytes(range(32)), body + head, "sha256")[:16]
    assert int.from_bytes(packet[4:6], "big") == len(packet) - 7


def test_a_signed_packet_is_accepted_once() -> None:
    """Repeated packets and packets with a lower counter are dropped and counted."""
    uplink, unit_receiver = sender(), receiver()
    frames = [uplink.packet(PacketType.COMMAND, 2, n, b"x") for n in range(1, 4)]
    assert [p.payload for p in unit_receiver.feed(frames[0] + frames[2])] == [b"x", b"x"]
    assert unit_receiver.feed(b"".join(frames)) == []
    assert unit_receiver.unauthenticated == 3


def test_unsigned_and_wrongly_signed_packets_are_dropped() -> None:
    """Packets with another key, a key of the other slot, an empty slot or no trailer are dropped and counted."""
    other_key = LinkKeys({0: bytes(32)}, 0)
    key_in_other_slot = LinkKeys({0: KEYS.keys[1]}, 0)
    unit_receiver = receiver(LinkKeys({0: KEYS.keys[0]}, 0))
    for keys in (None, other_key, key_in_other_slot, LinkKeys(KEYS.keys, 1)):
        assert unit_receiver.feed(sender(keys, 100).packet(PacketType.COMMAND, 2, 1, b"")) == []
    assert unit_receiver.unauthenticated == 4


def test_forged_packets_are_never_accepted() -> None:
    """None of 20 000 changed or invented packets with a valid CRC is accepted (seed 3). tools/forged_packets.py tests a
    million."""
    from tools.forged_packets import OLD, forged

    unit_receiver = receiver(accepted=OLD)
    accepted = sum(len(unit_receiver.feed(frame)) for frame in forged(KEYS, 20_000, np.random.default_rng(3)))
    assert (
        accepted,
        unit_receiver.unauthenticated
        + unit_receiver.unknown
        + unit_receiver.too_short
        + unit_receiver.deframer.too_long,
    ) == (0, 20_000)


def test_both_slots_are_accepted_while_a_key_is_replaced() -> None:
    """A device with two keys accepts packets that are signed with either of them."""
    unit_receiver = receiver()
    assert len(unit_receiver.feed(sender(KEYS, 1).packet(PacketType.COMMAND, 2, 1, b""))) == 1
    assert len(unit_receiver.feed(sender(LinkKeys(KEYS.keys, 1), 2).packet(PacketType.COMMAND, 2, 2, b""))) == 1


def test_a_complete_session_with_authentication(make_bench: Callable[..., Bench]) -> None:
    """Commands and a download work with authentication. A recorded command is rejected when it is replayed, also after a
    reset."""
    bench = make_bench(keys=KEYS)
    bench.until(lambda: bench.host.hello is not None)
    recorded: list[bytes] = []
    feed = bench.device.feed
    bench.device.feed = lambda data, now_s: recorded.append(data) or feed(data, now_s)  # type: ignore[method-assign]
    assert bench.do("TAKE_IMAGE").stage is Stage.COMPLETED
    bench.device.feed = feed  # type: ignore[method-assign]
    assert bench.download("frame", 0)
    assert bench.do("RESET").stage is Stage.COMPLETED
    bench.run(10.0)
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED
    frames = bench.memory.record.frames
    bad_before = bench.status()["frames_bad"]
    bench.device.feed(b"".join(recorded), bench.now_s)
    bench.run(5.0)
    assert bench.memory.record.frames == frames == 1
    assert bench.status()["frames_bad"] > bad_before
    assert bench.memory.record.accepted_counter > 0


def test_a_ground_without_keys_gets_no_answer(make_bench: Callable[..., Bench]) -> None:
    """The device does not answer a ground without keys. Telemetry is not signed and is received."""
    bench = make_bench(keys=KEYS)
    bench.host, bench.events = HostSession(bench.dictionary), []
    bench.host.link_up(bench.now_s)
    bench.run(10.0)
    assert bench.host.hello is None
    assert bench.telemetry("housekeeping")


def test_the_counter_rises_over_restarts_and_a_clock_set_back(tmp_path: Path) -> None:
    """Each counter value is above all earlier ones, also after a restart and if the clock was set back."""
    path, clock = tmp_path / "counter", [1_000_000]
    values = []
    for time_us in (1_000_000, 1_000_001, 500_000, 30_000_000, 0):
        clock[0] = time_us
        counter = PacketCounter(path, lambda: clock[0])
        values += [counter() for _ in range(3)]
    assert values == sorted(set(values))


def test_no_counter_is_used_that_could_not_be_reserved(tmp_path: Path) -> None:
    """While the file cannot be written, every request for a counter that it does not reserve fails. A restart then does not
    use a counter again."""
    folder, clock = tmp_path / "keys", [1_000_000]
    folder.mkdir()
    counter = PacketCounter(folder / "counter", lambda: clock[0])
    used = [counter()]
    clock[0] += 2 * RESERVE_US
    folder.rename(tmp_path / "unavailable")
    for _ in range(3):
        with pytest.raises(OSError, match="counter"):
            counter()
    (tmp_path / "unavailable").rename(folder)
    used.append(counter())
    clock[0] = 0
    used.append(PacketCounter(folder / "counter", lambda: clock[0])())
    assert used == sorted(set(used))


def test_key_files_are_private_and_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command line creates key files that only the user can read. Files that are readable by others or invalid are
    rejected, and no output contains a key."""
    path = tmp_path / "link.keys"
    assert main(["link-keys", str(path), "--new"]) == 0
    assert main(["link-keys", str(path), "--new"]) == 2
    assert main(["link-keys", str(path), "--activate", "1"]) == 2
    assert main(["link-keys", str(path), "--add"]) == 0
    assert main(["link-keys", str(path), "--activate", "1"]) == 0
    keys = read_link_keys(path)
    assert (keys.active, len(keys.keys)) == (1, 2)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    output = capsys.readouterr()
    assert all(key.hex() not in output.out + output.err + repr(keys) for key in keys.keys.values())
    path.chmod(0o644)
    with pytest.raises(BadInput, match="other users"):
        read_link_keys(path)
    path.chmod(0o600)
    for text in ("", "{}", '{"active": 0, "keys": {"0": "00"}}', '{"active": 1, "keys": {}}', "[1]"):
        path.write_text(text)
        with pytest.raises(BadInput):
            read_link_keys(path)


def test_a_new_key_does_not_replace_the_active_one(tmp_path: Path) -> None:
    """A new key is stored in the inactive slot each time, and the active key is kept."""
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
    unit_receiver = receiver()
    assert unit_receiver.feed(b"\0" + cobs.encode(with_crc(bytes(packet[:-4]))) + b"\0") == []
    assert unit_receiver.unauthenticated == 1
