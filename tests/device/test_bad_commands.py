"""The device rejects commands that a correct ground never sends: arguments out of range, wrong lengths and modes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from gss.device.protocol.codec import STRUCT, decode, encode_item, fixed_bytes
from gss.device.protocol.framing import MAX_PACKET_BYTES
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.instruments.dictionary.definitions import FLOATS, INTEGER_RANGES, Argument, CommandDefinition
from gss.instruments.dictionary.read_dictionary import load_dictionary

if TYPE_CHECKING:
    from conftest import Bench

DICTIONARY = load_dictionary()
FIELDS = DICTIONARY.service("REPORT").fields


def plain(argument: Argument) -> bytes:
    """Return the encoded default of an argument, or its lowest value."""
    value = argument.default if argument.default is not None else argument.minimum
    if argument.type == "bytes":
        return bytes(argument.size)
    return encode_item(argument, 0 if value is None else value)


def beyond(argument: Argument) -> list[float]:
    """Return values just outside the range that the type can encode."""
    if argument.choices:
        return [max(c.value for c in argument.choices) + 1, 255]
    if argument.minimum is None or argument.maximum is None:
        return []
    if argument.type in FLOATS:
        step = max(1e-3, abs(argument.minimum) * 1e-6), max(1e-3, abs(argument.maximum) * 1e-6)
        return [argument.minimum - step[0], argument.maximum + step[1], math.nan, math.inf, -math.inf]
    low, high = INTEGER_RANGES[argument.type]
    return [int(v) for v in (argument.minimum - 1, argument.maximum + 1) if low <= v <= high]


OUTSIDE = [(c, a, value) for c in DICTIONARY.commands for a in c.arguments for value in beyond(a)]


def answer(bench: Bench, code: int, payload: bytes, request_id: int | None = None) -> tuple[str, str]:
    """Send a command packet with any payload. Return stage and reason of the first report."""
    packet_id, frame = bench.host.craft(PacketType.COMMAND, code, payload, request_id=request_id)
    while bench.device.next_frame(bench.now_s) is not None:
        pass
    bench.device.feed(frame, bench.now_s)
    receiver = LineReceiver(from_device=True)
    packets: list[Packet] = []
    while (sent := bench.device.next_frame(bench.now_s)) is not None:
        packets += receiver.feed(sent)
    reports = [p for p in packets if p.type is PacketType.REPORT and p.request_id == packet_id]
    values = decode(FIELDS, reports[0].payload).values
    return str(values["stage"]), str(values["reason"])


def test_every_bounded_argument_has_a_value_outside_its_range() -> None:
    """The list of values covers every argument whose range is narrower than its type."""
    tested = {(c.name, a.name) for c, a, _ in OUTSIDE}
    all_arguments = {(c.name, a.name) for c in DICTIONARY.commands for a in c.arguments}
    unbounded = {
        (c.name, a.name)
        for c in DICTIONARY.commands
        for a in c.arguments
        if a.type == "bytes" or (a.minimum, a.maximum) == INTEGER_RANGES.get(a.type)
    }
    assert tested == all_arguments - unbounded
    assert len(OUTSIDE) > 150


@pytest.mark.parametrize(
    ("command", "argument", "value"), OUTSIDE, ids=[f"{c.name}.{a.name}={v:g}" for c, a, v in OUTSIDE]
)
def test_a_value_out_of_range_is_rejected_and_changes_nothing(
    bench_unit: Bench, command: CommandDefinition, argument: Argument, value: float
) -> None:
    """min − 1, max + 1, NaN and infinity are rejected in otherwise valid packets that bypass the ground's checks."""
    payload = b"".join(STRUCT[a.type].pack(value) if a is argument else plain(a) for a in command.arguments)
    before = (bench_unit.device.housekeeping(), bench_unit.memory.record.active, len(bench_unit.memory.record.schedule))
    assert answer(bench_unit, command.code, payload) == ("rejected", "out_of_range")
    after = (bench_unit.device.housekeeping(), bench_unit.memory.record.active, len(bench_unit.memory.record.schedule))
    changed = {n for n in before[0] if repr(before[0][n]) != repr(after[0][n])}
    assert changed <= {"commands_rejected", "frames_good"}
    assert before[1:] == after[1:]


@pytest.mark.parametrize("command", DICTIONARY.commands, ids=lambda c: c.name)
@pytest.mark.parametrize("off", [-1, 1, 300])
def test_arguments_of_the_wrong_length_are_rejected(bench_unit: Bench, command: CommandDefinition, off: int) -> None:
    """Arguments with one byte missing, one extra or 300 extra are rejected."""
    length = fixed_bytes(command.arguments) + off
    if length >= 0:
        valid = b"".join(plain(a) for a in command.arguments)
        payload = valid[:length].ljust(length, b"\0")
        assert answer(bench_unit, command.code, payload) == ("rejected", "bad_length")


