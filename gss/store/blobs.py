"""Content-addressed storage of pixels and flash images: bytes are stored under their hash, so equal content is stored
once and no user-chosen name reaches the disk. In a folder, or in an object store by URL (``s3://bucket/prefix``)."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from gss.domain.errors import BadInput, CorruptData, GssError, NotFound, StoreDown

TIMEOUT_S = 20.0
"""An object store that does not respond within this time counts as down."""
ATTEMPTS = 2


class BlobStore:
    """Content-addressed bytes under an fsspec URL (a folder by default).

    An object store's credentials, region and endpoint come from the environment (``AWS_ACCESS_KEY_ID``,
    ``AWS_SECRET_ACCESS_KEY``, ``AWS_DEFAULT_REGION``, ``AWS_ENDPOINT_URL_S3``), never from the URL, which is shown and logged.
    """

    def __init__(self, url: str, timeout_s: float = TIMEOUT_S) -> None:
        if "@" in url.partition("://")[2].partition("/")[0]:
            raise BadInput(
                "the URL of the blobs holds credentials", expected="s3://bucket/prefix", hint="AWS_* in the environment"
            )
        try:
            self._fs, root = fsspec.core.url_to_fs(url, **_options(url, timeout_s))
        except ImportError as error:
            raise BadInput(
                "this kind of blob store is not installed", got=str(error), hint="pip install 'gss-startracker[s3]'"
            ) from None
        self._root = str(root).rstrip("/")
        self._is_folder = isinstance(self._fs, LocalFileSystem)
        if hasattr(self._fs, "retries"):
            self._fs.retries = ATTEMPTS  # s3fs retries each request; its default of five would block a page for minutes
        if self._is_folder:
            self._fs.makedirs(self._root, exist_ok=True)
        else:
            self._reach_bucket()

    def _reach_bucket(self) -> None:
        """Check the bucket at startup, so that a wrong address is reported before the first frame. Buckets are never created."""
        bucket = self._root.partition("/")[0]
        with self._reached():
            there = bool(self._fs.exists(bucket))
        if not there and self._fs.protocol != "memory":
            raise StoreDown(
                "the blob store cannot be reached",
                expected=f"a bucket {bucket!r} that may be listed",
                hint="make the bucket; look at AWS_ENDPOINT_URL_S3 and the credentials in the environment",
            )

    def put(self, data: bytes | memoryview) -> str:
        """Store ``data`` and return its key, the SHA-256 in hex."""
        key = hashlib.sha256(data).hexdigest()
        path = self._path(key)
        with self._reached():
            if not self._is_folder:
                # Writing an object is atomic, and writing the same bytes again costs no more than reading them to
                # compare.
                self._fs.pipe_file(path, bytes(data))
            elif not self._holds(path, data):
                self._write(path, data)
        return key

    def _holds(self, path: str, data: bytes | memoryview) -> bool:
        """True if the file exists and is intact. A damaged file is replaced by the next copy of its content."""
        if not self._fs.exists(path) or self._fs.size(path) != len(data):
            return False
        with self._fs.open(path, "rb") as file:
            return bool(file.read() == data)

    def _write(self, path: str, data: bytes | memoryview) -> None:
        """Write to a temporary name, then rename: two requests may write the same bytes at once, and a crash must not
        leave a partial file."""
        self._fs.makedirs(path.rsplit("/", 1)[0], exist_ok=True)
        temporary = f"{path}.{uuid.uuid4().hex[:8]}.part"
        with self._fs.open(temporary, "wb") as file:
            file.write(data)
        self._fs.mv(temporary, path)

    def get(self, key: str) -> bytes:
        """Return the bytes of a key, verified against it. NotFound if missing, CorruptData if damaged."""
        try:
            with self._reached():
                data: bytes = self._fs.cat_file(self._path(key))
        except FileNotFoundError:
            raise _missing(key) from None
        if hashlib.sha256(data).hexdigest() != key:
            raise CorruptData(
                "stored bytes are damaged", expected=f"SHA-256 {key[:12]}…", hint="restore the file from a backup"
            )
        return data

    def exists(self, key: str) -> bool:
        """True if the key exists. Its content is not read."""
        with self._reached():
            return bool(self._fs.exists(self._path(key)))

    def size(self, key: str) -> int:
        """Return the size in bytes from the store's metadata. NotFound if missing."""
        try:
            with self._reached():
                return int(self._fs.size(self._path(key)))
        except FileNotFoundError:
            raise _missing(key) from None

    def delete(self, key: str) -> None:
        """Delete a key; no error if it does not exist."""
        try:
            with self._reached():
                self._fs.rm_file(self._path(key))
        except FileNotFoundError:
            return

    def keys(self) -> Iterator[str]:
        """Yield every key, in order; only 1/256 of the names are in memory at a time. Partially written files have no key."""
        try:
            with self._reached():
                parts = [str(name).rstrip("/").rsplit("/", 1)[1] for name in self._fs.ls(self._root, detail=False)]
        except FileNotFoundError:  # a prefix without objects
            return
        for part in sorted(part for part in parts if len(part) == 2):
            with self._reached():
                names = self._fs.find(f"{self._root}/{part}")
            for name in sorted(names):
                rest = name.rsplit("/", 1)[1]
                if len(rest) == 62 and "." not in rest:
                    yield part + rest

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """Convert storage errors to StoreDown; a missing object stays FileNotFoundError."""
        try:
            yield
        except (FileNotFoundError, GssError):
            raise
        except OSError as error:
            hint = (
                "look at disk space and permissions" if self._is_folder else "look at the store, its network and rights"
            )
            raise StoreDown("the bytes cannot be stored or read now", got=str(error)[:300], hint=hint) from error
        except Exception as error:  # each object store's client has its own exception classes
            if self._is_folder:
                raise
            text = f"{type(error).__name__}: {error}"[:300]
            raise StoreDown(
                "the blob store does not answer", got=text, hint="look at the store and its network"
            ) from error

    def _path(self, key: str) -> str:
        return f"{self._root}/{key[:2]}/{key[2:]}"


def _missing(key: str) -> NotFound:
    return NotFound("stored bytes are missing", expected=f"a file for {key[:12]}…", hint="restore it from a backup")


def _options(url: str, timeout_s: float) -> dict[str, Any]:
    """Return the fsspec options: no listing cache, because other processes write too; short timeouts, so that an
    unresponsive store does not block a request for minutes."""
    if not url.startswith(("s3://", "s3a://")):
        return {}
    waits = {"connect_timeout": min(5.0, timeout_s), "read_timeout": timeout_s, "retries": {"total_max_attempts": 1}}
    return {"use_listings_cache": False, "config_kwargs": waits}
