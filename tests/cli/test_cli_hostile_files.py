"""Malicious files that would take for ever are rejected with one message and exit code 2."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from gss.cli import main

STATED = ["--list-epoch", "2000", "--list-frame", "icrs"]


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one sentence of a command that ends with exit code 2."""
    code = main(arguments)
    said = capsys.readouterr().err.strip().splitlines()
    assert (code, len(said)) == (2, 1), said
    return said[0]


@pytest.mark.parametrize(
    "name", ["unit.vot", "unit.fits", "line.csv", "columns.csv", "chars.vot", "nested.ecsv", "deep.vot", "rows.fits"]
)
def test_a_hostile_star_list_is_refused(
    name: str, tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss catalogue build --list`` names the reason."""
    path = tmp_path / name
    path.write_bytes(hostile.content(name))
    out = str(tmp_path / "bank.bin")
    said = refused(["catalogue", "build", "--list", str(path), *STATED, "--out", out], capsys)
    assert "Expected" in said
    assert not Path(out).exists()


@pytest.mark.parametrize("name", ["tiles.fits", "cube.fits"])
def test_a_hostile_frame_is_refused(
    name: str, tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss solve`` and ``gss analyse`` state the unpacked size."""
    path = tmp_path / name
    path.write_bytes(hostile.content(name))
    assert "too large when it is unpacked" in refused(["solve", str(path), "--blind"], capsys)
    said = refused(["calibrate", str(path), "--camera", "cubestar"], capsys)
    assert "too large when it is unpacked" in said


@pytest.mark.parametrize("name", ["bomb.tables.csv.zip", "rows.tables.fits"])
def test_a_table_bomb_is_refused(
    name: str, tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss catalogue import`` measures before it unpacks."""
    path = tmp_path / name
    path.write_bytes(hostile.content(name))
    assert "Expected" in refused(["catalogue", "import", str(path), "--out", str(tmp_path / "a.bin")], capsys)


def test_a_table_of_equal_values_is_measured(
    tmp_path: Path, hostile: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """20 kB of Parquet that are 600 million values are not read."""
    path = tmp_path / "bomb.tables.parquet.zip"
    path.write_bytes(hostile.content(path.name))
    assert main(["catalogue", "import", str(path), "--out", str(tmp_path / "a.bin")]) == 1
    assert "600000000 values" in capsys.readouterr().err


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
    """A device that never ends, or a file larger than memory, is not read into it."""
    assert main([part.replace("FILE", "/dev/zero") for part in arguments]) == 2
    assert capsys.readouterr().err.count("gss: ") == 1
