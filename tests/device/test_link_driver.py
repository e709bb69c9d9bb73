"""The driver ``link`` with protocols of ``link.yaml``, compared with public byte vectors of sensors of other makers."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.checksum import checksum_named
from gss.device.driver import UnitSetup, driver_named
from gss.device.exchange_session import ExchangeSession
from gss.device.link_driver import open_session
from gss.device.link_framing import CutFramer
from gss.device.session_events import CommandUpdate, HelloReceived, Stage, Telemetry
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.instruments.dictionary.read_dictionary import parse_dictionary
from gss.instruments.link_file import LinkFile

NSP = """
framing: slip
protocol:
  byte_order: little
  checksum: {name: CRC-16/MCRF4XX, byte_order: little}
  match: code
  request:
    header:
      - {name: destination, type: u8, value: 0x0E}
      - {name: source, type: u8, value: 0x11}
      - {name: control, type: u8, holds: code, mask: 0x1F, value: 0x80}
  response:
    header:
      - {name: destination, type: u8, value: 0x11}
      - {name: source, type: u8, value: 0x0E}
      - {name: control, type: u8, holds: code, mask: 0x1F}
  accepted: {field: control, mask: 0x20, equals: 0x20}
"""
NSP_DICTIONARY = """
version: 1
device_model: nsp-unit
commands:
  - {name: PING, code: 0, subsystem: unit, purpose: Check, idempotent: true, accept_s: 1, complete_s: 1,
     returns: [{name: text, type: rest}]}
  - {name: INIT, code: 1, subsystem: unit, purpose: Start a program, idempotent: false, accept_s: 1, complete_s: 1,
     arguments: [{name: address, type: u32, min: 0, max: 0xFFFFFFFF}]}
  - {name: GO, code: 0x0B, subsystem: unit, purpose: Run, idempotent: false, accept_s: 1, complete_s: 1,
     arguments: [{name: what, type: u8, min: 0, max: 255}], returns: [{name: what, type: u8}]}
telemetry: []
events: []
services: []
"""


def session_of(link: str, dictionary: str) -> ExchangeSession:
    """Return a session on an open line."""
    rules = LinkFile.model_validate(yaml.safe_load(link))
    session = open_session(UnitSetup(parse_dictionary(dictionary), rules, "unit"))
    session.link_up(0.0)
    return session


def stages(events: list[object]) -> list[Stage]:
    """Return the stages of all command updates, in order."""
    return [e.stage for e in events if isinstance(e, CommandUpdate)]


@pytest.mark.parametrize(
    ("name", "arguments", "wire"),
    [
        ("PING", {}, "C0 0E 11 80 69 21 C0"),
        ("INIT", {"address": 0x2000}, "C0 0E 11 81 00 20 00 00 1F 31 C0"),
        ("GO", {"what": 0x0B}, "C0 0E 11 8B 0B 9D A4 C0"),
    ],
)
def test_nsp_requests_have_the_public_bytes(name: str, arguments: dict[str, int], wire: str) -> None:
    """Requests have the bytes on which three independent public codecs agree."""
    session = session_of(NSP, NSP_DICTIONARY)
    session.submit(session.encode(name, arguments))
    assert session.poll(0.0)[0] == bytes.fromhex(wire)


def test_an_nsp_response_completes_its_request_and_a_refusal_rejects_it() -> None:
    """A response belongs to the request with its code. Its ACK bit decides between completed and rejected."""
    session = session_of(NSP, NSP_DICTIONARY)
    session.submit(session.encode("GO", {"what": 0x0B}))
    session.poll(0.0)
    events = session.feed(bytes.fromhex("C0 11 0E AB 0B A4 39 C0"), 0.1)
    assert stages(events)[-1] is Stage.COMPLETED
    assert any(isinstance(e, HelloReceived) for e in events)
    session.submit(session.encode("PING", {}))
    session.poll(0.2)
    rejection = session.feed(bytes.fromhex("C0 11 0E 80 62 F8 C0"), 0.3)
    assert stages(rejection)[-1] is Stage.REJECTED
    assert (
        next(e.reason for e in rejection if isinstance(e, CommandUpdate) and e.stage is Stage.REJECTED)
        == "control 0x80"
    )


@pytest.mark.parametrize("wire", ["C0 11 0E AB 0B 3D 82 C0", "C0 11 0E 80 48 0A C0"])
def test_a_ccitt_false_checksum_is_rejected(wire: str) -> None:
    """A response with the checksum CRC-16/IBM-3740 (CCITT-FALSE) is counted as damaged and completes no request."""
    session = session_of(NSP, NSP_DICTIONARY)
    session.submit(session.encode("GO", {"what": 0x0B}))
    session.poll(0.0)
    assert session.feed(bytes.fromhex(wire), 0.1) == []
    assert session.counters.received.bad_crc == 1


@pytest.mark.parametrize(
    ("name", "check"),
    [("CRC-16/MCRF4XX", 0x6F91), ("CRC-16/IBM-3740", 0x29B1), ("CRC-16/KERMIT", 0x2189), ("CRC-16/IBM-SDLC", 0x906E)],
)
def test_checksums_have_the_check_values_of_the_catalogue(name: str, check: int) -> None:
    """Each checksum of the digits 1 to 9 equals the check value of the CRC catalogue."""
    calculate, size = checksum_named(name)
    assert (calculate(b"123456789"), size) == (check, 2)


def test_an_unknown_checksum_is_rejected() -> None:
    """An unknown checksum name is rejected."""
    for name in ("CRC-16/NOPE", "MD5", "CRC-12/DECT"):
        with pytest.raises(BadInput, match=r"checksum"):
            checksum_named(name)


PREFIXED = """
framing: length_prefixed
protocol:
  sync: "A5 5A"
  match: request_id
  payload_byte_order: little
  request:
    header:
      - {name: length, type: u16, holds: length, add: 2}
      - {name: id, type: u16, holds: request_id, mask: 0xFFFF}
      - {name: code, type: u8, holds: code}
  response:
    header:
      - {name: length, type: u16, holds: length, add: 2}
      - {name: id, type: u16, holds: request_id, mask: 0xFFFF}
      - {name: code, type: u8, holds: code}
  answers: {GET: state}
