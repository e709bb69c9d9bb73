"""One server per data folder: two would both believe that they own the record of the line."""

from __future__ import annotations

import contextlib
import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gss.domain.errors import Conflict, StoreDown


def own_folder(folder: Path) -> None:
    """Make a data folder that only its owner can open; one that was there is closed to everybody outside its group."""
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    elif folder.stat().st_mode & 0o007:
        with contextlib.suppress(PermissionError):  # somebody else's folder that we may write to
            folder.chmod(folder.stat().st_mode & 0o770)


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the folder; Conflict when another process holds it. The operating system lets go even after kill -9."""
    try:
        own_folder(folder)
        file = (folder / "server.lock").open("w")
    except OSError as error:
        raise StoreDown(
            "the data folder cannot be written", got=str(error), hint="another folder with --data"
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Conflict(
                "another GSS server uses this data folder",
                got=str(folder.resolve()),
                hint="stop it, or give another folder with --data",
            ) from None
        yield


@contextmanager
def named_lock(path: Path, words: str, *, wait: bool = False) -> Iterator[None]:
    """Hold a file; Conflict with these words when another thread or process holds it, or wait for it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            raise Conflict(words, got=str(path), hint="wait until it has ended") from None
        yield
