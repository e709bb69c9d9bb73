"""Compressed blobs, and the packed detail of solutions."""

from __future__ import annotations

import hashlib
import zlib
from base64 import b64decode, b64encode, b85encode
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from zstandard import ZstdDecompressor

from gss.domain.errors import CorruptData
from gss.domain.json_object import JsonObject
from gss.store.blobs import BlobStore
from gss.store.compression import MAGIC, compressed, decompressed, items_of_planes, zstd, zstd_plain
from gss.store.packed_detail import packed, residuals_px, unpacked


def noise(dtype: str, rows: int = 512, columns: int = 1024) -> np.ndarray:
    """Return a dark frame with the noise of a typical detector."""
    return np.random.default_rng(4).normal(18, 2.5, (rows, columns)).clip(0, 255).astype(dtype)


@pytest.mark.parametrize("dtype", ["<u1", "<u2", "<f4"])
def test_a_frame_is_compressed_and_read_back_unchanged(tmp_path: Path, dtype: str) -> None:
    """A frame of integers is stored in at most 55 % of its size, and read back unchanged under the hash of its bytes."""
    frame = noise(dtype)
    data, blobs = frame.tobytes(), BlobStore(str(tmp_path))
    key = blobs.put(frame.data.cast("B"), frame.itemsize)
    assert key == hashlib.sha256(data).hexdigest()
    assert blobs.get(key) == data
    assert blobs.size(key) <= (0.55 if frame.itemsize < 4 else 1.0) * len(data)
    assert blobs.put(data) == key
    assert list(blobs.keys()) == [key]


def test_files_of_older_versions_are_read_and_kept(tmp_path: Path) -> None:
    """An uncompressed file of an older version is read and not written again. If damaged, it is replaced by the next
    copy."""
    data = noise("<u1").tobytes()
    blobs, key = BlobStore(str(tmp_path)), hashlib.sha256(data).hexdigest()
    path = tmp_path / key[:2] / key[2:]
    path.parent.mkdir()
    path.write_bytes(data)
    assert blobs.get(key) == data
    blobs.put(data)
    assert path.read_bytes() == data
    path.write_bytes(data[:-1])
    with pytest.raises(CorruptData):
        blobs.get(key)
    blobs.put(data)
    assert blobs.get(key) == data


@pytest.mark.parametrize("position", [3, 9, 12, 20, 200, -1])
def test_a_damaged_compressed_file_is_detected(tmp_path: Path, position: int) -> None:
    """A compressed file with a wrong byte or a missing end raises ``CorruptData``."""
    blobs = BlobStore(str(tmp_path))
    key = blobs.put(noise("<u1").tobytes())
    path = tmp_path / key[:2] / key[2:]
    valid = bytearray(path.read_bytes())
    for damaged in (
        valid[:position],
        valid[:position] + bytes([valid[position] ^ 0x55]) + (valid[position + 1 :] if position > 0 else b""),
    ):
        path.write_bytes(damaged)
        with pytest.raises(CorruptData):
            blobs.get(key)


@pytest.mark.parametrize("data", [b"", b"x", MAGIC, MAGIC + bytes(30), MAGIC + b"\x01" + bytes(600), b"\xff" * 511])
def test_any_content_is_read_back(tmp_path: Path, data: bytes) -> None:
    """Any content is read back unchanged, also if it resembles compressed data or is too short to compress."""
    blobs = BlobStore(str(tmp_path))
    assert blobs.get(blobs.put(data)) == data
    assert blobs.get(blobs.put(data + bytes(3), item_bytes=2)) == data + bytes(3)


def test_noise_is_stored_uncompressed() -> None:
    """Content without redundancy is not compressed. Bytes with an impossible size in the header are not decompressed."""
    random = np.random.default_rng(1).bytes(100_000)
    assert compressed(random) is None
    assert decompressed(random) is None
    assert decompressed(MAGIC + b"\xff" * 9 + random) is None


STAR = {"index": 0, "col_px": 511.12345, "row_px": 3.25, "flux_dn": 812.5, "peak_dn": 97.1, "area_px": 9}
NAMED = {"hip": 27989, "name": "Betelgeuse", "v_mag": 0.45, "weight": 0.75}
RESIDUALS = {"dx_px": 0.125, "dy_px": None, "dx_arcsec": 13.5, "dy_arcsec": None}
REGION = {
    "col_min": 1,
    "row_min": 2,
    "col_max": 3,
    "row_max": 4,
    "area_px": 9,
    "peak_dn": 80.0,
    "rejected": "area 9 < 10",
}


