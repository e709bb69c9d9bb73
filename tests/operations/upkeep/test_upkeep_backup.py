"""Backups are complete or absent, verified before a restore, and usable by a server afterwards."""

from __future__ import annotations

import hashlib
import json
import shutil
import tarfile
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from sqlalchemy import select

from gss.domain.errors import BadInput, Conflict, CorruptData, GssError, NotFound, StoreDown
from gss.instruments.package_source import read_folder
from gss.instruments.registry import SHIPPED, Registry
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import ANCHORS, AnchorFile
from gss.operations.jobs import Cancelled
from gss.operations.upkeep import backup
from gss.operations.upkeep.check_store import check_store
from gss.operations.upkeep.restore import NEW_IDS, restore
from gss.store import commands
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.models import ApiToken, Event, Frame, OneTimeLink, SignIn, User


def rows(database) -> list[tuple[int, str]]:
    with database.unit_of_work() as session:
        return [(f.id, f.sha256) for f in session.scalars(select(Frame).order_by(Frame.id))]


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def open_database(folder: Path) -> Database:
    return Database(open_engine(f"sqlite:///{folder / 'gss.db'}"))


def test_a_backup_is_restored_completely(store, clock, tmp_path):
    """A restored store has the same rows, blobs and captures as the original, and passes the check of the store."""
    store.fill()
    made = store.backups.make()
    done = restore(tmp_path / "backups" / made.name, tmp_path / "new", clock)
    database = open_database(tmp_path / "new")
    assert rows(database) == rows(store.database)
    blobs = BlobStore(str(tmp_path / "new" / "blobs"))
    audit = AuditService(database, clock, AnchorFile(tmp_path / "new" / ANCHORS))
    assert check_store(database, blobs, tmp_path / "new" / "captures", audit).whole
    assert "restored from backup" in audit.verify().anchors
    assert done.files == len(made.blobs) == 7
    (capture,) = (tmp_path / "captures").glob("*.raw")
    assert (tmp_path / "new" / "captures" / capture.name).read_bytes() == capture.read_bytes()
    database.close()


def test_instrument_packages_of_the_user_are_in_the_backup(store, clock, tmp_path):
    """A restored installation has the user's packages with their earlier versions, but no file that is not part of a
    package. A manifest that names another path is rejected."""
    registry = Registry(tmp_path / "instruments")
    files = {**read_folder(SHIPPED / "nos3")}
    files["instrument.yaml"] = files["instrument.yaml"].replace(b"id: nos3", b"id: mine")
    first = registry.add(files)
    files["instrument.yaml"] = files["instrument.yaml"].replace(b"title: ", b"title: New ")
    second = registry.add(files)
    (tmp_path / "instruments" / "mine" / ".swp").write_bytes(b"editor")
    made = store.backups.make()
    done = restore(tmp_path / "backups" / made.name, tmp_path / "new", clock)
    restored = Registry(tmp_path / "new" / "instruments")
    assert restored.versions("mine") == (second.version, first.version)
    assert restored.version("mine", first.version).dictionary == first.dictionary
    assert not (tmp_path / "new" / "instruments" / "mine" / ".swp").exists()
    assert done.files == len(made.blobs) == len(made.packages)
    outside = replace(made, packages={"mine/../../escape": next(iter(made.blobs))})
    outside.write(tmp_path / "backups" / made.name)
    with pytest.raises(CorruptData, match="invalid file name"):
        restore(tmp_path / "backups" / made.name, tmp_path / "other", clock)


def test_command_ids_after_a_restore_are_above_all_used_ones(store, clock, tmp_path):
    """After a restore, command ids start at a higher number, because the backup lacks commands that were sent later and
    the device would return their stored results."""
    made = store.backups.make()
    restore(tmp_path / "backups" / made.name, tmp_path / "new", clock)
    database = open_database(tmp_path / "new")
    with database.unit_of_work() as session:
        assert commands.last_request_id(session) == NEW_IDS
    database.close()


