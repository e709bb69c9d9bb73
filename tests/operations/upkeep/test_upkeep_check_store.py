"""The check of the store reports an intact store as intact, also while data are removed and added."""

from __future__ import annotations

import pytest

from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import ANCHORS, AnchorFile
from gss.operations.line.capture_files import packed_path
from gss.operations.line.line_capture import RawCapture
from gss.operations.line.raw_capture import RECEIVED
from gss.operations.upkeep.check_store import check_store
from gss.operations.upkeep.retention_policy import RetentionPolicy


@pytest.fixture
def findings_during(store, tmp_path):
    """Function that checks the store, calls ``change`` when a step with ``text`` begins, and returns the findings."""
    audit = AuditService(store.database, store.clock, AnchorFile(tmp_path / ANCHORS))

    def check(text, change):
        changed = []

        def progress(done, _total, step):
            if text in step and done == 1 and not changed:
                changed.append(step)
                change()

        report = check_store(store.database, store.blobs, tmp_path / "captures", audit, progress)
        assert changed
        return {f.name: f.state for f in report.findings if f.state != "ok"}

    return check


def test_pixels_that_retention_removes_during_the_check_are_not_missing(store, findings_during):
    """Frames whose pixels are removed during the check are not reported as missing, but a missing file is."""
    for k in range(6):
        store.add_frame(bytes([k]) * 500, age_days=30)
    kept = store.add_frame(b"kept", age_days=30)
    store.retention.favourite(kept, True)
    store.retention.choose(RetentionPolicy(frames_days=10, keep_frames=0), user="ann")

    def remove():
        assert store.end(store.retention.run(user="ann")).result["removed"]["frames"] == 6

    assert findings_during("bytes", remove) == {}
    store.add_frame(b"other", age_days=1)
    assert findings_during("bytes", store.blob_path(b"other").unlink) == {"missing files": "error"}


def test_frames_that_are_added_during_the_check_are_not_unused(store, findings_during):
    """The file of a frame that is stored during the check is not reported as unused."""
    for k in range(2):
        store.add_frame(bytes([k]) * 500, age_days=1)
    assert findings_during("bytes", lambda: store.add_frame(b"new" * 99, age_days=0)) == {}


def test_captures_that_are_removed_during_the_check_are_ignored(store, findings_during):
    """A capture that is removed during the check is not an error. A compressed capture that cannot be opened is."""
    for contact in (1, 2, 3):
        capture = RawCapture(store.folder / "captures", contact)
        capture.write(1.0, RECEIVED, b"x" * 100)
        capture.close()
    paths = sorted((store.folder / "captures").glob("*.raw"))
    assert findings_during("captures", paths[1].unlink) == {}

    def damage():
        packed_path(paths[2]).mkdir()
        paths[2].unlink()

    assert findings_during("captures", damage) == {"captures": "error"}
