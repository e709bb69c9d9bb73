"""Manifest of a backup: the copy of the database, and the hashes of its blobs, raw captures and instrument packages."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput, CorruptData, NotFound
from gss.instruments.registry import is_installed_file

FORMAT = "gss-backup 1"
MANIFEST, SEAL = "manifest.json", "manifest.sha256"
NAME = re.compile(r"\d{4}-\d\d-\d\dT\d{6}Z(-\d+)?")
SHA256 = re.compile(r"[0-9a-f]{64}")
CAPTURE = re.compile(r"contact-\d+-\d+\.raw")
DATABASE = {"sqlite": "gss.db", "postgresql": "gss.sql"}
BLOCK = 1 << 20


@dataclass(frozen=True)
class Manifest:
    """Content of a backup. ``blobs``: size in bytes by hash; ``captures``: hash by file name; ``packages``: hash by path
    of the installed instrument packages; ``schema``: migration of the database."""

    name: str
    created: str
    version: str
    schema: str
    kind: str
    database_bytes: int
    database_sha256: str
    blobs: dict[str, int] = field(default_factory=dict)
    captures: dict[str, str] = field(default_factory=dict)
    packages: dict[str, str] = field(default_factory=dict)
    format: str = FORMAT

    @property
    def database(self) -> str:
        """Name of the database's file."""
        return DATABASE[self.kind]

    @property
    def total_bytes(self) -> int:
        """Total bytes of the database and the blobs."""
        return self.database_bytes + sum(self.blobs.values())

    def write(self, folder: Path) -> None:
        """Write the manifest and its own hash into a folder."""
        data = json.dumps(asdict(self), indent=1, sort_keys=True).encode()
        (folder / MANIFEST).write_bytes(data)
        (folder / SEAL).write_text(hashlib.sha256(data).hexdigest() + f"  {MANIFEST}\n")


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest in the folder of a backup. Raises NotFound if it is missing, CorruptData if it was changed,
    and BadInput if it has another format."""
    if not (folder / MANIFEST).is_file() or not (folder / SEAL).is_file():
        raise NotFound("the folder is not a backup", expected=f"{MANIFEST} and {SEAL}", got=str(folder))
    data = (folder / MANIFEST).read_bytes()
    if (folder / SEAL).read_bytes().split()[:1] != [hashlib.sha256(data).hexdigest().encode()]:
        raise CorruptData("the backup's manifest was changed", expected="the hash beside it", got=str(folder))
    try:
        record = json.loads(data)
        if record.get("format") != FORMAT:
            raise BadInput("the backup has another format", expected=FORMAT, got=str(record.get("format"))[:40])
        manifest = Manifest(**record)
        _check_kinds(manifest)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise CorruptData("the backup's manifest cannot be read", got=str(error)[:200]) from None
    # The names are used as paths, so their format must be checked.
    files = {**manifest.captures, **manifest.packages}
    keys = [*manifest.blobs, manifest.database_sha256, *files.values()]
    if manifest.kind not in DATABASE or not all(SHA256.fullmatch(key) for key in keys):
        raise CorruptData("the manifest of the backup contains an invalid hash", got=str(folder))
    names_are_valid = (
        NAME.fullmatch(manifest.name)
        and all(CAPTURE.fullmatch(name) for name in manifest.captures)
        and all(is_installed_file(name) for name in manifest.packages)
    )
    if not names_are_valid:
        raise CorruptData("the manifest of the backup contains an invalid file name", got=str(folder))
    if not set(files.values()) <= set(manifest.blobs):
        raise CorruptData("files named in the manifest are missing from the backup", got=str(folder))
    return manifest


def _check_kinds(manifest: Manifest) -> None:
    """Raise TypeError or ValueError if a JSON value has the wrong type."""
    text_fields = (
        manifest.name,
        manifest.created,
        manifest.version,
        manifest.schema,
        manifest.kind,
        manifest.database_sha256,
    )
    numbers = (manifest.database_bytes, *manifest.blobs.values())
    tables = (manifest.blobs, manifest.captures, manifest.packages)
    texts = (*text_fields, *manifest.captures.values(), *manifest.packages.values())
    if not all(isinstance(v, str) for v in texts) or not all(isinstance(v, int) and v >= 0 for v in numbers):
        raise TypeError("a text or number has the wrong type")
    if not all(isinstance(table, dict) for table in tables):
        raise TypeError("a table has the wrong type")
    datetime.fromisoformat(manifest.created)


def sha256_of(file: Path | BinaryIO, each: Callable[[], None] = no_progress) -> str:
    """Return the hash of a file. ``each``: called between blocks; raises an exception to cancel."""
    if isinstance(file, Path):
        with file.open("rb") as opened:
            return sha256_of(opened, each)
    digest = hashlib.sha256()
    while block := file.read(BLOCK):
        digest.update(block)
        each()
    return digest.hexdigest()
