"""Encoding of tables: values are restored exactly, damage is always detected, and invalid values are named."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.table_use import (
    calibrated,
    calibration_values,
    chain_of,
    check_bad_pixels,
    check_parameters,
    parameter_values,
    parameters_with,
)
from gss.device.tables import (
    HEADER_BYTES,
    TABLE_FORMAT,
    Scalar,
    decode_bad_pixels,
    decode_table,
    encode_bad_pixels,
    encode_table,
)
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.onboard import Commanded

CAMERAS = pytest.mark.parametrize(
    "camera", [i.profile for i in shipped_registry().all() if i.profile.chain], ids=lambda p: p.name
)
NAMES = st.text("abcdefghijklmnopqrstuvwxyz_", min_size=1, max_size=20)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@CAMERAS
def test_a_calibration_restores_its_camera(camera: CameraProfile) -> None:
    """Geometry, distortion and photometry are restored exactly, for all cameras with a chain."""
    name, values = decode_table("calibration", encode_table("calibration", camera.name, calibration_values(camera)))
    assert name == camera.name
    assert calibrated(camera, values) == camera


@CAMERAS
def test_a_parameter_set_of_default_values_changes_nothing(camera: CameraProfile) -> None:
    """With a table of default values and commanded detection settings, the chain's parameters in every mode and exposure
    are those without a table."""
    name, values = decode_table("parameters", encode_table("parameters", camera.name, parameter_values(camera)))
    assert name == camera.name
    check_parameters(camera, values)
    assert chain_of(camera, values) is chain_of(camera)
    commanded = Commanded(14.0, 5, 70, 0.05)
    for mode in Mode:
        for exposure_s in (None, 0.1, 0.7):
            plain = parameters_with({}, camera, exposure_s, commanded, mode)
            assert repr(parameters_with(values, camera, exposure_s, commanded, mode)) == repr(plain)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.dictionaries(NAMES.filter(lambda n: n != "chain"), NUMBERS, max_size=30))
def test_any_numbers_are_restored_exactly(numbers: dict[str, float]) -> None:
    """Values with any valid names, in any order, are restored exactly."""
    values: dict[str, Scalar] = {"chain": "x", **numbers}
    if any(not n.isidentifier() for n in numbers):
        with pytest.raises(BadInput):
            encode_table("parameters", "cubestar", values)
        return
    assert decode_table("parameters", encode_table("parameters", "cubestar", values)) == ("cubestar", values)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.data())
def test_every_damaged_byte_is_detected(data: st.DataObject) -> None:
    """A table with a flipped bit or a truncated end raises ``CorruptData``."""
    valid = encode_table("calibration", "cubestar", calibration_values(shipped_camera("cubestar")))
    if data.draw(st.booleans()):
        damaged = valid[: data.draw(st.integers(0, len(valid) - 1))]
    else:
        position = data.draw(st.integers(0, len(valid) - 1))
        damaged = (
            valid[:position] + bytes([valid[position] ^ (1 << data.draw(st.integers(0, 7)))]) + valid[position + 1 :]
        )
    with pytest.raises(CorruptData):
        decode_table("calibration", damaged)


def sealed(head: bytes, body: bytes) -> bytes:
    """Return a table with a valid checksum and any content."""
    head = head[:44] + struct.pack("<I", len(body)) + head[48:56] + struct.pack("<I", zlib.crc32(body))
    return head + struct.pack("<I", zlib.crc32(head)) + body


@pytest.mark.parametrize(
    "body",
    [
        b"\1b" + struct.pack("<d", 1.0) + b"\1a" + struct.pack("<d", 1.0),
        b"\1a" + struct.pack("<d", 1.0) + b"\1a" + struct.pack("<d", 1.0),
        b"\1a" + struct.pack("<d", float("nan")) + b"\1b" + struct.pack("<d", 1.0),
        b"\1a" + struct.pack("<d", 1.0),
        b"\1a" + struct.pack("<d", 1.0) + b"\1b" + struct.pack("<d", 1.0) + b"x",
        b"\1 " + struct.pack("<d", 1.0) + b"\1b" + struct.pack("<d", 1.0),
        b"\xff",
        b"",
    ],
)
def test_a_sealed_table_with_invalid_content_is_rejected(body: bytes) -> None:
    """Unsorted or duplicate names, values that are not numbers, and too few or too many values are rejected despite a valid
    checksum."""
    head = encode_table("parameters", "cubestar", {"chain": "x", "a": 1.0, "b": 2.0})[: HEADER_BYTES - 4]
    with pytest.raises(CorruptData):
        decode_table("parameters", sealed(head, body))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 65535), st.integers(0, 65535)), max_size=40))
def test_bad_pixels_are_restored_without_repetition(pixels: list[tuple[int, int]]) -> None:
    """Any pixels are restored once each, and any changed byte is detected."""
    data = encode_bad_pixels("cubestar", np.array(pixels, np.int64).reshape(-1, 2))
    name, rows = decode_bad_pixels(data)
    assert (name, {tuple(r) for r in rows.tolist()}, len(rows)) == ("cubestar", set(pixels), len(set(pixels)))
    for at in (0, 24, 44, len(data) - 1):
        with pytest.raises(CorruptData):
            decode_bad_pixels(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])


@pytest.mark.parametrize("body", [bytes([1, 0, 2, 0, 1, 0, 2, 0]), bytes([2, 0, 2, 0, 1, 0, 2, 0]), b"\1\0\2"])
def test_bad_pixels_out_of_order_are_rejected(body: bytes) -> None:
    """Repeated or unordered pixels and an incomplete pixel are rejected despite a valid checksum."""
    head = encode_bad_pixels("cubestar", np.array([[1, 2], [2, 2]]))[: HEADER_BYTES - 4]
    with pytest.raises(CorruptData):
        decode_bad_pixels(sealed(head, body))


def test_impossible_bad_pixels_are_rejected() -> None:
    """Pixels beside the detector, and more pixels than the flash holds, are rejected."""
    with pytest.raises(BadInput, match="not on the detector"):
        check_bad_pixels(shipped_camera("cubestar"), np.array([[3, 4], [1024, 4]]))
    with pytest.raises(BadInput, match="too many"):
        encode_bad_pixels("cubestar", np.argwhere(np.ones((100, 100), bool)))


@pytest.mark.parametrize(
    ("kind", "name", "values", "says"),
    [
        ("triplets", "cubestar", {}, "unknown kind"),
        ("parameters", "cubestar", {}, "chain is missing"),
        ("parameters", "cubestar", {"chain": 3}, "chain is missing"),
        ("parameters", "", {"chain": "x"}, "profile does not fit"),
        ("parameters", "a" * 17, {"chain": "x"}, "profile does not fit"),
        ("parameters", "cubestar", {"chain": "x" * 17}, "chain does not fit"),
        ("parameters", "cubestar", {"chain": "x", "a": float("nan")}, "a is not a number"),
        ("parameters", "cubestar", {"chain": "x", "a": float("inf")}, "a is not a number"),
        ("parameters", "cubestar", {"chain": "x", "a": "one"}, "a is not a number"),
        ("parameters", "cubestar", {"chain": "x", "a b": 1.0}, "not a name"),
        ("parameters", "cubestar", {"chain": "x", "ä": 1.0}, "not a name"),
        ("parameters", "cubestar", {"chain": "x", "a" * 41: 1.0}, "not a name"),
        ("parameters", "cubestar", {"chain": "x"} | {f"n{i}": 1.0 for i in range(201)}, "too many values"),
    ],
)
def test_an_impossible_table_names_the_value(kind: str, name: str, values: dict[str, Scalar], says: str) -> None:
    """A table with an invalid value is rejected with the name of the value."""
    with pytest.raises(BadInput) as caught:
        encode_table(kind, name, values)
    assert says in str(caught.value)


def test_the_longest_table_fits_its_sector() -> None:
    """A table with 200 values and short names fits its sector. With long names it is rejected as too long."""
    numbers: dict[str, Scalar] = {f"n{i}": float(i) for i in range(200)}
    assert len(encode_table("parameters", "cubestar", {"chain": "x", **numbers})) <= 4096
    long: dict[str, Scalar] = {f"n{i:039d}": float(i) for i in range(200)}
    with pytest.raises(BadInput, match="too long"):
        encode_table("parameters", "cubestar", {"chain": "x", **long})
    assert TABLE_FORMAT == 1
