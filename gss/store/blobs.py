"""Content-addressed storage of pixels and flash images in a folder or an object store (``s3://bucket/prefix``).

The bytes are stored under their hash, so equal content is stored once and no user-chosen name reaches the disk. The
hash is calculated from the plain bytes. A file contains the compressed bytes if compression saves space, otherwise the
plain bytes. All files of versions before 0.5 contain plain bytes.
"""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TypeVar

import fsspec
from fsspec.implementations.local import LocalFileSystem

from gss.domain.errors import BadInput, CorruptData, GssError, NotFound, StoreDown
from gss.store.compression import compressed, decompressed
from gss.store.deadline import DeadlineCalls
from gss.store.durable import sync_path

TIMEOUT_S = 20.0
"""Time without a response after which an object store is treated as down. The limit of a complete request is twice this
time, plus ``MARGIN_S``, plus one second per megabyte."""
SLOWEST_BYTES_S = 1e6
MARGIN_S = 5.0
MAX_READ_S = 40.0
"""Additional time limit of a read, because the size of its result is unknown in advance."""
ATTEMPTS = 2
T = TypeVar("T")


class BlobStore:
    """Content-addressed bytes under an fsspec URL (a folder by default).

    An object store's credentials, region and endpoint come from the environment (``AWS_ACCESS_KEY_ID``,
    ``AWS_SECRET_ACCESS_KEY``, ``AWS_DEFAULT_REGION``, ``AWS_ENDPOINT_URL_S3``), never from the URL, because the URL is
    displayed and logged.
    """

    def __init__(self, url: str, timeout_s: float = TIMEOUT_S) -> None:
        if "@" in url.partition("://")[2].partition("/")[0]:
            raise BadInput(
                "the URL of the blob store contains credentials",
                expected="s3://bucket/prefix",
                hint="set the credentials with AWS_* in the environment",
            )
        try:
            self._fs, root = fsspec.core.url_to_fs(url, **_options(url, timeout_s))
        except ImportError as error:
            raise BadInput(
                "the library of this blob store is not installed",
                got=str(error),
                hint="run pip install 'gss-startracker[s3]'",
            ) from None
        self._root = str(root).rstrip("/")
        self._is_folder = isinstance(self._fs, LocalFileSystem)
        self._calls = DeadlineCalls(2 * timeout_s + MARGIN_S)
        if hasattr(self._fs, "retries"):
            self._fs.retries = ATTEMPTS  # five retries, the default of s3fs, would block a page for minutes
        if self._is_folder:
            if not self._fs.exists(self._root):  # a copied folder can be read-only
                self._fs.makedirs(self._root, exist_ok=True)
        else:
            self._reach_bucket()

    def _reach_bucket(self) -> None:
        """Check at startup that the bucket exists, so that a wrong address is reported before the first frame. Buckets
        are never created."""
        bucket = self._root.partition("/")[0]
        with self._storage_errors():
            exists = self._call(lambda: bool(self._fs.exists(bucket)))
        if not exists and self._fs.protocol != "memory":
            raise StoreDown(
                "the blob store cannot be reached",
                expected=f"a readable bucket {bucket!r}",
                hint="create the bucket; check AWS_ENDPOINT_URL_S3 and the credentials in the environment",
            )

    def put(self, data: bytes | memoryview, item_bytes: int = 1) -> str:
        """Store ``data`` and return its key, the SHA-256 in hex. ``item_bytes``: size of a number in ``data``, used for
        better compression."""
        key = hashlib.sha256(data).hexdigest()
        path = self._path(key)
        with self._storage_errors():
            if not self._is_folder:
                # An existing object is written again, because the write is atomic and takes no longer than a read for
                # comparison.
                content = compressed(data, item_bytes) or bytes(data)
                self._call(lambda: self._fs.pipe_file(path, content), len(content) / SLOWEST_BYTES_S)
            elif not self._has_intact(path, data):
                self._write(path, compressed(data, item_bytes) or data)
        return key

    def _has_intact(self, path: str, data: bytes | memoryview) -> bool:
        """True if the file exists and is intact. Storing the same content again replaces a damaged file."""
        if not self._fs.exists(path):
            return False
        with self._fs.open(path, "rb") as file:
            content = file.read()
        return bool(content == data or decompressed(content) == data)

    def _write(self, path: str, data: bytes | memoryview) -> None:
        """Write to a temporary file, then rename it. Two requests can write the same bytes at the same time, and a
        crash must not leave a partial file. The file and its folder entry are flushed to the disk before the function
        returns, so that no row refers to a missing file."""
        folder = path.rsplit("/", 1)[0]
        is_new = not self._fs.exists(folder)
        self._fs.makedirs(folder, exist_ok=True)
        temporary = f"{path}.{uuid.uuid4().hex[:8]}.part"
        with self._fs.open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self._fs.mv(temporary, path)
        for changed in (folder, self._root) if is_new else (folder,):
            sync_path(changed)

    def get(self, key: str) -> bytes:
        """Return the bytes of a key after verification of their hash. Raises NotFound if they are missing, CorruptData
        if damaged."""
        try:
            with self._storage_errors():
                data = self._read(self._path(key))
        except FileNotFoundError:
            raise _missing(key) from None
        plain = decompressed(data)
        if plain is not None and hashlib.sha256(plain).hexdigest() == key:
            return plain
        if hashlib.sha256(data).hexdigest() != key:  # plain content can start with the same bytes as compressed content
            raise CorruptData(
                "stored bytes are damaged", expected=f"SHA-256 {key[:12]}…", hint="restore the file from a backup"
            )
        return data

    def _read(self, path: str) -> bytes:
        """Return the content of a file. Raises FileNotFoundError."""
        if self._is_folder:  # without the layers of fsspec, which take as long as the read
            return Path(path).read_bytes()
        return bytes(self._call(lambda: self._fs.cat_file(path), MAX_READ_S))

    def exists(self, key: str) -> bool:
        """True if the key exists. Its content is not read."""
        with self._storage_errors():
            return self._call(lambda: bool(self._fs.exists(self._path(key))))

    def size(self, key: str) -> int:
        """Return the size in the store in bytes, from the metadata. Raises NotFound if the key is missing."""
        try:
            with self._storage_errors():
                return self._call(lambda: int(self._fs.size(self._path(key))))
        except FileNotFoundError:
            raise _missing(key) from None

    def delete(self, key: str) -> None:
        """Delete a key. A missing key is not an error."""
        try:
            with self._storage_errors():
                self._call(lambda: self._fs.rm_file(self._path(key)))
        except FileNotFoundError:
            return

    def keys(self) -> Iterator[str]:
        """Yield all keys in ascending order. Only 1/256 of the names are in memory at a time. Partially written files
        are omitted."""
        try:
            with self._storage_errors():
                folders = self._call(lambda: self._fs.ls(self._root, detail=False))
                parts = [str(name).rstrip("/").rsplit("/", 1)[1] for name in folders]
        except FileNotFoundError:  # a prefix without objects
            return
        for part in sorted(part for part in parts if len(part) == 2):
            with self._storage_errors():
                names = self._call(partial(self._fs.find, f"{self._root}/{part}"))
            for name in sorted(names):
                base_name = name.rsplit("/", 1)[1]
                if len(base_name) == 62 and "." not in base_name:
                    yield part + base_name

    def check(self) -> str:
        """Return the type of the store, or a text that confirms that the object store responds. Raises StoreDown if it
        does not respond."""
        if self._is_folder:
            return "a folder"
        self._reach_bucket()
        return "the object store responds"

    def _call(self, work: Callable[[], T], extra_s: float = 0.0) -> T:
        """Run a request to the store. Requests to an object store have a deadline."""
        return work() if self._is_folder else self._calls.run(work, extra_s)

    @contextmanager
    def _storage_errors(self) -> Iterator[None]:
        """Convert storage errors to StoreDown. FileNotFoundError for a missing object is not converted."""
        try:
            yield
        except (FileNotFoundError, GssError):
            raise
        except OSError as error:
            hint = (
                "check disk space and permissions"
                if self._is_folder
                else "check the store, its network and permissions"
            )
            raise StoreDown("the blob store cannot be read or written", got=str(error)[:300], hint=hint) from error
        except Exception as error:  # each object store's client has its own exception classes
            if self._is_folder:
                raise
            text = f"{type(error).__name__}: {error}"[:300]
            raise StoreDown(
                "no response from the blob store", got=text, hint="check the store and its network"
            ) from error

    def _path(self, key: str) -> str:
        return f"{self._root}/{key[:2]}/{key[2:]}"


def _missing(key: str) -> NotFound:
    return NotFound("stored bytes are missing", expected=f"a file for {key[:12]}…", hint="restore it from a backup")


def _options(url: str, timeout_s: float) -> dict[str, object]:
    """Return the fsspec options. The listing cache is off, because other processes also write. Timeouts are short, so
    that an unresponsive store does not block a request for minutes."""
    if not url.startswith(("s3://", "s3a://")):
        return {}
    timeouts = {"connect_timeout": min(5.0, timeout_s), "read_timeout": timeout_s, "retries": {"total_max_attempts": 1}}
    return {"use_listings_cache": False, "config_kwargs": timeouts}
