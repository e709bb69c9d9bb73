"""A prepared decoder gives the same results as the plain one, for valid and invalid payloads."""

from __future__ import annotations

import random
from typing import Any

import pytest

from gss.device.protocol.codec import Decoded, decode
from gss.device.session_telemetry import Decoder
from gss.domain.errors import CorruptData
from gss.instruments.dictionary.definitions import Group, Item, Layout
from gss.instruments.dictionary.read_dictionary import load_dictionary

DICTIONARY = load_dictionary()
LAYOUTS: dict[str, Layout] = {
    **{f"command {c.name}": tuple(c.arguments) for c in DICTIONARY.commands},
    **{f"telemetry {p.name}": p.fields for p in DICTIONARY.telemetry},
    **{f"service {s.name}": s.fields for s in DICTIONARY.services},
}
WIDTH = {"u8": 1, "u16": 2, "u32": 4, "i8": 1, "i16": 2, "i32": 4, "f32": 4, "f64": 8, "bool": 1, "enum": 1}


def payload_of(layout: Layout, rng: random.Random) -> bytes:
    """Return bytes of about the right length, mostly with valid booleans, choices and texts."""
    parts: list[bytes] = []
    for entry in layout:
        if isinstance(entry, Group):
            count = rng.randrange(4)
            parts += [bytes([count]), *(bytes_of(item, rng) for _ in range(count) for item in entry.items)]
        else:
            parts.append(bytes_of(entry, rng))
    payload = b"".join(parts)
    if rng.random() < 0.3:
        payload = rng.choice([payload[:-1], payload + b"\0", payload[: len(payload) // 2], payload[1:]])
    return payload


def bytes_of(item: Item, rng: random.Random) -> bytes:
    """Return the bytes of an item. One in 200 may be invalid."""
    invalid = rng.random() < 0.005
    if item.type == "bool" and not invalid:
        return bytes([rng.randrange(2)])
    if item.type == "enum" and not invalid:
        return bytes([rng.choice(item.choices).value])
    if item.type == "str" and not invalid:
        return "ä b"[: rng.randrange(4)].encode()[: item.size].ljust(item.size, b"\0")
    if item.type == "text":
        return bytes([2]) + (b"\xff\xfe" if invalid else b"ok")
    return rng.randbytes(WIDTH.get(item.type, item.size or 5))


def outcome(make: Any) -> tuple[Any, ...]:
    """Return the complete result of a decoding: values with their types and order, or the complete error.

    NaN equals itself as text.
    """
    try:
        decoded: Decoded = make()
    except CorruptData as error:
        return (str(error), error.expected, error.got)
    return tuple(repr(part) for part in (decoded.raw, decoded.values, decoded.lists))


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_a_prepared_layout_decodes_like_the_plain_layout(name: str) -> None:
    """Both decoders return the same values with the same types and order. For an invalid payload the errors are equal."""
    layout, rng = LAYOUTS[name], random.Random(name)
    decoder = Decoder(layout)
    outcomes = set()
    for _ in range(60):
        payload = payload_of(layout, rng)
        expected = outcome(lambda p=payload: decode(layout, p))
        assert outcome(lambda p=payload: decoder.decode(p)) == expected
        outcomes.add(expected)
    assert len(outcomes) > 1 or not layout
