"""NOS3's generic star tracker: package without code and simulated unit, compared with public byte vectors."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from gss.device.driver import Driver, open_driver
from gss.device.session_events import CommandUpdate, SessionEvent, Stage, Telemetry
from gss.device.simulator.environment import Environment
from gss.device.simulator.nos3 import BURSTS, DISABLED, README, TEST_PATTERN, Nos3Unit, open_unit
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.other_makers import UnitWorld, make_unit
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.instruments.package import Instrument, load_instrument
from gss.instruments.registry import shipped_registry

ATTITUDE = cam_from_icrs(*np.radians([84.0, 5.0, 30.0]))


@pytest.fixture
def nos3() -> Instrument:
    """The shipped package."""
    return shipped_registry().get("nos3")


def unit_of(instrument: Instrument, *dialects: str, rate_rad_s: float = 0.0) -> Nos3Unit:
    """Return a simulated unit that points to ``ATTITUDE`` and rotates with this rate."""
    motion = Inertial(ATTITUDE, np.array([0.0, rate_rad_s, 0.0]))
    return open_unit(UnitWorld(instrument, Environment(instrument.profile, motion), 1, frozenset(dialects)))


def answer(unit: Nos3Unit, request: str, now_s: float = 0.0) -> str:
    """Return the unit's response to these bytes, in hexadecimal."""
    unit.feed(bytes.fromhex(request), now_s)
    frames = b""
    while (frame := unit.next_frame(now_s)) is not None:
        frames += frame
    return frames.hex(" ").upper()


def talk(session: Driver, unit: Nos3Unit, until_s: float) -> list[SessionEvent]:
    """Run both ends in memory. Return the host's events."""
    events: list[SessionEvent] = []
    for k in range(int(until_s * 100)):
        out, new_events = session.poll(0.01 * k)
        unit.feed(out, 0.01 * k)
        events += new_events
        while (frame := unit.next_frame(0.01 * k)) is not None:
            events += session.feed(frame, 0.01 * k)
    return events


NOOP = "DE AD 00 00 00 00 00 BE EF"
HOUSEKEEPING = "DE AD 01 00 00 00 00 BE EF"
DATA = "DE AD 02 00 00 00 00 BE EF"


def test_the_unit_answers_with_the_public_bytes(nos3: Instrument) -> None:
    """Each response starts with an echo. The counter is 1 in the first housekeeping packet and increases by 2 per
    request."""
    unit = unit_of(nos3)
    assert answer(unit, HOUSEKEEPING) == f"{HOUSEKEEPING} DE AD 00 00 00 01 BE EF"
    assert answer(unit, HOUSEKEEPING) == f"{HOUSEKEEPING} DE AD 00 00 00 03 BE EF"
    assert answer(unit, NOOP) == NOOP
    assert answer(unit, HOUSEKEEPING) == f"{HOUSEKEEPING} DE AD 00 00 00 07 BE EF"


def test_unknown_opcodes_count_once_and_damaged_requests_do_not(nos3: Instrument) -> None:
    """Unknown opcodes increase the counter by one, damaged requests do not. Neither has a response."""
    unit = unit_of(nos3)
    assert answer(unit, "DE AD 03 00 00 00 00 BE EF") == ""
    assert answer(unit, "DE AD 01 00 00 00 00 BE EE") == ""
    assert answer(unit, "DE AC 01 00 00 00 00 BE EF") == ""
    assert answer(unit, HOUSEKEEPING) == f"{HOUSEKEEPING} DE AD 00 00 00 02 BE EF"


def test_the_test_pattern_is_that_of_the_provider(nos3: Instrument) -> None:
    """The first response has 0.001, 0.002, 0.003 and 0.004, scaled and truncated."""
    assert answer(unit_of(nos3, TEST_PATTERN), DATA) == f"{DATA} DE AD 80 20 80 41 80 62 80 83 01 BE EF"


def test_dialects_change_the_behaviour_that_they_name(nos3: Instrument) -> None:
    """A disabled unit is silent, the burst dialect drops two requests in one write, and the README dialect has longer
    responses. An unknown dialect is rejected."""
    assert answer(unit_of(nos3, DISABLED), HOUSEKEEPING) == ""
    assert answer(unit_of(nos3, BURSTS), NOOP + NOOP) == ""
    assert answer(unit_of(nos3), NOOP + NOOP) == f"{NOOP} {NOOP}"
    assert len(bytes.fromhex(answer(unit_of(nos3, README), NOOP))) == 9 + 16
    assert len(bytes.fromhex(answer(unit_of(nos3, README), HOUSEKEEPING))) == 9 + 17
    with pytest.raises(BadInput, match="no such dialect"):
        unit_of(nos3, "nonsense")


def test_the_package_sends_the_public_requests(nos3: Instrument) -> None:
    """The requests of the package equal the public byte vectors."""
    session = open_driver(nos3)
    session.link_up(0.0)
    for name, wire in (("NOOP", NOOP), ("REQUEST_HOUSEKEEPING", HOUSEKEEPING), ("REQUEST_DATA", DATA)):
        session.submit(session.encode(name, {}))
        sent, _ = session.poll(0.0)
        assert sent == bytes.fromhex(wire)
        session.feed(sent, 0.0)
        session.feed(bytes.fromhex("DE AD 00 00 00 01 BE EF DE AD 80 00 80 00 80 00 FF FF 01 BE EF"), 0.0)
        session.link_up(0.0)


