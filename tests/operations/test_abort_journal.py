"""The journal of ABORT commands that are not yet stored in the database."""

from __future__ import annotations

from gss.operations.commanding.abort_journal import AbortJournal, IssuedAbort

ENTRY = IssuedAbort(7, "bob", "abort", "2026-12-01T18:00:00+00:00")


def test_an_abort_is_kept_until_it_is_stored(tmp_path):
    """An ABORT stays in the journal, also after a restart, until it is removed. A line truncated by a crash is skipped."""
    path = tmp_path / "aborts.jsonl"
    AbortJournal(path).add(ENTRY)
    with path.open("a") as file:
        file.write('{"request_id": 8, "us')
    reopened = AbortJournal(path)
    assert reopened.entries() == [ENTRY]
    reopened.remove(7)
    assert AbortJournal(path).entries() == []


def test_an_abort_stored_before_it_was_journalled_leaves_no_entry(tmp_path):
    """An entry that is removed before it is added, because the dispatcher was faster, is not stored. Otherwise the next
    server would report the ABORT as unknown."""
    journal = AbortJournal(tmp_path / "aborts.jsonl")
    journal.remove(7)
    journal.add(ENTRY)
    assert journal.entries() == []
    assert AbortJournal(tmp_path / "aborts.jsonl").entries() == []
