"""Captures whose files are compressed after they were written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from gss.operations.line import capture_packing
from gss.operations.line.capture_files import capture_files, capture_sizes, open_capture, plain_name
from gss.operations.line.capture_packing import CapturePacking
from gss.operations.line.line_capture import LineCapture
from gss.operations.line.raw_capture import RECEIVED, SENT, Record, Retention, capture_span, read_captures

AT = datetime(2026, 11, 23, tzinfo=UTC)
Filled = Callable[..., tuple[LineCapture, CapturePacking]]


class Clock:
    """Clock that advances by 10 s with each call."""

    def __init__(self) -> None:
        self.at_s = 0.0

    def __call__(self) -> float:
        self.at_s += 10.0
        return self.at_s


@pytest.fixture
def filled(tmp_path: Path) -> Iterator[Filled]:
    """Function that creates a capture with several closed files and one that is being written, and its packing."""
    made: list[LineCapture] = []

    def fill(records: int = 60, keep_bytes: int = 1 << 30) -> tuple[LineCapture, CapturePacking]:
        capture = LineCapture(tmp_path, Retention(20_000, keep_bytes), lambda: AT, lambda _: None)
        made.append(capture)
        capture.begin(7)
        for k in range(records):
            capture.write(k % 2, bytes([k]) * 2000)
        return capture, CapturePacking(capture, Clock())

    yield fill
    for capture in made:
        capture.end()


def run(packing: CapturePacking) -> None:
    for _ in range(60):
        packing()


def test_closed_files_are_compressed_and_read_as_before(
    filled: Filled, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compressed files have the same records and span. The file being written is compressed after the contact ends."""
    monkeypatch.setattr(capture_packing, "STEP_BYTES", 3000)
    capture, packing = filled()
    before, span = list(read_captures(capture_files(tmp_path))), capture_span(capture_files(tmp_path))
    names, size = [p.name for p in capture_files(tmp_path)], sum(f.bytes for f in capture_sizes(tmp_path))
    run(packing)
    files = capture_files(tmp_path)
    assert [plain_name(p) for p in files] == names
    assert [p.suffix for p in files] == [".zst"] * (len(files) - 1) + [".raw"]
    torn: list[int] = []
    assert list(read_captures(files, lambda _, n: torn.append(n))) == before
    assert not torn
    assert capture_span(files) == span
    assert sum(f.bytes for f in capture_sizes(tmp_path)) < size / 2
    capture.write(SENT, b"more")
    capture.end()
    run(packing)
    assert {p.suffix for p in capture_files(tmp_path)} == {".zst"}
    assert list(read_captures(capture_files(tmp_path)))[-1][1:] == (SENT, b"more")
    assert {p.suffix for p in tmp_path.iterdir()} == {".zst"}


def test_a_stop_between_any_two_steps_loses_nothing(
    filled: Filled, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a stop at any step, every record is read once, and the next start completes the compression."""
    monkeypatch.setattr(capture_packing, "STEP_BYTES", 9000)
    capture, packing = filled(records=25)
    before = list(read_captures(capture_files(tmp_path)))
    for steps in range(8):
        for _ in range(steps):
            packing()
        assert list(read_captures(capture_files(tmp_path))) == before
        packing = CapturePacking(capture, Clock())
    run(packing)
    first = capture_files(tmp_path)[0]
    (tmp_path / plain_name(first)).write_bytes(b"left by a stop before it was removed")
    assert list(read_captures(capture_files(tmp_path))) == before


def test_a_name_read_before_is_still_readable(filled: Filled, tmp_path: Path) -> None:
    """A reader with the name of the uncompressed file opens the compressed one. A removed file is not found."""
    _, packing = filled()
    names = capture_files(tmp_path)
    run(packing)
    with open_capture(names[0]) as file:
        assert len(file.read()) > 20_000
    with pytest.raises(FileNotFoundError), open_capture(tmp_path / "contact-000001-000.raw"):
        pass


def test_retention_counts_and_removes_compressed_files(filled: Filled, tmp_path: Path) -> None:
    """Retention counts compressed files with their size on disk and removes the oldest first."""
    capture, packing = filled(records=100, keep_bytes=60_000)
    run(packing)
    assert sum(f.bytes for f in capture_sizes(tmp_path)) <= 60_000
    for k in range(120):
        capture.write(RECEIVED, bytes([k]) * 2000)
        packing()
    files_kept = capture_files(tmp_path)
    assert "contact-000007-000.raw" not in {plain_name(p) for p in files_kept}
    records: list[Record] = list(read_captures(files_kept))
    assert records[-1][2][:1] == bytes([119])


def test_a_new_contact_of_the_same_number_keeps_the_compressed_files(filled: Filled, tmp_path: Path) -> None:
    """A new contact with a used number, as after the database was recreated, does not overwrite compressed files."""
    capture, packing = filled()
    capture.end()
    run(packing)
    before = list(read_captures(capture_files(tmp_path)))
    capture.begin(7)
    capture.write(RECEIVED, b"again")
    assert list(read_captures(capture_files(tmp_path)))[: len(before)] == before


def test_a_damaged_compressed_file_does_not_hide_the_next(filled: Filled, tmp_path: Path) -> None:
    """A damaged compressed file is reported by its uncompressed name, and the other files are read."""
    capture, packing = filled()
    capture.end()
    run(packing)
    files = capture_files(tmp_path)
    count = len(list(read_captures(files[1:])))
    files[0].write_bytes(files[0].read_bytes()[:-30])
    torn: list[str] = []
    assert len(list(read_captures(files, lambda path, _: torn.append(path.name)))) >= count
    assert torn == ["contact-000007-000.raw"]
    assert capture_span(files) is not None
