"""Anchors of the audit log: number and hash of each row, appended to a file outside the database.

The hash chain alone does not show whether its last rows were removed, or whether all rows were rewritten with new
hashes. A comparison with the file shows both, unless the file was also changed. Lines are only appended. The comparison
begins at the last *accepted* line, which is written, for example, after the database was replaced with an older copy on
purpose.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path

from gss.domain.errors import StoreDown

ANCHORS = "audit-anchor.jsonl"
"""Name of the file in the data folder."""
BATCH = 500
TAIL_BYTES = 8192
ACCEPTED = b'"accepted": "'
"""Start of the field that marks an accepted line. Other lines do not contain this field."""


@dataclass(frozen=True)
class Anchor:
    """Number and hash of a row. ``at``: ISO 8601, UTC. ``accepted``: user and reason in an accepted line, otherwise ""."""

    seq: int
    hash: str
    at: str
    accepted: str = ""


class AnchorFile:
    """File of JSON lines, one line per row of the log. Several processes can append lines. Unreadable lines, which a power
    failure can cause, are skipped."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def exists(self) -> bool:
        """True if the file exists."""
        return self.path.exists()

    def create(self) -> None:
        """Create an empty file if it does not exist. Raises StoreDown if it cannot be created."""
        try:
            os.close(os.open(self.path, os.O_WRONLY | os.O_CREAT, 0o600))
        except OSError as error:
            raise StoreDown(
                "the anchor file of the audit log cannot be created",
                got=str(error),
                hint="check the data folder, or GSS_AUDIT_ANCHOR",
            ) from error

    def append(self, anchor: Anchor) -> None:
        """Append a line to the existing file. A missing file is not created, because its absence must be detected. Raises
        OSError."""
        values = asdict(anchor) if anchor.accepted else {"seq": anchor.seq, "hash": anchor.hash, "at": anchor.at}
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        try:
            os.write(handle, json.dumps(values).encode() + b"\n")
        finally:
            os.close(handle)

    def batches(self) -> Iterator[list[Anchor]]:
        """Yield all anchors from the last accepted line on, in batches. Raises OSError."""
        with self.path.open("rb") as file:
            start = position = 0
            for line in file:
                if ACCEPTED in line:
                    start = position
                position += len(line)
            file.seek(start)
            lines = (anchor for line in file if (anchor := _read(line)))
            while batch := list(islice(lines, BATCH)):
                yield batch

    def newest(self) -> Anchor | None:
        """Return the anchor with the highest row number in the last lines of the file, None if there is none. Raises OSError."""
        with self.path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL_BYTES))
            anchors = [anchor for line in file if (anchor := _read(line))]
        last = max((k for k, anchor in enumerate(anchors) if anchor.accepted), default=0)
        return max(anchors[last:], key=lambda anchor: anchor.seq, default=None)

    def accepted(self) -> Anchor | None:
        """Return the anchor of the last accepted line, None if there is none. Raises OSError."""
        first = next(self.batches(), [])
        return first[0] if first and first[0].accepted else None


def _read(line: bytes) -> Anchor | None:
    try:
        anchor = Anchor(**json.loads(line))
    except (ValueError, TypeError):
        return None
    return anchor if isinstance(anchor.seq, int) and isinstance(anchor.hash, str) else None
