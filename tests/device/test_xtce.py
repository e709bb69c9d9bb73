"""The XTCE document is valid by the standard's schema, and an independent parser decodes the same values with it."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree
from space_packet_parser.xtce.definitions import XtcePacketDefinition
from space_packet_parser.xtce.validation import validate_xtce

from gss.device.protocol.codec import LITTLE, decode, encode, encode_command, fixed_bytes
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import Deframer, decode_packet
from gss.device.protocol.sender import encode_packet
from gss.device.session_events import Stage
from gss.device.xtce import xtce, xtce_of
from gss.instruments.dictionary.checked_values import F32_MAX
from gss.instruments.dictionary.definitions import INTEGER_RANGES, Group, Item, Layout, Value
from gss.instruments.dictionary.definitions import PacketDefinition as PacketRow
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.registry import shipped_registry

if TYPE_CHECKING:
    from conftest import Bench

DICTIONARY = load_dictionary()


@lru_cache(maxsize=1)
def parser() -> XtcePacketDefinition:
    return XtcePacketDefinition.from_xtce(io.BytesIO(xtce(DICTIONARY).encode()))


@pytest.mark.parametrize(
    ("name", "repeat_lists"), [("cubestar", False), ("cubestar", True), ("nos3", False), ("sagitta", False)]
)
def test_the_document_is_valid_xtce(name: str, repeat_lists: bool) -> None:
    """The document is valid by the schema of XTCE 1.2, and all references within its telemetry exist.

    Commands are excluded from the check of references, because the parser does not support that the container of a
    command is the base of another one.
    """
    text = xtce_of(shipped_registry().get(name), repeat_lists=repeat_lists)
    root = etree.fromstring(text.encode())
    tree = etree.ElementTree(root)
    assert validate_xtce(tree, level="schema", print_results=False, allow_schema_download=False)
    commands = root.find("{*}CommandMetaData")
    assert len(commands.findall(".//{*}MetaCommand[@abstract='true']")) == (name == "cubestar")
    root.remove(commands)
    assert validate_xtce(tree, level="structure", print_results=False, allow_schema_download=False)


def test_the_container_of_a_command_is_its_packet() -> None:
    """The container of a command has the fixed header bytes, then the arguments and the checksum, as in the sent packet."""
    space = {"x": "http://www.omg.org/spec/XTCE/20180204"}
    root = etree.fromstring(xtce(DICTIONARY).encode())
    header = root.find(".//x:CommandContainer[@name='GSSCommand']/x:EntryList", space)
    fixed = {e.get("name"): e.get("binaryValue") for e in header if e.get("binaryValue")}
    command = encode_command(DICTIONARY.command("SET_MODE"), {"mode": "standby"})
    sent = Packet(PacketType.COMMAND, command.command.code, 9, command.payload, DICTIONARY.prefix, True)
    data = encode_packet(sent)
    assert data[:2].hex().upper() == fixed["Version_type_flag_APID"]
    assert data[6:7].hex().upper() == fixed["PACKET_TYPE"]
    assert data[8:10].hex().upper() == fixed["DICTIONARY"]
    assigned = root.find(".//x:MetaCommand[@name='SET_MODE']//x:ArgumentAssignment", space)
    assert (assigned.get("argumentName"), int(assigned.get("argumentValue"))) == ("CODE", data[7])
    entries = root.findall(".//x:CommandContainer[@name='SET_MODE']/x:EntryList/*", space)
    assert [e.get("argumentRef") or e.get("parameterRef") for e in entries] == ["mode", "CRC32"]


def test_another_parser_reads_a_little_endian_sensor() -> None:
    """The parser decodes the content of a packet of a sensor with another driver, in the byte order of its line."""
    sagitta = shipped_registry().get("sagitta")
    theirs = XtcePacketDefinition.from_xtce(io.BytesIO(xtce_of(sagitta).encode()))
    row = next(p for p in sagitta.dictionary.telemetry if any(isinstance(f, Group) and f.slots for f in p.fields))
    values: dict[str, Value] = {f.name: 1 + 3 * k for k, f in enumerate(row.values)}
    group = next(f for f in row.fields if isinstance(f, Group))
    rows = [{item.name: k for item in group.items} for k in range(2)]
    payload = encode(row.fields, values, {group.name: rows}, LITTLE)
    parsed = theirs.parse_bytes(payload, root_container_name=row.name)
    assert {f.name: parsed[f"{row.name}_{f.name}"] for f in row.values} == values
    assert parsed[f"{row.name}_{group.name}_count"] == 2
    assert len(parsed[f"{row.name}_{group.name}"]) == group.slots * fixed_bytes(group.items)


def test_every_parameter_that_a_headerless_document_names_is_defined() -> None:
    """Without the headers of the driver gss, the size of a value of the type rest refers to a defined parameter."""
    command = replace(DICTIONARY.command("GET_STATUS"), returns=(Item("content", "rest"),), preconditions=())
    root = ET.fromstring(  # noqa: S314 - generated document
        xtce(replace(DICTIONARY, commands=(command,), telemetry=(), events=(), services=()), headers=False)
    )
    named = {e.get("parameterRef") for e in root.iter() if e.get("parameterRef")}
    assert {"GET_STATUS_content", "PKT_LEN"} <= named
    assert named <= {e.get("name") for e in root.iter("{http://www.omg.org/spec/XTCE/20180204}Parameter")}


def test_repeated_rows_name_their_count() -> None:
    """In the standard form, a list is a container that is repeated by the count before it."""
    root = ET.fromstring(xtce(DICTIONARY, repeat_lists=True))  # noqa: S314 - generated document
    space = {"x": "http://www.omg.org/spec/XTCE/20180204"}
    repeated = root.findall(".//x:SequenceContainer[@name='matches']/x:EntryList/x:ContainerRefEntry", space)
    assert [e.get("containerRef") for e in repeated] == ["matches_items_row"]
    count = repeated[0].find(".//x:ParameterInstanceRef", space)
    assert count is not None
    assert count.get("parameterRef") == "matches_items_count"


def is_equal(ours: Value, theirs: Any) -> bool:
    """True if both values are equal. NaN equals itself; numbers may differ by the rounding of a polynomial."""
    if isinstance(ours, float) and not isinstance(theirs, str | bytes):
        return (math.isnan(ours) and math.isnan(theirs)) or math.isclose(ours, theirs, rel_tol=1e-12, abs_tol=1e-12)
    return bool(theirs == ours)


def assert_same_layout(owner: str, layout: Layout, payload: bytes, parsed: Any) -> int:
    """Compare raw and engineering values of a payload with those of the other parser. Return the number of values."""
    ours, compared = decode(layout, payload), 0
    for entry in layout:
        name = f"{owner}_{entry.name}"
        theirs = parsed[name]
        if isinstance(entry, Group):
            compared += assert_same_rows(name, entry, ours.lists[entry.name], parsed)
            continue
        assert is_equal(ours.values[entry.name], theirs), (name, ours.values[entry.name], theirs)
        if entry.type not in ("str", "text"):
            assert is_equal(ours.raw[entry.name], theirs.raw_value), (name, ours.raw[entry.name], theirs.raw_value)
        compared += 1
    return compared


def assert_same_rows(name: str, group: Group, rows: Iterable[dict[str, Value]], parsed: Any) -> int:
    """Compare each row of a list, decoded with the container of the row."""
    rows, data = list(rows), bytes(parsed[name])
    assert parsed[f"{name}_count"] == len(rows)
    size = len(data) // len(rows) if rows else 0
    assert size * len(rows) == len(data)
    for i, row in enumerate(rows):
        theirs = parser().parse_bytes(data[i * size : (i + 1) * size], root_container_name=f"{name}_row")
        for item in group.items:
            assert is_equal(row[item.name], theirs[f"{name}_row_{item.name}"]), (name, i, item.name)
    return len(rows) * len(group.items)


def assert_same_packet(packet: Packet) -> int:
    """Compare a packet of the device as decoded by both parsers. Return the number of compared values."""
    parsed = parser().parse_bytes(encode_packet(packet))
    assert parsed["CODE"] == packet.code
    assert parsed["REQUEST_ID"] == packet.request_id
    assert parsed["SRC_SEQ_CTR"] == packet.sequence
    assert parsed["DICTIONARY"] == packet.prefix
    assert math.isclose(parsed["DEVICE_TIME_S"] + parsed["DEVICE_TIME_MS"] / 1000, packet.time_s, abs_tol=1e-9)
    if packet.type is PacketType.TELEMETRY:
        row = DICTIONARY.packet_of_code(packet.code)
        assert row is not None
        return assert_same_layout(row.name, row.fields, packet.payload, parsed)
    if packet.type is PacketType.REPORT:
        command, common = DICTIONARY.command_of_code(packet.code), DICTIONARY.service("REPORT").fields
        returned = command.returns if command is not None and packet.payload[0] == 5 else ()
        values = decode((*common, *returned), packet.payload).values
        named = [("REPORT", f.name) for f in common] + [(command.name, r.name) for r in returned if command]
        assert all(is_equal(values[name], parsed[f"{owner}_{name}"]) for owner, name in named)
        return len(named)
    service = DICTIONARY.service_of_code(packet.type.name.lower(), packet.code) or DICTIONARY.service("EVENT")
    return assert_same_layout(service.name, service.fields, packet.payload, parsed)


def values_of(item: Item) -> st.SearchStrategy[Value]:
    """Return a strategy for any value of the type."""
    if item.type in INTEGER_RANGES:
        return st.integers(*INTEGER_RANGES[item.type])
    if item.type == "enum":
        return st.sampled_from([c.name for c in item.choices])
    if item.type == "f32":
        return st.floats(-F32_MAX, F32_MAX, width=32) | st.just(math.nan)
    if item.type == "f64":
        return st.floats(allow_nan=True, allow_infinity=True)
    if item.type == "bytes":
        return st.binary(min_size=item.size, max_size=item.size)
    if item.type in ("str", "text"):
        # The last byte of a text of fixed length is always zero.
        room = item.size - 1 if item.type == "str" else 255
        letters = st.characters(exclude_categories=("Cs",), exclude_characters="\0")
        return st.text(letters, max_size=room // 4)
    return st.booleans()


@st.composite
def telemetry(draw: st.DrawFn, row: PacketRow) -> Packet:
    """Return a strategy for telemetry packets with any values."""
    values = {f.name: draw(values_of(f)) for f in row.values}
    groups = [f for f in row.fields if isinstance(f, Group)]
    items = {g.name: st.fixed_dictionaries({i.name: values_of(i) for i in g.items}) for g in groups}
    lists = {name: draw(st.lists(rows, max_size=20)) for name, rows in items.items()}
    payload = encode(row.fields, values, lists)
    return Packet(PacketType.TELEMETRY, row.code, 7, payload, DICTIONARY.prefix, False, 11, 3661.25)


@pytest.mark.parametrize("name", [p.name for p in DICTIONARY.telemetry])
def test_another_parser_reads_every_telemetry_packet_to_the_same_values(name: str) -> None:
    """Both parsers decode equal raw and engineering values over the complete range of every field."""
    row = DICTIONARY.packet(name)

    @settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @given(telemetry(row))
    def holds(packet: Packet) -> None:
        assert assert_same_packet(packet) >= len(row.values)

    holds()


def recorded(bench: Bench) -> list[Packet]:
    """Return all packets of a contact with every kind of message, as received from the line."""
    stream = bytearray()
    feed: Callable[[bytes, float], Any] = bench.host.feed

    def listen(data: bytes, now_s: float) -> Any:
        stream.extend(data)
        return feed(data, now_s)

    bench.host.feed = listen  # type: ignore[method-assign]
    bench.do("SET_MODE", mode="standby")
    assert bench.do("RUN_ITERATION").stage is Stage.REJECTED
    bench.do("SET_MODE", mode="lost_in_space")
    bench.do("SET_TIME", utc_s=1_700_000_000.0)
    bench.do("SET_ORBIT")
    bench.do("SCHEDULE", at_s=1.0e6, command_code=34)
    bench.do("LIST_TABLES")
    bench.do("READ_MEMORY", area="flash", address=0, length=64)
    assert bench.do("RUN_ITERATION").values["outcome"] == "solved"
    for name in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE", "TAKE_IMAGE", "LIST_FRAMES", "LIST_BANKS"):
        bench.do(name, **({"slot": 1} if name == "TAKE_IMAGE" else {}))
    bench.do("VERIFY_BANK", bank="golden")
    transfer_id = bench.host.transfers.start_download("thumbnail", 0)
    bench.transfer_ends(transfer_id, "verified")
    bench.host.transfers.start_download("thumbnail", 3)
    bench.host.abort(bench.now_s)
    bench.run(1.5)
    packets = [decode_packet(frame) for frame in Deframer().feed(b"\0" + bytes(stream))]
    return [p for p in packets if isinstance(p, Packet)]


def test_another_parser_reads_a_recorded_contact_to_the_same_values(bench: Bench) -> None:
    """The other parser decodes all telemetry, events, reports and transfer messages of a contact to equal values."""
    packets = recorded(bench)
    kinds = {p.type for p in packets}
    assert kinds == {PacketType.REPORT, PacketType.TELEMETRY, PacketType.EVENT, PacketType.TRANSFER}
    seen = {p.code for p in packets if p.type is PacketType.TELEMETRY}
    assert seen == {p.code for p in DICTIONARY.telemetry}
    assert sum(assert_same_packet(p) for p in packets) > 500
