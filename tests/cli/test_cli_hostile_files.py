"""Malicious files that would use unlimited time or memory are rejected with one message."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from gss.cli import main

LIST_OPTIONS = ["--list-epoch", "2000", "--list-frame", "icrs"]


def error_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that ends with exit code 2 and return its error message of one line."""
    code = main(arguments)
    message = capsys.readouterr().err.strip().splitlines()
    assert (code, len(message)) == (2, 1), message
    return message[0]


@pytest.mark.parametrize(
    "name", ["unit.vot", "unit.fits", "line.csv", "columns.csv", "chars.vot", "nested.ecsv", "deep.vot", "rows.fits"]
)
def test_a_hostile_star_list_is_refused(
    name: str, tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss catalogue build --list`` rejects the file with a message and writes no image."""
    path = tmp_path / name
    path.write_bytes(hostile.content(name))
    out = str(tmp_path / "bank.bin")
    message = error_of(["catalogue", "build", "--list", str(path), *LIST_OPTIONS, "--out", out], capsys)
    assert "Expected" in message
    assert not Path(out).exists()


@pytest.mark.parametrize("name", ["tiles.fits", "cube.fits"])
def test_a_hostile_frame_is_refused(
    name: str, tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss solve`` and ``gss calibrate`` reject a frame that is too large when it is unpacked."""
    path = tmp_path / name
    path.write_bytes(hostile.content(name))
    assert "too large when it is unpacked" in error_of(["solve", str(path), "--blind"], capsys)
    message = error_of(["calibrate", str(path), "--camera", "cubestar"], capsys)
    assert "too large when it is unpacked" in message


@pytest.mark.parametrize("name", ["bomb.tables.csv.zip", "rows.tables.fits"])
def test_a_table_bomb_is_refused(
    name: str, tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss catalogue import`` checks the unpacked size before it unpacks."""
    path = tmp_path / name
    path.write_bytes(hostile.content(name))
    assert "Expected" in error_of(["catalogue", "import", str(path), "--out", str(tmp_path / "a.bin")], capsys)


def test_a_table_of_equal_values_is_measured(
    tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """A Parquet file of 20 kB that contains 60 million values is rejected."""
    path = tmp_path / "bomb.tables.parquet.zip"
    path.write_bytes(hostile.content(path.name))
    assert main(["catalogue", "import", str(path), "--out", str(tmp_path / "a.bin")]) == 1
    assert "60000000 values" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "--blind", "FILE"],
        ["solve", "--camera", "cubestar", "--tle", "FILE", "a.fits"],
        ["catalogue", "import", "FILE", "--out", "x"],
        ["catalogue", "show", "FILE"],
        ["catalogue", "build", "--tle", "FILE", "--out", "x"],
    ],
)
def test_a_file_without_end_is_read_in_part(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """An endless file is rejected with one message; only a part of it is read."""
    assert main([part.replace("FILE", "/dev/zero") for part in arguments]) == 2
    assert capsys.readouterr().err.count("gss: ") == 1