@pytest.mark.parametrize("command", [c for c in DICTIONARY.commands if c.preconditions], ids=lambda c: c.name)
def test_commands_in_the_wrong_mode_are_rejected(bench: Bench, command: CommandDefinition) -> None:
    """A command is rejected if any one of its preconditions is violated."""
    payload = b"".join(plain(a) for a in command.arguments)
    for condition in command.preconditions:
        if condition.field == "mode":
            bench.do("SET_MODE", mode="standby")
        else:
            bench.do("SET_MODE", mode="lost_in_space")
            bench.do("START_CYCLE")
        assert answer(bench, command.code, payload) == ("rejected", "wrong_state")


def test_the_same_id_with_other_bytes_is_rejected(bench: Bench) -> None:
    """Other arguments or another command with a used id are rejected as ``id_reused``. The first command's effect
    remains."""
    done = bench.do("SET_EXPOSURE", exposure_ms=111)
    code = bench.dictionary.command("SET_EXPOSURE").code
    assert answer(bench, code, b"\0\x70", done.request_id) == ("rejected", "id_reused")
    assert answer(bench, bench.dictionary.command("SET_GAIN").code, b"\2", done.request_id) == ("rejected", "id_reused")
    assert bench.tracker.exposure_ms == 111


def test_a_command_too_long_for_a_packet_is_dropped_and_counted(bench: Bench) -> None:
    """The device drops frames longer than a packet and counts them. It then executes the next command."""
    before = int(bench.status()["frames_bad"])
    _, frame = bench.host.craft(PacketType.COMMAND, 2, bytes(MAX_PACKET_BYTES - 24))
    bench.device.feed(frame, bench.now_s)
    oversize = b"\0" + b"\1" * (3 * MAX_PACKET_BYTES) + b"\0"
    bench.device.feed(oversize, bench.now_s)
    assert int(bench.status()["frames_bad"]) > before


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"kind": "catalogue", "target": 9}, "not_found"),
        ({"kind": "catalogue", "target": 3}, "write_protected"),
        ({"kind": "catalogue", "size_bytes": 200 * 1024}, "too_large"),
        ({"kind": "catalogue", "size_bytes": 0}, "bad_length"),
        ({"kind": "catalogue", "profile": "sunsat"}, "incompatible"),
        ({"kind": "catalogue", "device_model": "another"}, "incompatible"),
        ({"kind": "catalogue", "dictionary_hash": bytes(32)}, "incompatible"),
        ({"kind": "catalogue", "format_version": 7}, "incompatible"),
        ({"kind": "catalogue", "chunk_bytes": 15}, "out_of_range"),
        ({"kind": "catalogue", "chunk_bytes": 1537}, "out_of_range"),
        ({"kind": "image", "target": 4}, "not_found"),
        ({"kind": "image", "size_bytes": 1024 * 512 - 1}, "bad_length"),
        ({"kind": "image", "size_bytes": 1024 * 512 + 1}, "too_large"),
        ({"kind": "calibration", "target": 2}, "not_found"),
        ({"kind": "calibration", "target": 3}, "write_protected"),
        ({"kind": "calibration", "size_bytes": 4097}, "too_large"),
        ({"kind": "parameters", "format_version": 2}, "incompatible"),
        ({"kind": "triplets", "size_bytes": 1536 * 1024 + 1}, "too_large"),
        ({"kind": "star_list"}, "not_found"),
        ({"kind": "distance_table"}, "not_found"),
        ({"kind": "region"}, "not_found"),
        ({"kind": "frame"}, "not_found"),
    ],
)
def test_impossible_uploads_are_rejected(bench: Bench, values: dict[str, object], reason: str) -> None:
    """Uploads with an invalid kind, target, size, camera, dictionary, format or chunk size are rejected, and nothing is
    opened for them."""
    offer = {"target": 1, "size_bytes": 1000, "chunk_bytes": 256, "sha256": bytes(32), "profile": "cubestar"}
    offer |= {"device_model": bench.dictionary.device_model, "dictionary_hash": bench.dictionary.hash}
    offer |= {"format_version": 1, "epoch_jyear": 2026.0, "stars": 0, "pairs": 0}
    assert bench.refusal("OPEN_UPLOAD", offer | values) == reason  # type: ignore[arg-type]
    assert bench.memory.record.uploads == {}