def test_the_second_backup_copies_only_new_bytes_and_old_ones_are_deleted(store, clock, tmp_path):
    """Blobs are stored once for all backups, and are deleted with the last backup that needs them."""
    store.fill()
    first = store.backups.make()
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "backups" / "blobs").rglob("*") if p.is_file()}
    store.add_frame(b"n" * 77, age_days=0)
    clock.forward(60)
    second = store.backups.make()
    after = {p: p.stat().st_mtime_ns for p in (tmp_path / "backups" / "blobs").rglob("*") if p.is_file()}
    assert {p: t for p, t in after.items() if p in before} == before
    assert len(after) == len(before) + 1
    assert [made.name for made in store.backups.list_all()] == [second.name, first.name]
    assert store.backups.prune(1, second.name) == [first.name]
    assert [made.name for made in store.backups.list_all()] == [second.name]
    restore(tmp_path / "backups" / second.name, tmp_path / "new", clock)


def test_a_damaged_file_in_the_backups_is_copied_again(store, clock, tmp_path):
    """The next backup detects a damaged blob of earlier backups, copies it again and records an event."""
    store.fill()
    store.backups.make()
    key = hashlib.sha256(bytes([1]) * 500).hexdigest()
    flip(tmp_path / "backups" / "blobs" / key[:2] / key[2:])
    clock.forward(60)
    made = store.backups.make()
    restore(tmp_path / "backups" / made.name, tmp_path / "new", clock)
    assert BlobStore(str(tmp_path / "new" / "blobs")).get(key) == bytes([1]) * 500
    with store.database.unit_of_work() as session:
        reported = [event.text for event in session.scalars(select(Event)) if "damaged in the backups" in event.text]
    assert len(reported) == 1
    assert key[:12] in reported[0]


def test_all_content_of_a_backup_is_on_disk_before_it_is_renamed(store, tmp_path, monkeypatch):
    """All files and folders of the blobs are synchronised before the backup is renamed."""
    store.fill()
    synced, really = [], backup._sync_one

    def sync(path):
        synced.append((path, bool(store.backups.list_all())))
        really(path)

    monkeypatch.setattr(backup, "_sync_one", sync)
    made = store.backups.make()
    pool = tmp_path / "backups" / "blobs"
    expected_paths = {pool / key[:2] / key[2:] for key in made.blobs}
    assert expected_paths | {path.parent for path in expected_paths} | {pool} <= {
        path for path, named in synced if not named
    }


def test_no_credential_of_the_backup_is_valid_after_a_restore(store, clock, tmp_path):
    """After a restore all sessions are ended, links are invalid and tokens revoked, because they may have been revoked
    after the backup. Users are kept."""
    at, later = clock(), clock() + timedelta(days=9)
    with store.database.unit_of_work() as session:
        user = User(name="ann", role="admin", enabled=True, password_hash="x", created=at, created_by="t")
        session.add(user)
        session.flush()
        seen = {"last_seen": at, "end_reason": "", "address": "", "agent": ""}
        session.add(SignIn(user_id=user.id, key_hash="s", created=at, expires=later, **seen))
        session.add(OneTimeLink(kind="password", user_id=user.id, key_hash="l", created=at, expires=later))
        names = {"name": "t", "role": "viewer", "scopes": [], "created_by": "ann"}
        session.add(ApiToken(owner_id=user.id, key_hash="t", created=at, expires=later, **names))
    made = store.backups.make()
    clock.forward(60)
    restore(tmp_path / "backups" / made.name, tmp_path / "new", clock)
    database = open_database(tmp_path / "new")
    with database.unit_of_work() as session:
        (sign_in,), (link,), (token,) = (
            session.scalars(select(made)).all() for made in (SignIn, OneTimeLink, ApiToken)
        )
        ends = (sign_in.ended, link.used, token.revoked)
        assert ends == (clock(),) * 3
        assert sign_in.end_reason == "restored from a backup"
        assert [u.name for u in session.scalars(select(User)) if u.enabled] == ["ann"]
    database.close()


def test_the_tar_file_can_be_restored_like_the_folder(store, clock, tmp_path):
    """The tar file of a backup can be restored. A truncated one is rejected."""
    store.fill()
    made = store.backups.make()
    file = tmp_path / "elsewhere" / "backup.tar"
    file.parent.mkdir()
    file.write_bytes(b"".join(store.backups.archive(made.name)))
    restore(file, tmp_path / "new", clock)
    database = open_database(tmp_path / "new")
    assert rows(database) == rows(store.database)
    database.close()
    cut = tmp_path / "elsewhere" / "cut.tar"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    with pytest.raises(CorruptData):
        restore(cut, tmp_path / "other", clock)
    assert sorted(p.name for p in file.parent.iterdir()) == ["backup.tar", "cut.tar"]


