"""``gss solve-lists`` on the command line: formats, output, exit codes and messages."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.cli import main
from gss.instruments.registry import SHIPPED
from gss.operations.frames.measured_list_files import MAX_LIST_BYTES
from tools.bench_scenes import CAMERAS, EPOCH_JYEAR, CentroidList, Disturbance, star_lists, visible_stars

OPTICS = CAMERAS[0]
CAMERA_OPTIONS = ["--camera", "cubestar", "--no-distortion", "--epoch", str(EPOCH_JYEAR)]


def scenes(count: int = 6, false_stars: int = 3) -> list[CentroidList]:
    """Return star lists of CubeStar's camera without distortion, generated independently of the product code."""
    return star_lists(visible_stars(OPTICS), OPTICS, count, Disturbance(false_stars), 31)


def arrays(lists: list[CentroidList]) -> dict[str, np.ndarray]:
    """Return the arrays of an NPZ file with these lists."""
    pixels = np.concatenate([s.offset_px for s in lists]) + np.array([OPTICS.columns - 1, OPTICS.rows - 1]) / 2
    first = np.concatenate([[0], np.cumsum([len(s.offset_px) for s in lists])])
    flux = 10 ** (-0.4 * np.concatenate([s.magnitude for s in lists]))
    return {"col_px": pixels[:, 0], "row_px": pixels[:, 1], "flux": flux, "first": first}


def write_csv(path: Path, content: dict[str, np.ndarray]) -> None:
    number = np.repeat(np.arange(len(content["first"]) - 1), np.diff(content["first"]))
    rows = zip(number, content["col_px"], content["row_px"], content["flux"], strict=True)
    lines = [f"{n},{col!r},{row!r},{flux!r}" for n, col, row, flux in ((int(n), *map(float, r)) for n, *r in rows)]
    path.write_text("\n".join(["list,col_px,row_px,flux", *lines]) + "\n")


def run_json(arguments: list[str], capsys: pytest.CaptureFixture[str], code: int = 0) -> dict[str, list]:
    """Run the command, check its exit code, and return the printed JSON."""
    assert main(["solve-lists", *arguments, "--json"]) == code
    return dict(json.loads(capsys.readouterr().out))


def error_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run a command that ends with exit code 2 and return its error message of one line."""
    assert main(["solve-lists", *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_every_list_gets_its_attitude(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Quaternions are cam_from_icrs, scalar last, within 0.1° of the truth. An empty list has no solution."""
    truth = scenes()
    content = arrays(truth)
    content["first"] = np.append(content["first"], content["first"][-1])
    np.savez(tmp_path / "lists.npz", **content)
    results = run_json([str(tmp_path / "lists.npz"), *CAMERA_OPTIONS], capsys, code=3)["results"]
    assert len(results) == len(truth) + 1
    for scene, result in zip(truth, results, strict=False):
        assert result["outcome"] == "solved"
        assert result["false_match_probability"] <= 1e-6
        assert 4 <= result["matched"] <= len(scene.magnitude)
        assert result["ms"] > 0
        off = Rotation.from_quat(result["quaternion"]).as_matrix() @ scene.cam_from_icrs.T
        assert np.degrees(np.arccos(min(1.0, (np.trace(off) - 1) / 2))) < 0.1
    assert (results[-1]["outcome"], results[-1]["quaternion"], results[-1]["matched"]) == ("none", None, 0)
    assert "0 stars found" in results[-1]["reason"]


