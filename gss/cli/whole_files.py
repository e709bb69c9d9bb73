"""Output files that are written completely or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gss.domain.errors import BadInput


def write_whole(path: Path, data: bytes) -> None:
    """Write a file in a folder that exists. If this fails, for example because the disk is full, an existing file is
    unchanged. Raises BadInput, OSError."""
    with _part_of(path) as part:
        part.write_bytes(data)


def write_pieces(path: Path, pieces: Iterable[str | bytes]) -> int:
    """Write a file, as :func:`write_whole`, and return its size in bytes. ``pieces``: can raise an error at any piece. Line ends
    are not changed."""
    with _part_of(path) as part, part.open("wb") as file:
        return sum(file.write(piece.encode() if isinstance(piece, str) else piece) for piece in pieces)


@contextmanager
def _part_of(path: Path) -> Iterator[Path]:
    """Return a new file beside ``path``, which replaces it at the end of the block with the same permissions. Return ``path``
    if it is a device or a pipe, for example /dev/stdout. A symbolic link is kept."""
    if path.exists() and not path.is_file():
        yield path
        return
    path = path.resolve()
    if not path.parent.is_dir():
        raise BadInput("the folder of the output does not exist", expected="an existing folder", got=str(path.parent))
    part = path.with_name(path.name + ".part")
    try:
        part.touch()
        if path.exists():
            shutil.copymode(path, part)
        yield part
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
