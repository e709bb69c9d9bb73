"""arcsec's Sagitta: driver, package and simulated unit compared with public byte vectors."""

from __future__ import annotations

import numpy as np
import pytest
import xxhash
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.driver import Driver, open_driver
from gss.device.link_framing import DelimitedFramer
from gss.device.sagitta_driver import ACTION, packet
from gss.device.session_events import CommandUpdate, SessionEvent, Stage, Telemetry
from gss.device.simulator.environment import Environment
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.other_makers import UnitWorld
from gss.device.simulator.sagitta import BOOTED, SET_TIME, SagittaUnit, open_unit
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.dictionary.definitions import Value
from gss.instruments.package import Instrument
from gss.instruments.registry import shipped_registry

ATTITUDE = cam_from_icrs(*np.radians([84.0, 5.0, 30.0]))
ZERO14 = "00 " * 14
ASYNCHRONOUS = (
    "C0 21 84 1B 00 05 00 00 00 90 10 22 18 24 0A 06 00 00 00 D0 41 00 00 DB DC 41 00 00 C8 41 E9 44 B3 DE C0"
)


@pytest.fixture(scope="module")
def sagitta() -> Instrument:
    """The shipped package."""
    return shipped_registry().get("sagitta")


def unit_of(instrument: Instrument, *dialects: str) -> SagittaUnit:
    """Return a simulated unit that points to ``ATTITUDE``."""
    environment = Environment(instrument.profile, Inertial(ATTITUDE, np.zeros(3)))
    return open_unit(UnitWorld(instrument, environment, 1, frozenset(dialects)))


def open_session_of(instrument: Instrument) -> Driver:
    """Return a session on an open line."""
    session = open_driver(instrument)
    session.link_up(0.0)
    return session


def sent_by(session: Driver, name: str, arguments: dict[str, Value]) -> bytes:
    """Submit a command and return its frame. Commands are sent before repeated requests."""
    session.submit(session.encode(name, arguments))
    return session.poll(0.0)[0]


def talk(session: Driver, unit: SagittaUnit, since_s: float, seconds: float) -> list[SessionEvent]:
    """Run both ends in memory. Return the host's events."""
    events: list[SessionEvent] = []
    for k in range(int(seconds * 50)):
        now_s = since_s + 0.02 * k
        out, new_events = session.poll(now_s)
        unit.feed(out, now_s)
        unit.advance(now_s)
        events += new_events
        while (frame := unit.next_frame(now_s)) is not None:
            events += session.feed(frame, now_s)
    return events


def test_the_hash_has_its_published_values() -> None:
    """XXH32 with seed 0 gives its published values."""
    assert (xxhash.xxh32_intdigest(b"", 0), xxhash.xxh32_intdigest(b"abc", 0)) == (0x02CC5D05, 0x32D153FF)


@pytest.mark.parametrize(
    ("name", "arguments", "wire"),
    [
        ("BOOT", {"region": 1}, "C0 21 03 01 01 9C 34 9A 61 C0"),
        ("REQUEST_SOLUTION", {}, "C0 21 02 18 AC 15 E1 76 C0"),
        ("REQUEST_CENTROIDS", {}, "C0 21 02 25 D5 B5 FF 2E C0"),
        ("READ_CAMERA", {}, "C0 21 01 09 5B 0D C8 DB DD C0"),
        ("SET_TIME", {"time_us": 1_700_000_000_250_000}, "C0 21 03 0E 90 10 22 18 24 0A 06 00 96 D9 E1 05 C0"),
        ("SET_SUBSCRIPTION", {"telemetry_1": 24, "telemetry_2": 27}, f"C0 21 00 12 18 1B {ZERO14} C6 B9 FE 6C C0"),
        ("SET_MOUNTING", {}, "C0 21 00 06 00 00 80 3F" + "00" * 12 + "AA F0 E6 35 C0"),
    ],
)
def test_requests_have_the_public_bytes(sagitta: Instrument, name: str, arguments: dict[str, Value], wire: str) -> None:
    """Requests equal the public bytes, also if a hash contains an escaped byte."""
    assert sent_by(open_session_of(sagitta), name, arguments) == bytes.fromhex(wire)


def test_the_public_reply_completes_the_request(sagitta: Instrument) -> None:
    """A reply with status 0 completes its request. The same reply without a request is counted as unknown."""
    session, reply = open_session_of(sagitta), bytes.fromhex("C0 21 80 06 00 8F BD 5E C2 C0")
    assert not [e for e in session.feed(reply, 0.0) if isinstance(e, CommandUpdate)]
    sent_by(session, "SET_MOUNTING", {})
    assert [e.stage for e in session.feed(reply, 0.1) if isinstance(e, CommandUpdate)] == [Stage.COMPLETED]
    assert session.counters.received.unknown == 1


def test_asynchronous_telemetry_is_read_with_its_time(sagitta: Instrument) -> None:
    """The packet's time is one little-endian number. A packet with a damaged hash is dropped and counted."""
    session = open_session_of(sagitta)
    packets = [e for e in session.feed(bytes.fromhex(ASYNCHRONOUS), 0.0) if isinstance(e, Telemetry)]
    assert packets[0].values == {"mcu_c": 26.0, "cmos_c": 24.0, "fpga_c": 25.0}
    assert (packets[0].device_time_s, packets[0].request_id) == (1_700_000_000.25, 0)
    damaged = bytearray(bytes.fromhex(ASYNCHRONOUS))
    damaged[20] ^= 1
    assert not session.feed(bytes(damaged), 0.1)
    assert session.counters.received.bad_crc == 1