def _older_forms(stored: JsonObject) -> list[JsonObject]:
    """Return packed lists as earlier versions wrote them: without byte planes, with zlib, and as text in base 64 or 85."""
    texts = stored["packed_zstd"].items()
    plain = {name: ZstdDecompressor().decompress(b64decode(text)) for name, text in texts}
    blocks = {name: zlib.compress(items_of_planes(planes, 4), 1) for name, planes in plain.items()}
    return [
        {key: {name: encode(block).decode() for name, block in blocks.items()}}
        for key, encode in (("packed64", b64encode), ("packed", b85encode))
    ]


@pytest.mark.parametrize("form", ["packed_zstd", "packed64", "packed"])
@pytest.mark.parametrize(
    "block", [b"", b"damaged", zstd(b""), zstd(b"abc"), zlib.compress(b"abc"), zstd(bytes(400))[:9]]
)
def test_damaged_packed_lists_are_reported(form: str, block: bytes) -> None:
    """Packed lists that cannot be decompressed or are incomplete raise an error with the reason."""
    text = (b85encode if form == "packed" else b64encode)(block).decode()
    with pytest.raises(CorruptData, match="stored regions of a solution are damaged"):
        unpacked({form: {"regions": text}})
    with pytest.raises(CorruptData, match="stored stars of a solution are damaged"):
        residuals_px({form: {"stars": text}})


def test_a_packed_detail_is_read_back() -> None:
    """Packed stars with and without names, missing numbers, regions and unpacked fields are read back unchanged."""
    named = STAR | {"index": 1} | NAMED | RESIDUALS
    unknown = named | {"index": 2, "hip": 2_000_000_001, "name": "Gaia row 1", "v_mag": None}
    detail = {"stars": [STAR, named, unknown], "regions": [REGION, REGION | {"rejected": ""}], "versions": {"gss": "1"}}
    before = deepcopy(detail)
    stored = packed(detail)
    assert set(stored) == {"packed_zstd", "versions"}
    assert unpacked(stored) == before == detail
    assert packed(deepcopy(stored)) == stored  # a worker packs, and the column type leaves the document unchanged
    for older in _older_forms(stored):
        assert unpacked(older | {"versions": {"gss": "1"}}) == before


def test_residuals_are_read_without_the_rows() -> None:
    """The distances of a packed document, of an older one and of a plain one are equal. A missing part gives None."""
    known = STAR | {"index": 1} | NAMED | RESIDUALS | {"dx_px": 0.375, "dy_px": -0.5}
    detail = {"stars": [STAR, known, STAR | {"index": 2} | NAMED | RESIDUALS | {"hip": 24436}], "regions": [REGION]}
    expected = {27989: 0.625, 24436: None}
    stored = packed(deepcopy(detail))
    for form in (stored, detail, *_older_forms(stored)):
        assert residuals_px(form) == expected
    assert residuals_px({}) == residuals_px(packed({"regions": [REGION]})) == {}


@pytest.mark.parametrize(
    "detail",
    [
        {},
        {"stars": []},
        {"stars": [{"index": 0, "hip": 5}], "grid": []},
        {"stars": [STAR | {"index": 7}]},
        {"stars": [STAR | {"col_px": 1e9}]},
        {"stars": [STAR | {"flux_dn": None}]},
        {"stars": [STAR | {"other": 1}]},
        {"regions": [REGION | {"area_px": None}]},
    ],
)
def test_a_detail_with_other_fields_is_stored_unchanged(detail: dict[str, object]) -> None:
    """Lists that do not have the expected form are stored without packing, so that nothing is lost."""
    assert packed(deepcopy(detail)) == detail
    assert unpacked(deepcopy(detail)) == detail


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b + b"x", lambda b: b"", lambda b: b"abc" + b[3:]])
def test_a_damaged_frame_is_not_read(damage):
    """A truncated, extended, empty or foreign frame gives None."""
    assert zstd_plain(damage(zstd(bytes(5000))), 5000) is None


def test_a_frame_that_states_another_size_is_not_unpacked():
    """A small frame of 100 MB is rejected by its stated size, before memory is reserved for it."""
    assert zstd_plain(zstd(bytes(100 << 20)), 5000) is None
