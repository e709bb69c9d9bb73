"""Pixels and images of flash, kept under the hash of their content: the same bytes are stored once, and no name
that a person chose ever reaches the disk."""

from __future__ import annotations

import hashlib
import uuid

import fsspec

from gss.domain.errors import CorruptData, NotFound, StoreDown


class BlobStore:
    """Content-addressed bytes under an fsspec URL (a folder by default)."""

    def __init__(self, url: str) -> None:
        self._fs, self._root = fsspec.core.url_to_fs(url)
        self._fs.makedirs(self._root, exist_ok=True)

    def put(self, data: bytes) -> str:
        """Keep ``data``; its SHA-256 in hex is the key."""
        key = hashlib.sha256(data).hexdigest()
        path = self._path(key)
        try:
            if not self._holds(path, data):
                self._write(path, data)
        except OSError as error:
            raise StoreDown(
                "the bytes cannot be stored now", got=str(error), hint="look at disk space and permissions"
            ) from error
        return key

    def _holds(self, path: str, data: bytes) -> bool:
        """Is it there, and undamaged? A file that rotted is healed by the next copy of its content."""
        if not self._fs.exists(path):
            return False
        with self._fs.open(path, "rb") as file:
            return bool(file.read() == data)

    def _write(self, path: str, data: bytes) -> None:
        """Under a name of its own first: two requests may bring the same bytes at once, and a crash leaves no half file."""
        self._fs.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
        temporary = f"{path}.{uuid.uuid4().hex[:8]}.part"
        with self._fs.open(temporary, "wb") as file:
            file.write(data)
        self._fs.mv(temporary, path)

    def get(self, key: str) -> bytes:
        """The bytes of a key, checked against it."""
        path = self._path(key)
        if not self._fs.exists(path):
            raise NotFound(
                "stored bytes are missing", expected=f"a file for {key[:12]}…", hint="restore it from a backup"
            )
        with self._fs.open(path, "rb") as file:
            data = bytes(file.read())
        if hashlib.sha256(data).hexdigest() != key:
            raise CorruptData(
                "stored bytes are damaged", expected=f"SHA-256 {key[:12]}…", hint="restore the file from a backup"
            )
        return data

    def _path(self, key: str) -> str:
        return f"{self._root}/{key[:2]}/{key[2:]}"