def test_csv_and_camera_file_give_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The same lists as CSV with the camera given as a file give the same attitudes."""
    content = arrays(scenes(3))
    np.savez(tmp_path / "lists.npz", **content)
    write_csv(tmp_path / "lists.csv", content)
    file = str(SHIPPED / "cubestar" / "camera.yaml")
    answers = [
        run_json([str(tmp_path / "lists.npz"), *CAMERA_OPTIONS], capsys)["results"],
        run_json([str(tmp_path / "lists.csv"), "--camera", file, *CAMERA_OPTIONS[2:]], capsys)["results"],
    ]
    quaternions = [[r["quaternion"] for r in results] for results in answers]
    assert np.allclose(quaternions[0], quaternions[1], atol=1e-12)


def test_text_names_each_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without --json the output has a line for each list and a summary."""
    np.savez(tmp_path / "lists.npz", **arrays(scenes(2)))
    assert main(["solve-lists", str(tmp_path / "lists.npz"), *CAMERA_OPTIONS]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[:5] for line in lines[:2]] == ["0: RA", "1: RA"]
    assert lines[-1].startswith("2 of 2 lists solved, median ")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"first": np.array([0, 5])}, "does not divide the stars"),
        ({"first": np.array([0, 9, 4, 10])}, "does not divide the stars"),
        ({"first": np.array([0.0, 10.0])}, "first in lists.npz is of the wrong kind"),
        ({"first": np.array([], int)}, "has no list"),
        ({"flux": np.ones(9)}, "differ in length"),
        ({"flux": np.full(10, -1.0)}, "flux of star 0 in list 0"),
        ({"col_px": np.full(10, np.nan)}, "col_px of star 0 in list 0"),
        ({"row_px": np.ones((10, 1))}, "row_px in lists.npz is of the wrong kind"),
        ({"row_px": np.full(10, 1 + 1j)}, "row_px in lists.npz is of the wrong kind"),
        ({"row_px": np.array([None] * 10)}, "cannot be read"),
    ],
)
def test_bad_arrays_are_refused(
    change: dict[str, np.ndarray], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Invalid arrays are rejected with a message that states what was expected."""
    good = {"col_px": np.arange(10.0), "row_px": np.arange(10.0), "flux": np.ones(10), "first": np.array([0, 10])}
    np.savez(tmp_path / "lists.npz", **(good | change))
    message = error_of([str(tmp_path / "lists.npz"), *CAMERA_OPTIONS], capsys)
    assert words in message
    assert "Expected" in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"PK\x03\x04 not an archive", "cannot be read"),
        (b"\x89PNG\r\n\x1a\n\xff\xff", "neither .npz nor text"),
        (b"a,b,c,d\n1,2,3,4\n", "does not name the columns"),
        (b"list,col_px,row_px,flux\n0,1,2\n", "Line 2 of lists.any does not have four numbers"),
        (b"list,col_px,row_px,flux\n# sky\n0,1,2,3\n\n0,1,2,3,4\n", "Line 5 of lists.any does not have four numbers"),
        (b"list,col_px,row_px,flux\n1,1,2,3\n\n0,1,2,-3\n", "flux in line 4 of lists.any is invalid"),
        (b"list,col_px,row_px,flux\n0,1,2,x\n", "Line 2 of lists.any does not have four numbers"),
        (b"list,col_px,row_px,flux\n0.5,1,2,3\n", "Line 2 of lists.any has no list"),
        (b"list,col_px,row_px,flux\n9999999999,1,2,3\n", "has no list"),
        (b"list,col_px,row_px,flux\n", "has no list"),
    ],
)
def test_bad_files_are_refused(content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Invalid files are rejected with a message that states what was expected."""
    path = tmp_path / "lists.any"
    path.write_bytes(content)
    message = error_of([str(path), *CAMERA_OPTIONS], capsys)
    assert words in message
    assert "Expected" in message


def test_an_archive_bomb_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A small archive of a huge array is rejected before it is unpacked."""
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("col_px.npy", bytes(MAX_LIST_BYTES + (1 << 20)))
    assert "too large when it is unpacked" in error_of([str(tmp_path / "bomb.npz"), *CAMERA_OPTIONS], capsys)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--camera", "nosuch"], "Unknown instrument"),
        (["--camera", "nosuch.yaml"], "does not exist"),
        (["--camera", "cubestar", "--sigma-px", "0"], "--sigma-px is out of range"),
        (["--camera", "cubestar", "--epoch", "nan"], "--epoch is out of range"),
    ],
)
def test_bad_arguments_are_refused(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unknown cameras and values out of range are rejected with a message."""
    np.savez(tmp_path / "lists.npz", **arrays(scenes(1)))
    assert words in error_of([str(tmp_path / "lists.npz"), *arguments], capsys)
