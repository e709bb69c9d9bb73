"""Restores a backup to a data folder with which a server can be started. The backup is verified first, and existing
data are never overwritten."""

from __future__ import annotations

import contextlib
import re
import shutil
import tarfile
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gss.domain.callbacks import no_progress
from gss.domain.errors import BadInput, Conflict, CorruptData, NotFound
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import ANCHORS, AnchorFile
from gss.operations.clock import Now
from gss.operations.upkeep.backup import POOL
from gss.operations.upkeep.backup_manifest import DATABASE, MANIFEST, SEAL, Manifest, read_manifest, sha256_of
from gss.store import commands
from gss.store import upkeep as store
from gss.store.blobs import BlobStore
from gss.store.dump import SQLITE, load
from gss.store.engine import Database, open_engine
from gss.store.migration import known_schemas, migrate

NEW_IDS = 1_000_000
"""Number of command ids that are skipped after a restore, because the device stores the ids of commands that were sent
after the backup."""
KEYS_ENDED = (
    "All sessions have ended, and one-time links and tokens are invalid. Users, roles and passwords are those of the backup. "
    "Later changes, for example disabled users, are lost: check Admin, People first."
)
"""Notice shown after a restore."""
MEMBER = re.compile(
    rf"(?:[0-9TZ-]+/(?:{MANIFEST}|{SEAL}|{'|'.join(DATABASE.values())})|{POOL}/[0-9a-f]{{2}}/[0-9a-f]{{62}})"
)
MAX_UNPACKED = 100
"""Maximum ratio of unpacked to packed size. Databases and captures compress by at most a factor of ten."""
SPARE_BYTES = 256 << 20
"""Disk space in bytes that must remain free after unpacking."""
PACKAGES = "instruments"
"""Folder of the instrument packages of the user in a data folder, the default of GSS_PACKAGES."""
OnStep = Callable[[str], None]


@dataclass(frozen=True)
class Restored:
    """A restored backup. ``folder``: data folder; ``files``: number of restored files."""

    manifest: Manifest
    folder: Path
    files: int


def restore(
    source: Path,
    into: Path,
    now: Now,
    *,
    database_url: str = "",
    blobs_url: str = "",
    audit_anchor: Path | None = None,
    on_step: OnStep = no_progress,
) -> Restored:
    """Restore a backup (a folder or a tar file) to an empty or new folder. A PostgreSQL backup is loaded into the empty
    database ``database_url``. Blobs are stored in ``blobs_url`` if it is given. ``audit_anchor``: anchor file of the
    audit log, if it is not in the data folder. Raises Conflict, CorruptData or BadInput before anything is restored."""
    into = into.resolve()
    if into.exists() and (not into.is_dir() or any(into.iterdir())):
        raise Conflict("the target folder is not empty", expected="an empty or new folder", got=str(into))
    home = source.resolve()
    home = home.parent if home.is_dir() and (home.parent / POOL).is_dir() else home
    if home in (into, *into.parents):
        raise Conflict("a backup cannot be restored into the backup folder", expected="another folder", got=str(into))
    with _opened(source, into.parent, on_step) as folder:
        manifest = read_manifest(folder)
        if manifest.schema not in known_schemas():
            raise BadInput(
                "the backup was created by a newer version of GSS",
                expected=f"a schema up to {known_schemas()[-1]}",
                got=manifest.schema,
                hint=f"install GSS {manifest.version} or newer",
            )
        if manifest.kind != SQLITE and not database_url:
            raise BadInput(
                "this is a backup of a PostgreSQL database", expected="GSS_DATABASE with the URL of an empty database"
            )
        on_step("Verifying")
        pool = _verified(folder, manifest)
        draft = into.with_name(f".{into.name}.restoring")
        shutil.rmtree(draft, ignore_errors=True)
        draft.mkdir(parents=True)
        try:
            on_step(f"Copying {len(manifest.blobs)} files")
            _fill(draft, folder, manifest, pool, blobs_url)
            url = f"sqlite:///{draft / 'gss.db'}"
            if manifest.kind != SQLITE:
                load(database_url, folder / manifest.database)
                url = database_url
            _make_ready(url, now)
            _accept_log(url, now, AnchorFile(audit_anchor or draft / ANCHORS), manifest.name)
            if into.exists():
                into.rmdir()
            draft.rename(into)
        except BaseException:  # an incomplete store must be removed, also after Ctrl-C
            shutil.rmtree(draft, ignore_errors=True)
            raise
    return Restored(manifest, into, len(manifest.blobs))