def test_the_solution_has_its_published_size_and_flag_position(sagitta: Instrument) -> None:
    """The solution has 67 bytes of content in a packet of 87, with the flag at byte 77."""
    session, unit = open_session_of(sagitta), unit_of(sagitta, BOOTED)
    unit.feed(sent_by(session, "REQUEST_SOLUTION", {}), 1.0)
    frame = unit.next_frame(1.0)
    assert frame is not None
    packet = frame[1:-1].replace(b"\xdb\xdc", b"\xc0").replace(b"\xdb\xdd", b"\xdb")
    assert len(packet) == 3 + 13 + 67 + 4
    assert packet[77] == 1


def test_telemetry_begins_after_boot_and_has_the_attitude_of_the_motion(sagitta: Instrument) -> None:
    """In the bootloader the unit answers commands, and the ground's greeting at least every 3 s, but sends no telemetry.
    After BOOT it sends the attitude of the motion."""
    session, unit = open_session_of(sagitta), unit_of(sagitta)
    ping = session.submit(session.encode("PING", {"number": 7}))
    before = talk(session, unit, 0.0, 3.0)
    assert session.hello is not None
    greeted_s = session.counters.last_good_s
    assert greeted_s is not None
    assert greeted_s > 1.0
    assert not [e for e in before if isinstance(e, Telemetry)]
    ping_updates = [e for e in before if isinstance(e, CommandUpdate) and e.request_id == ping]
    assert (ping_updates[-1].stage, dict(ping_updates[-1].values)) == (Stage.COMPLETED, {"number": 7})
    session.submit(session.encode("BOOT", {}))
    after = [e for e in talk(session, unit, 3.0, 8.0) if isinstance(e, Telemetry)]
    assert {e.packet for e in after} == {"solution", "housekeeping"}
    solution = next(e for e in reversed(after) if e.packet == "solution")
    role = sagitta.roles.quantities.attitude
    standard = role.read(solution.values)
    quaternion = np.array([float(standard[f"quaternion_{axis}"]) for axis in "xyzw"])
    assert np.abs(matrix_from_quaternion(quaternion) - ATTITUDE).max() < 3e-4
    assert standard["outcome"] == "solved"


def test_every_parameter_is_read_back_as_it_was_set(sagitta: Instrument) -> None:
    """Each of the 17 parameters is read back with the values that were set."""
    session, unit = open_session_of(sagitta), unit_of(sagitta, BOOTED)
    names = [c.name.removeprefix("SET_") for c in sagitta.dictionary.commands if c.code < 64]
    assert len(names) == 17
    now_s = 0.0
    for name in names:
        command = sagitta.dictionary.command(f"SET_{name}")
        arguments: dict[str, Value] = {
            a.name: float(k) if a.type == "f32" else k + 1 for k, a in enumerate(command.arguments)
        }
        if name == "SUBSCRIPTION":
            arguments = {"telemetry_1": 24}
        session.submit(session.encode(command.name, arguments))
        session.submit(session.encode(f"READ_{name}", {}))
        events = talk(session, unit, now_s, 1.0)
        now_s += 1.0
        packets = [e for e in events if isinstance(e, Telemetry) and e.packet == f"parameter_{name.lower()}"]
        assert arguments.items() <= packets[-1].values.items(), name


def test_a_subscription_sends_without_requests(sagitta: Instrument) -> None:
    """A subscription sends matched stars with their catalogue numbers at least four times per second, without requests."""
    session, unit = open_session_of(sagitta), unit_of(sagitta, BOOTED)
    session.submit(session.encode("SET_SUBSCRIPTION", {"telemetry_1": 40, "telemetry_2": 37}))
    events = [e for e in talk(session, unit, 0.0, 3.0) if isinstance(e, Telemetry)]
    matches = [e for e in events if e.packet == "matches"]
    assert len(matches) >= 12
    assert all(e.request_id == 0 for e in matches)
    assert len({row["star"] for row in matches[-1].lists["items"]}) == 16
    assert all(abs(float(row["x_mm"])) < 2048 * 0.0055 / 2 for row in matches[-1].lists["items"])


def test_the_largest_time_is_accepted(sagitta: Instrument) -> None:
    """After SET_TIME with the largest number, the time of telemetry starts again at 0."""
    session, unit = open_session_of(sagitta), unit_of(sagitta, BOOTED)
    unit.feed(DelimitedFramer("slip").encode(packet(ACTION, SET_TIME, b"\xff" * 8)), 0.0)
    solutions = [e for e in talk(session, unit, 0.5, 3.0) if isinstance(e, Telemetry) and e.packet == "solution"]
    assert solutions
    assert 0 < solutions[0].device_time_s < 5


def test_errors_of_the_sensor_reject_the_command(sagitta: Instrument) -> None:
    """A reply with status 1 rejects the command as not implemented."""
    session, unit = open_session_of(sagitta), unit_of(sagitta, BOOTED)
    request_id = session.submit(session.encode("BOOT", {"region": 9}))
    stages = [e for e in talk(session, unit, 0.0, 1.0) if isinstance(e, CommandUpdate) and e.request_id == request_id]
    assert (stages[-1].stage, stages[-1].reason) == (Stage.REJECTED, "not_implemented")


@settings(deadline=None)
@given(st.lists(st.binary(max_size=60), max_size=8))
def test_no_bytes_make_either_end_fail(pieces: list[bytes]) -> None:
    """Random bytes cause no exception in driver or unit."""
    instrument = shipped_registry().get("sagitta")
    session, unit = open_session_of(instrument), unit_of(instrument)
    session.poll(0.0)
    for piece in pieces:
        session.feed(piece, 0.1)
        unit.feed(piece, 0.1)
    assert session.counters.received.bytes == sum(map(len, pieces))
