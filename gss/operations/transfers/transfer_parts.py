"""Stores the received parts of interrupted downloads on disk, so that they can resume after a crash of the server."""

from __future__ import annotations

import json
import os
from pathlib import Path

from gss.device.session_transfer import HeldPart

KEPT_PARTS = 16


class PartStore:
    """Stores one data file and one file of notes per transfer, named by the transfer's id. A damaged or missing part is
    ignored, because the hash of the complete content is checked at the end."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keep(self, transfer_id: int, part: HeldPart) -> None:
        """Replace the stored part. The notes are written last, so that they list only bytes that are on disk."""
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"{transfer_id}.part"
        is_new = not path.exists() or path.stat().st_size != len(part.data)
        with path.open("wb" if is_new else "r+b") as file:
            file.write(part.data)
            file.flush()
            os.fsync(file.fileno())
        notes = {"sha256": part.sha256, "chunk_bytes": part.chunk_bytes, "ranges": part.ranges}
        draft = path.with_suffix(".draft")
        draft.write_text(json.dumps(notes))
        draft.replace(path.with_suffix(".json"))

    def load(self, transfer_id: int) -> HeldPart | None:
        """Return the stored part; None if it is missing or damaged."""
        path = self._folder / f"{transfer_id}.part"
        try:
            notes = json.loads(path.with_suffix(".json").read_text())
            data = path.read_bytes()
            ranges = tuple((int(first), int(last)) for first, last in notes["ranges"])
            bytes.fromhex(notes["sha256"])
            return HeldPart(str(notes["sha256"]), int(notes["chunk_bytes"]), data, ranges) if ranges and data else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def drop(self, transfer_id: int) -> None:
        """Delete the stored part of a transfer."""
        for suffix in (".part", ".json", ".draft"):
            (self._folder / f"{transfer_id}{suffix}").unlink(missing_ok=True)

    def prune(self) -> None:
        """Delete all parts except those of the ``KEPT_PARTS`` latest transfers."""
        ids = sorted(int(path.stem) for path in self._folder.glob("*.part") if path.stem.isdigit())
        for transfer_id in ids[:-KEPT_PARTS]:
            self.drop(transfer_id)