@pytest.mark.parametrize("what", ["database", "blob", "manifest", "gone", "newer", "not a backup", "full folder"])
def test_an_incomplete_backup_is_rejected_and_nothing_is_restored(store, clock, tmp_path, what):
    """A backup with a wrong bit, a missing file or a newer version is rejected, and so is a target folder that is not
    empty."""
    store.fill()
    made = store.backups.make()
    folder = tmp_path / "backups" / made.name
    blob = next(p for p in (tmp_path / "backups" / "blobs").rglob("*") if p.is_file())
    error: type[GssError] = CorruptData
    if what == "database":
        flip(folder / "gss.db")
    elif what == "blob":
        flip(blob)
    elif what == "manifest":
        flip(folder / "manifest.json")
    elif what == "gone":
        blob.unlink()
        error = NotFound
    elif what == "newer":
        record = json.loads((folder / "manifest.json").read_bytes()) | {"schema": "9999"}
        data = json.dumps(record).encode()
        (folder / "manifest.json").write_bytes(data)
        (folder / "manifest.sha256").write_text(hashlib.sha256(data).hexdigest() + "  manifest.json\n")
        error = BadInput
    elif what == "not a backup":
        (folder / "manifest.json").unlink()
        error = NotFound
    else:
        (tmp_path / "new").mkdir()
        (tmp_path / "new" / "gss.db").write_bytes(b"of another program")
        error = Conflict
    with pytest.raises(error):
        restore(folder, tmp_path / "new", clock)
    files_left = [p.name for p in (tmp_path / "new").rglob("*")] if (tmp_path / "new").exists() else []
    assert files_left == (["gss.db"] if what == "full folder" else [])
    assert not list(tmp_path.glob(".new*"))


def test_a_manifest_or_tar_with_paths_is_rejected(store, clock, tmp_path):
    """Names with paths in a tar file or manifest are rejected, so that no file outside the new folder is written."""
    evil = tmp_path / "evil.tar"
    for name in ("../evil", "/etc/evil", "2026-01-01T000000Z/../../evil", "blobs/ab/../../evil"):
        with tarfile.open(evil, "w") as tar:
            tar.addfile(tarfile.TarInfo(name))
        with pytest.raises(CorruptData):
            restore(evil, tmp_path / "new", clock)
    made = store.backups.make()
    folder = tmp_path / "backups" / made.name
    record = json.loads((folder / "manifest.json").read_bytes())
    for change in ({"captures": {"../x": "0" * 64}}, {"blobs": {"../../x": 1}}, {"kind": "other"}, {"extra": 1}):
        data = json.dumps(record | change).encode()
        (folder / "manifest.json").write_bytes(data)
        (folder / "manifest.sha256").write_text(hashlib.sha256(data).hexdigest() + "  manifest.json\n")
        with pytest.raises((CorruptData, BadInput)):
            restore(folder, tmp_path / "new", clock)


def test_any_invalid_seal_or_manifest_is_rejected_with_a_message(store, clock, tmp_path):
    """An invalid seal or manifest raises an error of GSS with a message, and nothing is restored."""
    store.fill()
    made = store.backups.make()
    folder = tmp_path / "backups" / made.name
    manifest, seal = folder / "manifest.json", folder / "manifest.sha256"
    valid_manifest, valid_seal = manifest.read_bytes(), seal.read_bytes()
    for damaged in (b"", b"   \n", b"\xff\xfe", valid_seal[:10]):
        seal.write_bytes(damaged)
        with pytest.raises(CorruptData):
            restore(folder, tmp_path / "new", clock)
    record = json.loads(valid_manifest)
    fields = ("name", "created", "version", "schema", "kind", "database_bytes", "database_sha256", "blobs", "captures")
    other = [{name: value} for name in fields for value in (None, [], {"a": 1}, "\n", -1, ["x"])]
    bytes_of = [json.dumps(record | change).encode() for change in other if change != {"version": "\n"}]
    bytes_of += [b"", b"[]", b"7", b"\xff", b"[" * 100_000]
    bytes_of.append(json.dumps(record | {"captures": {"contact-9-1.raw": "a" * 64}}).encode())
    for data in bytes_of:
        manifest.write_bytes(data)
        seal.write_text(hashlib.sha256(data).hexdigest())
        with pytest.raises((CorruptData, BadInput)):
            restore(folder, tmp_path / "new", clock)
    assert not (tmp_path / "new").exists()


