"""Backups of a running server: a consistent copy of the database, of all blobs that it references, and of the instrument
packages of the user.

Each backup is a folder with a copy of the database and a manifest. Frames, images and captures are stored as files
named by their hashes in a folder that all backups share, so that each backup copies only new files. A backup is atomic:
it is written under a temporary name and renamed after all data are on disk.
"""

from __future__ import annotations

import io
import os
import shutil
import tarfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

from gss import __version__
from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput, CorruptData, GssError, NotFound
from gss.instruments.registry import installed_files
from gss.operations.clock import Now, iso_z
from gss.operations.events import EventBus
from gss.operations.folder_lock import named_lock, own_folder
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService, Progress
from gss.operations.line.capture_files import capture_files, open_capture, plain_name
from gss.operations.upkeep.backup_manifest import (
    BLOCK,
    DATABASE,
    MANIFEST,
    NAME,
    SEAL,
    Manifest,
    read_manifest,
    sha256_of,
)
from gss.operations.upkeep.clock_trust import BEHIND, ClockTrust
from gss.operations.upkeep.disk import BackupDisk
from gss.operations.upkeep.retention_policy import stored_policy
from gss.store import upkeep as store
from gss.store.blobs import BlobStore
from gss.store.dump import dump, kind_of
from gss.store.engine import Database
from gss.store.models import Job

POOL = "blobs"
"""Folder of the files that all backups share."""
UNFINISHED = ".unfinished"
BUSY = "another backup or removal is running"


@dataclass(frozen=True)
class BackupJob(JobRequest):
    """Request for a backup. ``keep``: number of latest backups to keep afterwards, 0: all."""

    keep: int = 0


