"""File locks and access rights of a data folder. Only one server may use a data folder, because two servers would write the
same captures."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gss.domain.errors import Conflict, StoreDown


def own_folder(folder: Path) -> None:
    """Create a data folder that only its owner can access. Remove the rights of group and others from an existing folder
    that is open to all users. A folder that is open only to its group is not changed, because an administrator gave the
    group access."""
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    elif folder.stat().st_mode & 0o007:
        with contextlib.suppress(PermissionError):  # the folder belongs to another user
            folder.chmod(folder.stat().st_mode & 0o700)


@contextmanager
def private_files() -> Iterator[None]:
    """Let only the user of this process access the files and folders that it creates in the block."""
    previous_umask = os.umask(0o077)
    try:
        yield
    finally:
        os.umask(previous_umask)


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Lock the data folder. Raises Conflict if another process has locked it, StoreDown if the folder is not writable. The
    operating system releases the lock even after kill -9."""
    try:
        own_folder(folder)
        file = (folder / "server.lock").open("w")
    except OSError as error:
        raise StoreDown(
            "the data folder cannot be written",
            got=str(error),
            hint="choose another folder with --data",
        ) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Conflict(
                "another GSS server uses this data folder",
                got=str(folder.resolve()),
                hint="stop it, or choose another folder with --data",
            ) from None
        yield


@contextmanager
def named_lock(path: Path, message: str, *, wait: bool = False) -> Iterator[None]:
    """Lock a file. If another thread or process has locked it, wait if ``wait`` is True; otherwise raise Conflict with
    ``message``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            raise Conflict(message, got=str(path), hint="wait until it has stopped") from None
        yield
