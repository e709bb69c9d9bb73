"""The file of ABORTs that are not yet stored in the database."""

from __future__ import annotations

from gss.operations.commanding.abort_journal import AbortJournal, IssuedAbort

ENTRY = IssuedAbort(7, "bob", "abort", "2026-12-01T18:00:00+00:00")


def test_an_abort_is_kept_until_it_is_stored(tmp_path):
    """The next server stores it too; a line truncated by a crash hides no other line."""
    path = tmp_path / "aborts.jsonl"
    AbortJournal(path).add(ENTRY)
    with path.open("a") as file:
        file.write('{"request_id": 8, "us')
    again = AbortJournal(path)
    assert again.entries() == [ENTRY]
    again.remove(7)
    assert AbortJournal(path).entries() == []


def test_an_abort_stored_before_it_was_journalled_leaves_no_entry(tmp_path):
    """The dispatcher may be faster than the request's thread: the next server must not report the ABORT as unknown."""
    journal = AbortJournal(tmp_path / "aborts.jsonl")
    journal.remove(7)
    journal.add(ENTRY)
    assert journal.entries() == []
    assert AbortJournal(tmp_path / "aborts.jsonl").entries() == []
