"""``gss instrument new --from-frames``: packages from photographs, and folders without usable photographs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gss.cli import main
from gss.instruments.package import load_instrument
from gss.instruments.package_source import read_folder
from gss.operations.frames.frame_files import read_frame
from gss.operations.frames.solve import Solver, SolveRequest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Folder of files without stars: noise, a copy, an image of another size, a text and a hidden file."""
    rng, folder = np.random.default_rng(3), tmp_path / "night"
    folder.mkdir()
    for name, shape in (("a.png", (200, 300)), ("c.png", (200, 300)), ("d.png", (150, 300))):
        Image.fromarray(rng.normal(90, 3, shape).astype(np.uint8)).save(folder / name)
    (folder / "b.png").write_bytes((folder / "a.png").read_bytes())
    (folder / "notes.txt").write_text("clear sky")
    (folder / ".hidden").write_text("")
    return folder


def test_a_folder_without_the_sky_gives_a_reason_for_each_file(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command gives exit code 2 and a reason for each file, and writes nothing."""
    out = tmp_path / "out"
    assert main(["instrument", "new", "mine", "--from-frames", str(folder), "--into", str(out)]) == 2
    errors = capsys.readouterr().err
    for reason in (
        "notes.txt: notes.txt is not a supported image file",
        "b.png: the same pixels as a.png",
        "d.png: 300 x 150 px; 2 others are 300 x 200 px: cropped, resized, or of another camera",
    ):
        assert reason in errors
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["new", "mine"], "--from INSTRUMENT or --from-frames FOLDER"),
        (["new", "nos3", "--from-frames", "{folder}"], "an instrument of this name exists"),
        (["new", "night", "--from-frames", "{folder}", "--into", "{parent}"], "the folder exists already"),
        (["new", "mine", "--from-frames", "{folder}", "--fov-deg", "wide"], "unreadable field of view"),
        (["new", "mine", "--from-frames", "{folder}", "--pixel-um", "0"], "pixel_um is out of range"),
        (["new", "Mine!", "--from-frames", "{folder}"], "name is out of range"),
        (["new", "mine", "--from-frames", "{folder}/none"], "no such file or folder"),
    ],
)
def test_wrong_arguments_are_refused(
    folder: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each invalid argument ends the command with a message."""
    folders = {"folder": str(folder), "parent": str(folder.parent)}
    assert main(["instrument", *(a.format(**folders) for a in arguments)]) != 0
    assert words.lower() in capsys.readouterr().err.lower()


@pytest.mark.photographs
def test_real_photographs_give_a_package_that_solves_them(
    photographs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The package from three photographs passes the check and has the plate scale of the independent reference within
    three standard deviations. With it, every photograph is solved in agreement with the reference.
    """
    images = json.loads((photographs / "truth.json").read_text())["images"]
    names = sorted(n for n in images if n.startswith("esa_tetra3"))
    files = [str(photographs / name) for name in names]
    command = ["instrument", "new", "bench", "--from-frames", *files, "--into", str(tmp_path), "--date", "2019-07-29"]
    assert main([*command, "--fov-deg", "11..12", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [t["solved"] for t in result["trials"]] == [True] * 3
    assert main(["instrument", "check", str(tmp_path / "bench")]) == 0
    instrument = load_instrument(read_folder(tmp_path / "bench"))
    focal = next(n for n in instrument.camera.numbers() if n.name == "focal_length")
    pitch_mm = instrument.camera.geometry.pitch_column.value
    for name in names:
        image = images[name]
        assert focal.sigma is not None
        assert abs(focal.values[0] / pitch_mm - image["focal_px"]) < 3 * focal.sigma / pitch_mm
        pixels = read_frame((photographs / name).read_bytes(), name).pixels
        solved = Solver(lambda _: instrument.profile).solve(pixels, SolveRequest(profile="bench", epoch_jyear=2019.5))
        assert solved.attitude is not None, solved.reason
        boresight = solved.camera.unproject(np.array([[511.5, 383.5]]))[0] @ solved.attitude.cam_from_icrs
        error_arcsec = np.degrees(np.linalg.norm(boresight - np.array(image["R_icrs_to_cam"])[2])) * 3600
        assert error_arcsec < image["suggested_tolerance_arcsec"]