class BackupService:
    """Creates, lists, exports and removes backups."""

    def __init__(
        self,
        database: Database,
        url: str,
        blobs: BlobStore,
        captures: Path,
        packages: Path,
        folder: Path,
        lock: Path,
        disk: BackupDisk,
        jobs: JobService,
        bus: EventBus,
        now: Now,
        trust: ClockTrust,
    ) -> None:
        self._trust = trust
        self._database, self._url, self._blobs = database, url, blobs
        self._captures, self._packages = captures, packages
        self._folder, self._lock, self.disk = folder, lock, disk
        self._jobs, self._bus, self._now = jobs, bus, now
        jobs.register(JobKind("backup", BackupJob, self._job, renewed=self._renewed))

    @property
    def folder(self) -> Path:
        """Folder of the backups."""
        return self._folder

    def start(self, *, keep: int = 0, user: str) -> Job:
        """Start a backup as a job. ``keep``: number of latest backups to keep afterwards, 0: all."""
        self._check_room()
        return self._jobs.begin("backup", "backup", BackupJob(keep, user=user))

    def _renewed(self, request: BackupJob) -> BackupJob:
        return replace(request, keep=stored_policy(self._database).backups_keep)

    def _job(self, request: BackupJob, run: JobRun) -> JobResult:
        if run.checkpoint:  # the backup was complete before the server stopped
            return run.checkpoint
        backup = self.make(run.progress)
        result = {"name": backup.name, "bytes": backup.total_bytes, "blobs": len(backup.blobs)}
        run.keep(result)
        removed = self.prune(request.keep, backup.name) if request.keep else []
        self._bus.record("upkeep", "ok", f"{request.user} created backup {backup.name}", **result)
        return result | {"removed": removed}

    def _check_room(self) -> None:
        """Raise StoreDown if the disk has no room for the database. The size of new blobs is not known in advance."""
        with self._database.unit_of_work() as session:
            needed_bytes = store.database_bytes(session)
        self.disk.check("a backup", needed_bytes)

    def make(self, progress: Progress = no_progress) -> Manifest:
        """Create a backup now. The database is copied before the blobs that it references, because blobs are stored
        before their rows. Raises StoreDown if the disk is too full."""
        self._folder.mkdir(parents=True, exist_ok=True)
        with named_lock(self._lock, BUSY):
            self._close_earlier()
            for unfinished in self._folder.glob(f"*{UNFINISHED}"):
                shutil.rmtree(unfinished)
            self._check_room()
            at = self._now()
            name = self._unused_name(at)
            draft = self._folder / f"{name}{UNFINISHED}"
            draft.mkdir()
            manifest = self._fill(draft, name, at, progress)
            manifest.write(draft)
            _sync(draft)
            draft.rename(self._folder / name)
            _sync(self._folder)
        return manifest

    def _close_earlier(self) -> None:
        """Close the backups of earlier versions that are open to all users. The permissions of the parent folder are not changed,
        because it can contain other files."""
        for folder in self._folder.iterdir():
            if folder.name == POOL or NAME.fullmatch(folder.name):
                own_folder(folder)

    def _fill(self, draft: Path, name: str, at: datetime, progress: Progress) -> Manifest:
        kind = kind_of(self._url)
        file = draft / DATABASE[kind]
        progress(0, 0, "Copying the database")
        with self._database.unit_of_work() as session:
            schema = store.schema_version(session)
            # References are read before and after the dump, so that blobs added or released during the dump are also copied.
            hashes_before = {r.sha256 for r in store.references(session)}
        dump(self._url, file)
        with self._database.unit_of_work() as session:
            hashes = hashes_before | {r.sha256 for r in store.references(session)}
        pool, copied = BlobStore(str(self._folder / POOL)), {}
        captures = capture_files(self._captures)
        total = len(hashes) + len(captures)
        for k, key in enumerate(sorted(hashes)):
            progress(k, total, f"{k} of {total} files")
            size = self._copy(pool, key)
            if size is not None:
                copied[key] = size
        capture_keys: dict[str, str] = {}
        for k, path in enumerate(captures, len(hashes)):
            progress(k, total, f"{k} of {total} files")
            try:
                with open_capture(path) as capture:
                    data = capture.read()
            except FileNotFoundError:  # the line removes the oldest captures when it writes new captures
                continue
            key = capture_keys[plain_name(path)] = pool.put(data)
            copied[key] = len(data)
        package_keys: dict[str, str] = {}
        for name_in_folder, path in installed_files(self._packages).items():
            data = path.read_bytes()
            key = package_keys[name_in_folder] = pool.put(data)
            copied[key] = len(data)
        progress(total, total, "Writing the manifest")
        self._sync_pool(copied)
        return Manifest(
            name,
            iso_z(at),
            __version__,
            schema,
            kind,
            file.stat().st_size,
            sha256_of(file),
            copied,
            capture_keys,
            package_keys,
        )

    def _copy(self, pool: BlobStore, key: str) -> int | None:
        """Copy a blob into the pool and return its size. Return None if the source is missing or damaged; the store
        check reports such blobs. Raises StoreDown if the blob store does not respond, because the blob can then be
        intact. Blobs that an earlier backup copied are read and verified, to detect disk errors."""
        if pool.exists(key):
            try:
                return len(pool.get(key))
            except CorruptData:
                self._bus.record(
                    "upkeep", "warning", f"File {key[:12]}… was damaged in the backups and has been copied again"
                )
        self.disk.check("a backup")
        try:
            data = self._blobs.get(key)
        except (NotFound, CorruptData) as error:
            self._bus.record("upkeep", "warning", f"A file is missing from the backup: {error}")
            return None
        pool.put(data)
        return len(data)

    def _sync_pool(self, keys: Iterable[str]) -> None:
        """Flush blobs to disk, before the manifest that names them is written."""
        pool = self._folder / POOL
        files = [pool / key[:2] / key[2:] for key in keys]
        for path in [*files, *{file.parent for file in files}, pool]:
            _sync_one(path)

    def _unused_name(self, at: datetime) -> str:
        name, k = f"{at:%Y-%m-%dT%H%M%SZ}", 1
        while (self._folder / name).exists():
            name, k = f"{at:%Y-%m-%dT%H%M%SZ}-{k}", k + 1
        return name

    # --- existing backups ---------------------------------------------------------------------------------------

    def list_all(self) -> list[Manifest]:
        """Return all complete backups, latest first."""
        backups = []
        for folder in sorted(self._folder.glob("*"), reverse=True):
            if folder.is_dir() and NAME.fullmatch(folder.name):
                try:
                    backups.append(read_manifest(folder))
                except GssError:
                    continue
        return backups

    def newest_at(self) -> datetime | None:
        """Return the time of the latest backup, without backups dated in the future; None if there is no backup."""
        return max((datetime.fromisoformat(manifest.created) for manifest in self._dated()), default=None)

    def _dated(self) -> list[Manifest]:
        """Return the backups that are not dated in the future, latest first."""
        latest = self._now() + BEHIND
        return [manifest for manifest in self.list_all() if datetime.fromisoformat(manifest.created) <= latest]

    def get(self, name: str) -> Manifest:
        """Return the backup with that name. Raises BadInput or NotFound."""
        if not NAME.fullmatch(name):
            raise BadInput("this is not the name of a backup", expected="2026-12-01T180000Z", got=name[:40])
        if not (self._folder / name).is_dir():
            raise NotFound("there is no backup with this name", got=name)
        return read_manifest(self._folder / name)

    def prune(self, keep: int, just_made: str) -> list[str]:
        """Remove all backups except the latest ``keep``, which include ``just_made``, and the blobs that no remaining
        backup needs. Does not remove anything while the clock is in doubt. Backups dated in the future are neither
        counted nor removed. If a manifest in the folder of backups cannot be read, no blobs are removed."""
        doubt = self._trust.state().doubt
        if doubt:
            self._bus.record("upkeep", "warning", f"Old backups were not removed: the server's clock is {doubt}")
            return []
        with named_lock(self._lock, BUSY):
            others = [manifest.name for manifest in self._dated() if manifest.name != just_made]
            expired = others[max(0, keep - 1) :]
            for name in expired:
                shutil.rmtree(self._folder / name)
            needed: set[str] = set()
            for file in self._folder.glob(f"*/{MANIFEST}"):  # also of backups that were renamed
                try:
                    needed |= read_manifest(file.parent).blobs.keys()
                except (GssError, OSError) as error:
                    text = f"No files of backups were removed: backup {file.parent.name} cannot be read: {error}"
                    self._bus.record("upkeep", "warning", text)
                    return expired
            pool = BlobStore(str(self._folder / POOL))
            for key in list(pool.keys()):
                if key not in needed:
                    pool.delete(key)
        return expired

    def archive(self, name: str) -> Iterator[bytes]:
        """Yield one backup as a tar file in blocks of at most 1 MiB, in the format that ``gss restore`` reads."""
        manifest, folder = self.get(name), self._folder / name
        pool, at = BlobStore(str(self._folder / POOL)), datetime.fromisoformat(manifest.created)
        for file in (MANIFEST, SEAL, manifest.database):
            with (folder / file).open("rb") as content:
                yield from _tar_member(f"{name}/{file}", content, at)
        for key in sorted(manifest.blobs):
            yield from _tar_member(f"{POOL}/{key[:2]}/{key[2:]}", io.BytesIO(pool.get(key)), at)
        yield bytes(2 * tarfile.BLOCKSIZE)


def _tar_member(name: str, content: BinaryIO, at: datetime) -> Iterator[bytes]:
    """Yield a member of a tar file that only the owner can read: header, content and padding."""
    member = tarfile.TarInfo(name)
    member.size, member.mode, member.mtime = content.seek(0, io.SEEK_END), 0o600, int(at.timestamp())
    yield member.tobuf(tarfile.PAX_FORMAT)
    content.seek(0)
    while block := content.read(BLOCK):
        yield block
    yield bytes(-member.size % tarfile.BLOCKSIZE)


def _sync(folder: Path) -> None:
    """Flush a folder's entries and files to disk."""
    for path in [*folder.glob("*"), folder]:
        if path.is_file() or path == folder:
            _sync_one(path)


def _sync_one(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