@contextlib.contextmanager
def _opened(source: Path, parent_folder: Path, on_step: OnStep) -> Iterator[Path]:
    """Yield the folder of a backup. A tar file is unpacked into a temporary folder in ``parent_folder``."""
    if source.is_dir():
        yield source
        return
    if not source.is_file():
        raise NotFound("the backup does not exist", got=str(source))
    parent_folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".gss-restore-", dir=parent_folder) as folder:
        on_step("Unpacking")
        yield _unpack(source, Path(folder))


def _unpack(source: Path, folder: Path) -> Path:
    name = ""
    max_bytes, free_bytes = MAX_UNPACKED * source.stat().st_size, shutil.disk_usage(folder).free - SPARE_BYTES
    remaining_bytes = min(max_bytes, free_bytes)
    try:
        with tarfile.open(source, "r|*") as tar:
            for member in tar:
                if member.issparse() or not member.isfile() or not MEMBER.fullmatch(member.name):
                    raise CorruptData(
                        "the file is not a backup", expected="only files of a backup", got=member.name[:100]
                    )
                remaining_bytes -= member.size
                if remaining_bytes < 0:
                    raise BadInput(
                        "the backup is too large when it is unpacked",
                        expected=f"at most {MAX_UNPACKED} times its file size, and {SPARE_BYTES >> 20} MiB of free disk space",
                        got=f"{member.size} bytes more for {member.name[:100]}",
                        hint="restore into a folder on a larger disk"
                        if free_bytes < max_bytes
                        else "use another copy, because GSS did not create this backup",
                    )
                if not member.name.startswith(f"{POOL}/"):
                    name = name or member.name.split("/")[0]
                path = folder / member.name
                path.parent.mkdir(parents=True, exist_ok=True)
                content = tar.extractfile(member)
                if content is not None:
                    with content, path.open("xb") as file:
                        shutil.copyfileobj(content, file)
    except (tarfile.TarError, EOFError, OSError) as error:
        raise CorruptData(
            "the backup's file cannot be unpacked",
            expected="a complete tar file, and a disk that can be written",
            got=str(error),
            hint="copy or download the backup again, and check the disk of the new folder",
        ) from error
    if not name:
        raise CorruptData("the file is not a backup", expected=MANIFEST, got=str(source))
    return folder / name


def _verified(folder: Path, manifest: Manifest) -> BlobStore:
    """Verify the hashes of the database and all blobs. Return the pool of blobs."""
    if not (folder / manifest.database).is_file():
        raise CorruptData("the backup's database is missing", expected=manifest.database, got=str(folder))
    if sha256_of(folder / manifest.database) != manifest.database_sha256:
        raise CorruptData("the backup's database is damaged", expected=f"SHA-256 {manifest.database_sha256[:12]}…")
    if not (folder.parent / POOL).is_dir() and manifest.blobs:
        raise CorruptData(
            "files of the backup are missing", expected=f"a folder {POOL} beside it", got=str(folder.parent)
        )
    pool = BlobStore(str(folder.parent / POOL)) if manifest.blobs else BlobStore(tempfile.gettempdir())
    for key in manifest.blobs:
        pool.get(key)  # checks the hash
    return pool


def _fill(draft: Path, folder: Path, manifest: Manifest, pool: BlobStore, blobs_url: str) -> None:
    if manifest.kind == SQLITE:
        shutil.copyfile(folder / manifest.database, draft / "gss.db")
    captures, packages = set(manifest.captures.values()), set(manifest.packages.values())
    target = BlobStore(blobs_url or str(draft / "blobs"))
    for key in manifest.blobs:
        if key not in captures | packages:
            target.put(pool.get(key))
    (draft / "captures").mkdir()
    for name, key in manifest.captures.items():
        (draft / "captures" / name).write_bytes(pool.get(key))
    for name, key in manifest.packages.items():
        path = draft / PACKAGES / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pool.get(key))


def _accept_log(url: str, now: Now, anchors: AnchorFile, name: str) -> None:
    """Begin a new anchor file. The restored log does not contain the rows after the backup, and the old anchors would
    report them as missing."""
    database = Database(open_engine(url))
    try:
        AuditService(database, now, anchors).accept("restore", f"restored from backup {name}")
    finally:
        database.close()


def _make_ready(url: str, now: Now) -> None:
    """Migrate the database to the latest schema, skip command ids that may have been used after the backup, and
    invalidate all sessions, links and tokens, because revocations after the backup are unknown."""
    migrate(url)
    database = Database(open_engine(url))
    try:
        with database.unit_of_work() as session:
            commands.skip_request_ids(session, NEW_IDS, now())
            store.close_keys(session, now(), "restored from a backup")
    finally:
        database.close()