def test_a_backup_is_not_restored_among_the_backups(store, clock, tmp_path):
    """A restore into the folder of backups or below it is rejected, because it would be listed as a backup."""
    store.fill()
    made = store.backups.make()
    backups = tmp_path / "backups"
    for into in (backups / made.name, backups / made.name / "sub", backups / "new", backups):
        with pytest.raises(Conflict):
            restore(backups / made.name, into, clock)
    assert sorted(p.name for p in backups.iterdir()) == sorted([made.name, "blobs"])


@pytest.mark.parametrize("when", ["Copying", "0 of", "3 of", "Writing"])
def test_a_backup_killed_while_it_is_made_is_absent_and_the_next_one_cleans_up(store, clock, tmp_path, when):
    """A backup gets its name only when it is complete, so that a partial one is not listed. The next backup removes it."""
    store.fill()

    def until(_done, _total, text):
        if when in text:
            # The next server gets a copy of the folder at this time, as after kill -9.
            shutil.copytree(tmp_path / "backups", tmp_path / "left")
            raise Cancelled

    with pytest.raises(Cancelled):
        store.backups.make(until)
    shutil.rmtree(tmp_path / "backups")
    shutil.move(tmp_path / "left", tmp_path / "backups")
    assert store.backups.list_all() == []
    made = store.backups.make()
    restore(tmp_path / "backups" / made.name, tmp_path / "new", clock)
    assert sorted(p.name for p in (tmp_path / "backups").iterdir()) == sorted([made.name, "blobs"])


def test_an_unavailable_store_ends_the_backup(store, monkeypatch):
    """If the store does not respond, no backup is created, and older ones are kept."""
    store.fill()
    first_backup = store.backups.make()
    store.add_frame(b"n" * 77, age_days=0)

    def silent(key):
        raise StoreDown("the store does not respond")

    monkeypatch.setattr(store.blobs, "get", silent)
    with pytest.raises(StoreDown, match="does not respond"):
        store.backups.make()
    assert [made.name for made in store.backups.list_all()] == [first_backup.name]


def test_two_simultaneous_backups_are_rejected_and_a_full_disk_makes_none(store, tmp_path):
    """A second simultaneous backup is rejected, and so is a backup that would leave too little free space."""
    store.fill()

    def again(_done, _total, text):
        if "Copying" in text:
            store.backups.make()

    with pytest.raises(Conflict, match="is running"):
        store.backups.make(again)
    store.room[0] = store.disk.stop_bytes + 1000
    with pytest.raises(StoreDown, match="nearly full"):
        store.backups.start(user="ann")
    assert store.backups.list_all() == []


def test_the_check_of_the_store_reports_each_kind_of_damage(store, tmp_path):
    """The check of the store reports missing, damaged and unused files, wrong sizes, truncated and short captures, and
    broken references."""
    store.fill()
    captures, audit = tmp_path / "captures", AuditService(store.database, store.clock, AnchorFile(tmp_path / ANCHORS))
    assert check_store(store.database, store.blobs, captures, audit).whole
    store.blob_path(bytes([1]) * 500).unlink()
    flip(store.blob_path(bytes([2]) * 500))
    store.blobs.put(b"unreferenced")
    (capture,) = captures.glob("*.raw")
    capture.write_bytes(capture.read_bytes()[:-3])
    with store.database.engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA foreign_keys=OFF")
        connection.exec_driver_sql("UPDATE frames SET contact_id = 99, columns = 400 WHERE id = 4")
        connection.commit()
    findings = {f.name: f for f in check_store(store.database, store.blobs, captures, audit).findings}
    states = {name: f.state for name, f in findings.items()}
    assert states == {
        "database": "ok",
        "schema": "ok",
        "references": "error",
        "missing files": "error",
        "damaged files": "error",
        "wrong file sizes": "error",
        "unused files": "note",
        "removed captures": "ok",
        "truncated captures": "note",
        "short captures": "error",
        "audit": "ok",
    }
    assert findings["missing files"].examples[0].startswith("frame 2")
