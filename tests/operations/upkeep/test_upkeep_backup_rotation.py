"""The rotation of backups keeps the files of all backups that remain, also of those that are not listed."""

from __future__ import annotations

from sqlalchemy import select

from gss.operations.upkeep.restore import restore
from gss.store import upkeep
from gss.store.models import Event


def two_backups(store, clock):
    """Create a backup of a frame, remove the pixels, and create a second backup of another frame a minute later."""
    frame_id = store.add_frame(b"a" * 500, age_days=1)
    first = store.backups.make()
    with store.database.unit_of_work() as session:
        upkeep.remove_pixels(session, [frame_id], clock())
    store.add_frame(b"b" * 500, age_days=1)
    clock.forward(60)
    return first, store.backups.make()


def warnings(store) -> list[str]:
    with store.database.unit_of_work() as session:
        return [e.text for e in session.scalars(select(Event)) if "No files of backups were removed" in e.text]


def test_a_renamed_backup_can_be_restored_after_a_rotation(store, clock, tmp_path):
    """A backup whose folder was renamed is not listed, but its files are kept. They are removed with its folder."""
    first, second = two_backups(store, clock)
    renamed = tmp_path / "backups" / f"{first.name}-before-upgrade"
    (tmp_path / "backups" / first.name).rename(renamed)
    assert store.backups.prune(1, second.name) == []
    assert restore(renamed, tmp_path / "new", clock).files == 1
    for file in renamed.iterdir():
        file.unlink()
    store.backups.prune(1, second.name)
    files = [p for p in (tmp_path / "backups" / "blobs").rglob("*") if p.is_file()]
    assert len(files) == len(second.blobs) == 1
    assert warnings(store) == []


def test_no_files_are_removed_while_a_manifest_cannot_be_read(store, clock, tmp_path):
    """While the manifest of a backup is damaged, a rotation removes no files and records a warning with its name."""
    first, second = two_backups(store, clock)
    manifest = tmp_path / "backups" / first.name / "manifest.json"
    intact = manifest.read_bytes()
    manifest.write_bytes(intact[:-9])
    store.backups.prune(1, second.name)
    (warning,) = warnings(store)
    assert first.name in warning
    manifest.write_bytes(intact)
    assert restore(manifest.parent, tmp_path / "new", clock).files == 1


def test_the_newest_backup_is_not_one_dated_in_the_future(store, clock):
    """A backup that was created while the clock was ahead does not count as the newest backup until that time."""
    clock.forward(30 * 86400)
    store.backups.make()
    clock.forward(-30 * 86400)
    assert store.backups.newest_at() is None
    made_at = clock().replace(microsecond=0)
    store.backups.make()
    assert store.backups.newest_at() == made_at
