"""``gss render`` makes images that the chains solve at the requested pointing."""

from __future__ import annotations

import json
import os
import re
import resource
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gss import cli
from gss.cli import main
from gss.cli.whole_files import write_whole
from gss.instruments.registry import shipped_registry


@pytest.mark.parametrize("camera", ["aim", "cubestar", "sunsat"])
def test_a_rendered_image_is_solved_at_its_pointing(
    camera: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An image with noise and false stars is solved at its pointing. ``gss solve`` compares it with the truth file."""
    out, truth = tmp_path / "orion.png", tmp_path / "truth.json"
    pointing = ["--camera", camera, "--at", "84.0,-2.0,30.0"]
    command = ["render", *pointing, "--out", str(out), "--truth", str(truth), "--false-stars", "3", "--epoch", "2026"]
    assert main(command) == 0
    assert "3 false stars" in capsys.readouterr().out
    profile = shipped_registry().camera(camera)
    columns = profile.camera.columns + profile.sensor.dark_columns.count
    assert np.asarray(Image.open(out)).shape == (profile.camera.rows, columns)
    assert json.loads(truth.read_text()) == {"orion.png": [84.0, -2.0, 30.0]}
    assert main(["solve", str(out), "--camera", camera, "--epoch", "2026", "--truth", str(truth)]) == 0


def test_the_same_seed_gives_the_same_image(tmp_path: Path) -> None:
    """Equal seeds give equal images and different seeds different noise. Without noise the seed has no effect."""

    def image(name: str, *more: str) -> bytes:
        out = tmp_path / name
        assert (
            main(["render", "--camera", "cubestar", "--at", "84,5,0", "--out", str(out), "--epoch", "2026", *more]) == 0
        )
        return out.read_bytes()

    first = image("a.png")
    assert image("b.png") == first
    assert image("c.png", "--seed", "2") != first
    assert image("d.png", "--no-noise") == image("e.png", "--no-noise", "--seed", "2")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--at", "84,95,0", "--out", "a.png"], "Declination is out of range"),
        (["--at", "84,5", "--out", "a.png"], "Unreadable angles"),
        (["--at", "84,5,0", "--out", "a.jpg"], "ends in .png"),
        (["--at", "84,5,0", "--out", "a.png", "--exposure", "0"], "Exposure is out of range"),
        (["--at", "84,5,0", "--out", "a.png", "--exposure", "1e12"], "Exposure is out of range"),
        (["--at", "84,5,0", "--out", "a.png", "--rate", "900,0,0"], "rotates too fast"),
        (["--at", "-4,5,0", "--out", "a.png", "--rate", "-900,0,0"], "rotates too fast"),
        (["--at", "84,5,0", "--out", "a.png", "--false-stars", "-1"], "0 – 500"),
        (["--at", "84,5,0", "--out", "a.png", "--seed", "-1"], "Seed is out of range"),
    ],
)
def test_impossible_images_are_refused(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Impossible options give exit code 2 and the reason, and no file is written."""
    monkeypatch.chdir(tmp_path)
    assert main(["render", "--camera", "cubestar", *options]) == 2
    assert message.lower() in capsys.readouterr().err.lower()
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_existing_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """If a file cannot be written completely, the existing file is unchanged and no part of the new one remains. A missing
    folder is bad input.
    """
    out = tmp_path / "sky.png"
    out.write_bytes(b"old")
    command = ["render", "--camera", "cubestar", "--at", "84,5,0", "--overwrite", "--out"]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        assert main([*command, str(out)]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert out.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [out]
    assert main([*command, str(tmp_path / "missing" / "sky.png")]) == 2
    assert "Expected an existing folder" in capsys.readouterr().err


def test_every_output_file_is_written_whole() -> None:
    """Commands write files with the functions of whole_files.py only, so that no incomplete file has the final name."""
    folder = Path(cli.__file__).parent
    direct = re.compile(r"\.write_(?:text|bytes)\(|open\([^)]*[\"'][wax]")
    files = [path.name for path in folder.glob("*.py") if direct.search(path.read_text("utf-8"))]
    assert files == ["whole_files.py"]


def test_a_replaced_file_keeps_its_permissions_links_and_pipes(tmp_path: Path) -> None:
    """A replaced file keeps its permissions, a symbolic link still refers to it, and a pipe is not replaced."""
    file, link = tmp_path / "private", tmp_path / "link"
    file.write_bytes(b"old")
    file.chmod(0o600)
    link.symlink_to(file)
    write_whole(link, b"new")
    assert (file.read_bytes(), file.stat().st_mode & 0o777, link.is_symlink()) == (b"new", 0o600, True)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, b"new")
    assert (os.read(reader, 9), pipe.is_fifo()) == (b"new", True)
    os.close(reader)
