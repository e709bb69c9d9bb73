"""Stored parts of interrupted downloads."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from gss.device.session_transfer import HeldPart
from gss.operations.transfers.transfer_parts import KEPT_PARTS, PartStore

DATA = bytes(range(256)) * 40
PART = HeldPart(hashlib.sha256(DATA).hexdigest(), 1024, DATA, ((0, 2), (5, 5)))


def test_a_part_is_unchanged_by_the_store(tmp_path: Path) -> None:
    """Bytes, chunk size and ranges of a part are read unchanged. A newer version replaces an older one."""
    store = PartStore(tmp_path / "parts")
    assert store.load(7) is None
    store.keep(7, PART)
    assert store.load(7) == PART
    grown = HeldPart(PART.sha256, 512, DATA, ((0, 19),))
    store.keep(7, grown)
    assert PartStore(tmp_path / "parts").load(7) == grown
    store.drop(7)
    assert store.load(7) is None
    assert list((tmp_path / "parts").iterdir()) == []


@pytest.mark.parametrize("damage", ["notes cut", "notes gone", "bytes gone", "no json", "bad hash"])
def test_a_damaged_part_is_ignored(tmp_path: Path, damage: str) -> None:
    """A part that is damaged, as after a crash, is ignored."""
    store = PartStore(tmp_path)
    store.keep(1, PART)
    notes, content = tmp_path / "1.json", tmp_path / "1.part"
    if damage == "notes cut":
        notes.write_text(notes.read_text()[:-9])
    elif damage == "notes gone":
        notes.unlink()
    elif damage == "bytes gone":
        content.unlink()
    elif damage == "no json":
        notes.write_bytes(b"\xff\x00")
    else:
        notes.write_text(notes.read_text().replace(PART.sha256, "xyz"))
    assert store.load(1) is None


def test_only_the_newest_parts_are_kept(tmp_path: Path) -> None:
    """Only the newest parts are kept, so that failed downloads do not fill the disk."""
    store = PartStore(tmp_path)
    for transfer_id in range(1, KEPT_PARTS + 5):
        store.keep(transfer_id, PART)
    store.prune()
    assert [store.load(i) is not None for i in (1, 4, 5, KEPT_PARTS + 4)] == [False, False, True, True]
