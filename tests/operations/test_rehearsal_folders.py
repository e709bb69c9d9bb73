"""Removal of the folders of rehearsals whose server was killed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gss.domain.errors import NotFound
from gss.operations.rehearsals.rehearsal_report import RehearsalOptions
from gss.settings import Settings
from gss.wiring.build import build


def test_a_folder_left_behind_is_removed_by_the_next_rehearsal(tmp_path: Path) -> None:
    """The next rehearsal removes an old folder. A recent one, whose rehearsal may still run, is kept."""
    old, recent = (tmp_path / "rehearsals" / name for name in ("old", "recent"))
    for folder in (old, recent):
        folder.mkdir(parents=True)
        (folder / "gss.db").write_bytes(b"content")
    os.utime(old, (1e9, 1e9))
    services = build(Settings(data=tmp_path))
    with pytest.raises(NotFound):
        services.passes.rehearsals.run(999, RehearsalOptions(), lambda share, text: None)
    services.stop()
    assert list((tmp_path / "rehearsals").iterdir()) == [recent]
