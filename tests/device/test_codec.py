"""Values and bytes agree for every row of the dictionary."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.protocol.codec import decode, encode
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.checked_values import check_argument, check_arguments
from gss.instruments.dictionary.definitions import (
    INTEGER_RANGES,
    Argument,
    CommandDefinition,
    Group,
    Item,
    Layout,
    Value,
)
from gss.instruments.dictionary.read_dictionary import load_dictionary

DICTIONARY = load_dictionary()
LAYOUTS: dict[str, Layout] = {
    **{f"command {c.name}": tuple(c.arguments) for c in DICTIONARY.commands},
    **{f"returns {c.name}": c.returns for c in DICTIONARY.commands},
    **{f"telemetry {p.name}": p.fields for p in DICTIONARY.telemetry},
    **{f"service {s.name}": s.fields for s in DICTIONARY.services},
}
ARGUMENTS = [(c, a) for c in DICTIONARY.commands for a in c.arguments]


def values_of(item: Item) -> st.SearchStrategy[Any]:
    """Return a strategy for every value that the type can encode."""
    if item.type in INTEGER_RANGES:
        return st.integers(*INTEGER_RANGES[item.type])
    text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=10)
    fitting = text.filter(lambda s: len(s.encode()) <= (item.size or 255))
    infinite = not isinstance(item, Argument)
    table: dict[str, st.SearchStrategy[Any]] = {
        "f32": st.floats(width=32, allow_nan=False, allow_infinity=infinite),
        "f64": st.floats(allow_nan=False, allow_infinity=infinite),
        "bool": st.booleans(),
        "enum": st.sampled_from([c.name for c in item.choices] or [""]),
        "bytes": st.binary(min_size=item.size, max_size=item.size),
        "rest": st.binary(max_size=40),
        "str": fitting,
        "text": fitting,
    }
    return table[item.type]


@pytest.mark.parametrize("name", sorted(LAYOUTS))
@given(data=st.data())
@settings(max_examples=12, deadline=None)
def test_encoded_values_are_decoded_unchanged(name: str, data: st.DataObject) -> None:
    """Decoding returns the encoded values and lists of every layout. One byte less or more is rejected."""
    layout = LAYOUTS[name]
    values = {e.name: data.draw(values_of(e)) for e in layout if isinstance(e, Item)}
    lists = {
        e.name: tuple({i.name: data.draw(values_of(i)) for i in e.items} for _ in range(data.draw(st.integers(0, 3))))
        for e in layout
        if isinstance(e, Group)
    }
    payload = encode(layout, values, lists)
    decoded = decode(layout, payload)
    enums = {e.name for e in layout if isinstance(e, Item) and e.type == "enum"}
    assert {n: v for n, v in decoded.raw.items() if n not in enums} == {
        n: v for n, v in values.items() if n not in enums
    }
    assert {n: decoded.values[n] for n in enums} == {n: values[n] for n in enums}
    assert decoded.lists == lists
    if not any(isinstance(e, Item) and e.type == "rest" for e in layout):
        with pytest.raises(CorruptData):
            decode(layout, payload + b"\0")
        if payload:
            with pytest.raises(CorruptData):
                decode(layout, payload[:-1])


@pytest.mark.parametrize(("command", "argument"), ARGUMENTS, ids=[f"{c.name}.{a.name}" for c, a in ARGUMENTS])
def test_argument_limits_are_inclusive(command: CommandDefinition, argument: Argument) -> None:
    """Minimum and maximum are accepted. One step beyond is rejected with the range and the value."""
    if argument.choices:
        for choice in argument.choices:
            assert check_argument(argument, choice.name) == choice.name
        with pytest.raises(BadInput, match="no such choice"):
            check_argument(argument, "nonsense")
        return
    if argument.type == "bytes":
        assert check_argument(argument, b"\1\2") == b"\1\2".ljust(argument.size, b"\0")
        assert len(check_argument(argument, bytes(argument.size))) == argument.size
        with pytest.raises(BadInput, match=f"bytes{argument.size}"):
            check_argument(argument, bytes(argument.size + 1))
        return
    low, high = argument.minimum, argument.maximum
    assert low is not None
    assert high is not None
    step = 1 if argument.type in INTEGER_RANGES else 0.01
    assert check_argument(argument, low) == low
    assert check_argument(argument, high) == high
    for beyond in (low - step, high + step):
        with pytest.raises(BadInput) as caught:
            check_argument(argument, beyond)
        assert f"{low:g} – {high:g}" in str(caught.value) or f"got {beyond}" in str(caught.value)
    assert encode([argument], {argument.name: low})


def test_the_error_of_a_value_out_of_range_has_range_and_value() -> None:
    """The error has the allowed range with its unit and the rejected value, which the console displays."""
    threshold = DICTIONARY.command("SET_DETECTION").argument("threshold_dn")
    with pytest.raises(BadInput) as caught:
        check_argument(threshold, 5000)
    assert (caught.value.expected, caught.value.got) == ("0 – 4095 DN", "5000")


def test_the_text_of_a_range_is_exact() -> None:
    """Large integers are shown with all digits, and other numbers without rounding."""
    for argument, text in (
        (Argument("n", "u32", minimum=0, maximum=0xFFFF_FFFF), "0 – 4294967295"),
        (Argument("n", "f32", minimum=-1.000030518509476, maximum=60.0), "-1.000030518509476 – 60"),
    ):
        assert argument.range_text == text


@pytest.mark.parametrize("wrong", [True, "12", 12.5, math.nan, math.inf, None, b"\1"])
def test_a_number_must_be_a_number(wrong: Value) -> None:
    """Booleans, texts, fractions, infinities and bytes are rejected for an integer argument."""
    with pytest.raises(BadInput):
        check_argument(Argument("n", "u8", minimum=0, maximum=255), wrong)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, 10**400, True, "1.0"])
def test_a_float_argument_must_be_finite(wrong: Value) -> None:
    """NaN, infinity, integers above all floats, booleans and texts are rejected for a float argument."""
    with pytest.raises(BadInput):
        check_argument(DICTIONARY.command("SET_ATTITUDE_HINT").argument("ra_deg"), wrong)


def test_unknown_and_missing_arguments_are_rejected_and_defaults_fill_in() -> None:
    """Unknown arguments, and missing ones without a default, are rejected. Missing ones get their default."""
    command = DICTIONARY.command("TAKE_IMAGE")
    assert check_arguments(command, {"slot": 3}) == {"slot": 3, "exposure_ms": 0}
    with pytest.raises(BadInput, match="unknown argument"):
        check_arguments(command, {"slots": 3})
    with pytest.raises(BadInput, match="missing"):
        check_argument(Argument("n", "u8", minimum=0, maximum=255), None)


def test_bytes_are_big_endian_and_in_order() -> None:
    """Encoded arguments equal the big-endian bytes of ``struct``, in the order of the dictionary."""
    command = DICTIONARY.command("SET_ATTITUDE_HINT")
    values = {"ra_deg": 10.5, "dec_deg": -3.25, "roll_deg": 1.0, "uncertainty_deg": 5.0}
    assert encode(command.arguments, values) == struct.pack(">dddf", 10.5, -3.25, 1.0, 5.0)


def test_telemetry_is_in_engineering_units() -> None:
    """Values are converted by linear and polynomial functions, and enumerations are decoded to names."""
    fields = [f for f in DICTIONARY.packet("housekeeping").fields if isinstance(f, Item)]
    chosen = [
        f for f in fields if f.name in ("mode", "sensor_temperature_c", "processor_temperature_c", "supply_3v3_v")
    ]
    decoded = decode(chosen, struct.pack(">BHHH", 3, 1000, 1500, 3300))
    assert decoded.values["mode"] == "tracking"
    assert decoded.values["sensor_temperature_c"] == pytest.approx(12.5)
    assert decoded.values["processor_temperature_c"] == pytest.approx(-60 + 75 + 2.25)
    assert decoded.values["supply_3v3_v"] == pytest.approx(3.3)
    assert decoded.raw["mode"] == 3


def test_a_nul_inside_a_text_is_replaced() -> None:
    """A NUL between characters becomes U+FFFD in every kind of text. NUL bytes after the text are padding."""
    for item, payload in ((Item("x", "str", 8), b"a\0b\0\0\0\0\0"), (Item("x", "text"), b"\3a\0b")):
        assert decode([item], payload).values["x"] == "a\N{REPLACEMENT CHARACTER}b"


def test_an_invalid_payload_is_corrupt() -> None:
    """Unknown choices, booleans above one and truncated text are rejected as corrupt."""
    for kind, payload in (("bool", b"\2"), ("text", b"\2\xff\xff")):
        with pytest.raises(CorruptData):
            decode([Item("x", kind)], payload)
    with pytest.raises(CorruptData):
        decode([DICTIONARY.command("SET_MODE").arguments[0]], b"\x63")
