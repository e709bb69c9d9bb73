"""The download of a backup is a valid tar file, and needs little memory."""

from __future__ import annotations

import io
import os
import tarfile
import tracemalloc

from gss.operations.upkeep.backup_manifest import BLOCK


def test_the_download_of_a_large_database_needs_little_memory(store, tmp_path):
    """A database of 64 MiB is sent in blocks of at most 1 MiB, with a peak memory of less than 8 MiB."""
    made = store.backups.make()
    os.truncate(tmp_path / "backups" / made.name / "gss.db", 64 << 20)
    longest = total = 0
    tracemalloc.start()
    try:
        for block in store.backups.archive(made.name):
            longest, total = max(longest, len(block)), total + len(block)
        peak_bytes = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (longest, total > 64 << 20, peak_bytes < 8 << 20) == (BLOCK, True, True)


def test_the_tar_file_has_every_file_of_the_backup(store, tmp_path):
    """The tar file has the same files as the backup, dated at its time and readable by the owner only."""
    store.fill()
    store.add_frame(bytes(3 * 512), age_days=0)  # a multiple of the block size of tar needs no padding
    made = store.backups.make()
    with tarfile.open(fileobj=io.BytesIO(b"".join(store.backups.archive(made.name)))) as tar:
        members = {member.name: (member.mode, member.mtime, tar.extractfile(member).read()) for member in tar}
    folder, created = tmp_path / "backups", store.clock().replace(microsecond=0).timestamp()
    for name in ("manifest.json", "manifest.sha256", "gss.db"):
        assert members.pop(f"{made.name}/{name}") == (0o600, created, (folder / made.name / name).read_bytes())
    assert {name.replace("blobs/", "").replace("/", "") for name in members} == set(made.blobs)
    assert {
        name.replace("blobs/", "").replace("/", ""): len(data) for name, (*_, data) in members.items()
    } == made.blobs