"""
PREFIXED_DICTIONARY = """
version: 1
device_model: x
commands:
  - {name: GET, code: 7, subsystem: s, purpose: p, idempotent: true, accept_s: 1, complete_s: 1}
telemetry:
  - {name: state, code: 9, purpose: p, stale_after_s: 5, fields: [{name: number, type: u16}]}
events: []
services: []
"""


def test_a_length_in_the_header_delimits_packets_and_the_id_finds_the_request() -> None:
    """A packet with another id and a telemetry code is unsolicited telemetry. Noise before the sync bytes is skipped and
    counted. Without a clock of the sensor, the device time is 0."""
    session = session_of(PREFIXED, PREFIXED_DICTIONARY)
    session.submit(session.encode("GET", {}))
    assert session.poll(0.0)[0] == bytes.fromhex("A55A 0007 0001 07")
    unsolicited = session.feed(bytes.fromhex("FF A5 A55A 0009 0063 09 0100"), 0.1)
    assert [(e.request_id, e.device_time_s) for e in unsolicited if isinstance(e, Telemetry)] == [(0, 0.0)]
    assert not stages(unsolicited)
    response = session.feed(bytes.fromhex("A55A 0009 0001 07 3412 A55A"), 0.2)
    assert [e.values["number"] for e in response if isinstance(e, Telemetry)] == [0x1234]
    assert stages(response) == [Stage.COMPLETED]
    assert session.counters.received.unframed == 2


@pytest.mark.parametrize(("kind", "last"), [("u8", 0xFF), ("u16", 0xFFFF)])
def test_request_numbers_continue_after_the_largest_number_of_their_field(kind: str, last: int) -> None:
    """If the request number exceeds its header field, the response with its lower bits completes the request."""
    link = PREFIXED.replace("type: u16, holds: request_id, mask: 0xFFFF", f"type: {kind}, holds: request_id")
    session = session_of(link, PREFIXED_DICTIONARY)
    session.restore(last, [])
    for now_s in (0.0, 1.0):
        session.submit(session.encode("GET", {}))
        request = session.poll(now_s)[0]
        response = request[:3] + bytes([request[3] + 2]) + request[4:] + b"\x34\x12"
        assert stages(session.feed(response, now_s))[-1] is Stage.COMPLETED


@pytest.mark.parametrize("noise", [b"", b"\x00", b"\x00\x1a\xcf\xfc"])
@pytest.mark.parametrize("sync", [b"\x1b", b"\x1a\x1b", b"\x1a\xcf\x1d", b"\x1a\xcf\xfc\x1d"])
def test_no_packet_is_lost_if_a_read_ends_inside_its_sync_mark(sync: bytes, noise: bytes) -> None:
    """Two reads that split noise and two packets at any byte return both packets; only the noise is counted as unframed."""
    packet = b"12345678"
    stream = noise + sync + packet + sync + packet
    for split in range(len(stream) + 1):
        framer = CutFramer(sync, b"", None, "big")
        packets = []
        for data in (stream[:split], stream[split:], b""):
            packets += framer.feed(data, (len(packet),))
        assert (packets, framer.unframed) == ([packet, packet], len(noise)), split


def test_a_request_without_response_is_unknown_and_the_next_one_is_sent() -> None:
    """A request without response is unknown after its timeout, and the next one is sent. No request is repeated
    automatically."""
    session = session_of(NSP, NSP_DICTIONARY)
    first = session.submit(session.encode("PING", {}))
    second = session.submit(session.encode("PING", {}))
    assert session.poll(0.0)[0]
    out, events = session.poll(1.5)
    updates = [e for e in events if isinstance(e, CommandUpdate)]
    assert (updates[0].request_id, updates[0].stage) == (first, Stage.UNKNOWN)
    assert out
    assert [e.request_id for e in updates if e.stage is Stage.SENT] == [second]
    session.retry(first, 2.0)
    assert stages(session.link_lost(2.0)) == [Stage.QUEUED, Stage.UNKNOWN]


@pytest.mark.parametrize(("late", "sent_s"), [(True, 1.3), (False, 2.2)])
def test_a_late_response_is_not_assigned_to_the_next_request(late: bool, sent_s: float) -> None:
    """If only the order assigns responses, the next request waits after a timeout for the late response or for the
    timeout again."""
    session = session_of(NSP.replace("match: code", "match: order"), NSP_DICTIONARY)
    session.submit(session.encode("PING", {}))
    session.submit(session.encode("GO", {"what": 0x0B}))
    assert session.poll(0.0)[0]
    out, events = session.poll(1.1)
    assert (out, stages(events)[-1]) == (b"", Stage.UNKNOWN)
    if late:
        assert stages(session.feed(bytes.fromhex("C0 11 0E 80 62 F8 C0"), 1.2)) == []
    assert [bool(session.poll(now_s)[0]) for now_s in (sent_s - 0.15, sent_s)] == [False, True]
    assert stages(session.feed(bytes.fromhex("C0 11 0E AB 0B A4 39 C0"), 2.5))[-1] is Stage.COMPLETED


@settings(deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=12), st.booleans())
def test_no_bytes_make_the_session_fail(pieces: list[bytes], pending: bool) -> None:
    """Random bytes cause no exception and are counted, with and without a pending request."""
    for link, dictionary, name in ((NSP, NSP_DICTIONARY, "PING"), (PREFIXED, PREFIXED_DICTIONARY, "GET")):
        session = session_of(link, dictionary)
        if pending:
            session.submit(session.encode(name, {}))
            session.poll(0.0)
        for k, piece in enumerate(pieces):
            session.feed(piece, 0.01 * k)
        assert session.counters.received.bytes == sum(map(len, pieces))


def test_abort_and_transfers_are_rejected_if_the_sensor_lacks_them() -> None:
    """ABORT and transfers are rejected with a sentence if the sensor has none."""
    session = session_of(NSP, NSP_DICTIONARY)
    with pytest.raises(Conflict, match="no command to abort"):
        session.abort(0.0)
    with pytest.raises(Conflict, match="cannot send content"):
        session.transfers.start_download("frame", 0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("match: code", "match: request_id"), "request_id"),
        (("framing: slip", "framing: sync_and_trailer"), "trailer"),
        (("field: control", "field: status"), "status"),
        (("type: u8, value: 0x0E", "type: u9, value: 0x0E"), "type"),
    ],
)
def test_an_invalid_link_file_is_rejected_with_its_reason(change: tuple[str, str], reason: str) -> None:
    """An invalid link file is rejected with the reason when it is read."""
    with pytest.raises(ValueError, match=reason):
        LinkFile.model_validate(yaml.safe_load(NSP.replace(*change)))


def test_names_that_the_dictionary_lacks_are_rejected() -> None:
    """A packet name in ``answers`` that is not in the dictionary is rejected with the file's name."""
    with pytest.raises(BadInput, match=r"link\.yaml"):
        session_of(PREFIXED.replace("GET: state", "GET: nothing"), PREFIXED_DICTIONARY)


@pytest.mark.parametrize("framing", ["sync_and_trailer", "none"])
def test_a_packet_that_the_framing_cannot_delimit_is_rejected(framing: str) -> None:
    """Between marks and without a length in the header, a packet of variable size is rejected with its name."""
    link = NSP.replace("framing: slip", f"framing: {framing}").replace(
        "match:", 'sync: "A5"\n  trailer: "5A"\n  match:'
    )
    fixed = NSP_DICTIONARY.replace(",\n     returns: [{name: text, type: rest}]", "")
    assert session_of(link, fixed)
    with pytest.raises(BadInput, match=r"link\.yaml.*fixed size.*got PING of variable size"):
        session_of(link, NSP_DICTIONARY)


def test_drivers_are_found_by_name() -> None:
    """A driver is found by its name. The error for an unknown name lists the installed drivers."""
    assert driver_named("link") is open_session
    with pytest.raises(NotFound) as error:
        driver_named("none")
    assert "gss" in error.value.expected
