"""The file of ABORTs that the database does not have yet."""

from __future__ import annotations

from gss.operations.commanding.abort_journal import AbortJournal, IssuedAbort

ENTRY = IssuedAbort(7, "bob", "abort", "2026-12-01T18:00:00+00:00")


def test_an_abort_is_kept_until_it_is_recorded(tmp_path):
    """Also by the next server; a line that a crash cut off hides no other."""
    path = tmp_path / "aborts.jsonl"
    AbortJournal(path).add(ENTRY)
    with path.open("a") as file:
        file.write('{"request_id": 8, "us')
    again = AbortJournal(path)
    assert again.entries() == [ENTRY]
    again.remove(7)
    assert AbortJournal(path).entries() == []


def test_an_abort_that_was_recorded_before_it_was_noted_leaves_no_entry(tmp_path):
    """The dispatcher may be quicker than the thread of the request: the next server must not report it as unknown."""
    journal = AbortJournal(tmp_path / "aborts.jsonl")
    journal.remove(7)
    journal.add(ENTRY)
    assert journal.entries() == []
    assert AbortJournal(tmp_path / "aborts.jsonl").entries() == []