@pytest.mark.parametrize(
    ("wire", "expected"),
    [
        ("DE AD 80 00 80 00 80 00 FF FF 01 BE EF", (0.0, 0.0, 0.0, 1.0)),
        ("DE AD BF FF 40 00 BF FF BF FF 01 BE EF", (0.49998474, -0.50001526, 0.49998474, 0.49998474)),
    ],
)
def test_the_package_decodes_the_public_quaternions(nos3: Instrument, wire: str, expected: tuple[float, ...]) -> None:
    """The public quaternions are decoded with the vector part first and the scalar last."""
    packets = [e for e in _data_reply(nos3, wire) if isinstance(e, Telemetry)]
    assert [packets[0].values[f"q{k}"] for k in range(4)] == pytest.approx(expected, abs=1e-8)
    assert packets[0].values["valid"] == "solved"


@pytest.mark.parametrize("wire", ["DE AD 00 00 80 00 80 00 FF FF 01 BE EF", "DE AD 80 00 80 00 80 00 FF FF 02 BE EF"])
def test_impossible_values_are_dropped(nos3: Instrument, wire: str) -> None:
    """A packet with raw 0000, which is −1.00003, or a flag above 1 gives no telemetry and completes no request."""
    session_events = _data_reply(nos3, wire)
    assert not [e for e in session_events if isinstance(e, Telemetry)]
    assert not [e for e in session_events if isinstance(e, CommandUpdate) and e.stage is Stage.COMPLETED]


def _data_reply(nos3: Instrument, wire: str) -> list[SessionEvent]:
    session = open_driver(nos3)
    session.link_up(0.0)
    session.submit(session.encode("REQUEST_DATA", {}))
    sent, _ = session.poll(0.0)
    return session.feed(sent + bytes.fromhex(wire), 0.0)


def test_a_wrong_echo_completes_nothing(nos3: Instrument) -> None:
    """A response with a wrong echo is ignored. The request times out as unknown."""
    session = open_driver(nos3)
    session.link_up(0.0)
    session.submit(session.encode("NOOP", {}))
    session.poll(0.0)
    assert not session.feed(bytes.fromhex("DE AD 00 00 00 00 01 BE EF"), 0.1)
    stages = [e.stage for e in session.poll(0.6)[1] if isinstance(e, CommandUpdate)]
    assert stages == [Stage.UNKNOWN]


def test_the_ground_repeats_both_requests_and_gets_the_attitude(nos3: Instrument) -> None:
    """A command completes between the repeated requests. The polled attitude is that of the motion, within noise and
    resolution."""
    session, unit = open_driver(nos3), unit_of(nos3)
    session.link_up(0.0)
    request_id = session.submit(session.encode("REQUEST_DATA", {}))
    events = talk(session, unit, 5.0)
    assert [e.stage for e in events if isinstance(e, CommandUpdate) and e.request_id == request_id][
        -1
    ] is Stage.COMPLETED
    polled = [e for e in events if isinstance(e, Telemetry) and e.packet == "attitude" and not e.request_id]
    assert len(polled) == 5
    role = nos3.roles.quantities.attitude
    x, y, z, w = role.quaternion_of({name: float(polled[-1].values[name]) for name in role.quaternion})
    matrix = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)]])
    assert np.abs(matrix[0] - ATTITUDE[0]).max() < 3e-4
    assert session.housekeeping is not None
    assert session.counters.received.bad == session.counters.received.unknown == 0


def test_a_fast_unit_repeats_its_last_values_as_invalid(nos3: Instrument) -> None:
    """Repeated values look valid and are marked only by the validity flag."""
    session, unit = open_driver(nos3), unit_of(nos3, rate_rad_s=0.1)
    session.link_up(0.0)
    packets = [e for e in talk(session, unit, 3.0) if isinstance(e, Telemetry) and e.packet == "attitude"]
    assert {e.values["valid"] for e in packets} == {"none"}


def test_the_longer_responses_of_the_readme_need_only_other_data(nos3: Instrument) -> None:
    """A package with the README's numbers and fields decodes the README's responses. The shipped package does not."""
    files = dict(nos3.files)
    text = files["dictionary.yaml"].decode()
    text = text.replace("code: 1\n    subsystem", "code: 0\n    subsystem").replace(
        "name: NOOP\n    code: 0", "name: CONFIGURE\n    code: 2"
    )
    text = text.replace("name: REQUEST_DATA\n    code: 2", "name: REQUEST_DATA\n    code: 1")
    counter = "      - {name: counter, type: u32, title: Requests, page: processor}\n"
    text = text.replace(
        counter, counter + "".join(f"      - {{name: {n}, type: u32}}\n" for n in ("setting", "status"))
    )
    files["dictionary.yaml"] = text.encode()
    files["instrument.yaml"] = files["instrument.yaml"].replace(b"id: nos3", b"id: readme")
    files["operations.yaml"] = files["operations.yaml"].replace(
        b"hello: {command: NOOP}", b"hello: {command: CONFIGURE}"
    )
    readme = load_instrument(files)
    unit = unit_of(nos3, README)
    for instrument, works in ((readme, True), (nos3, False)):
        session = open_driver(instrument)
        session.link_up(0.0)
        events = talk(session, unit, 2.0)
        assert any(isinstance(e, Telemetry) and e.packet == "housekeeping" for e in events) is works


def test_an_unknown_simulator_is_rejected(nos3: Instrument) -> None:
    """An unknown simulator name is rejected."""
    environment = Environment(nos3.profile, Inertial(ATTITUDE, np.zeros(3)))
    with pytest.raises(NotFound, match="unknown simulator"):
        make_unit("none", nos3, environment, argparse.Namespace(seed=1, dialect=[]))
