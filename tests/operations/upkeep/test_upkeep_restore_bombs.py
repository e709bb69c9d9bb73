"""Small backup files that unpack to more than a disk can store."""

from __future__ import annotations

import tarfile
from pathlib import Path
from typing import Any

import pytest

from gss.domain.errors import BadInput, CorruptData
from gss.operations.upkeep.restore import restore


@pytest.mark.parametrize("kind", ["sparse", "gzip"])
def test_a_tar_that_unpacks_to_far_more_than_its_size_is_rejected(kind: str, clock: Any, tmp_path: Path) -> None:
    """A tar with a sparse member or a compressed gigabyte of zeros is rejected before it is written."""
    evil, member = tmp_path / "evil.tar", tarfile.TarInfo("2026-01-01T000000Z/gss.db")
    if kind == "gzip":
        member.size = 1 << 30
        with tarfile.open(evil, "w:gz", compresslevel=9) as tar, Path("/dev/zero").open("rb") as zeros:
            tar.addfile(member, zeros)
    else:
        member.pax_headers = {"GNU.sparse.size": str(1 << 40), "GNU.sparse.map": "0,0", "GNU.sparse.numblocks": "1"}
        with tarfile.open(evil, "w", format=tarfile.PAX_FORMAT) as tar:
            tar.addfile(member)
    with pytest.raises((BadInput, CorruptData), match=r"too large when it is unpacked|not a backup") as refused:
        restore(evil, tmp_path / "new", clock)
    assert "larger disk" not in refused.value.hint
    assert [p.name for p in tmp_path.iterdir()] == ["evil.tar"]
