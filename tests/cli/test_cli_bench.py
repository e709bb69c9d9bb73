"""``gss bench`` on the command line: camera parameters from tables and pictures, and messages for invalid input."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gss.cli import main
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.render import render

SUNSAT = shipped_camera("sunsat")


def run_bench(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Run ``gss bench`` and return the JSON that it prints."""
    assert main(["bench", *arguments, "--json"]) == 0
    return dict(json.loads(capsys.readouterr().out))


def dot_positions(direction: tuple[float, float], turns: int = 36) -> np.ndarray:
    """Return the pixel positions of a dot while the Sunsat camera rotates about its axis."""
    x, y = direction
    c, s = np.cos(angle := np.arange(turns) * 2 * np.pi / turns), np.sin(angle)
    rays = np.column_stack([c * x - s * y, s * x + c * y, np.ones(turns)])
    return SUNSAT.camera.project(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def write_table(path: Path, heading: str, rows: np.ndarray) -> str:
    path.write_text(heading + "\n" + "\n".join(",".join(f"{v:.4f}" for v in row) for row in rows))
    return str(path)


def write_star_picture(path: Path, psf_sigma_px: float, seed: int, ra_rad: float = 1.4) -> str:
    """Write a rendered CubeStar picture of stars and return its path."""
    profile = shipped_camera("cubestar")
    sensor = replace(profile.sensor, psf_sigma_px=psf_sigma_px, zero_point_e_s=4 * profile.sensor.zero_point_e_s)
    catalogue = SolverCache().stars(2026.5).brighter_than(6.0)
    image = render(
        catalogue, profile.camera, sensor, cam_from_icrs(ra_rad, 0.1, 0.4), 0.25, np.random.default_rng(seed)
    )
    Image.fromarray(image.pixels).save(path)
    return str(path)


def test_dots_give_the_optical_centre_and_the_tilt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tables with a heading give the centre of the profile within 0.3 px and its tilt within 0.02°."""
    dots = dot_positions((0.005, 0.001))
    report = run_bench(["dots", write_table(tmp_path / "dots.csv", "col,row", dots)], capsys)
    centre = report["result"]["centre"]
    assert report["kind"] == "bench-centre"
    assert centre["circle"]
    # The detector leans: the circle is met a little off the axis.
    assert centre["col_px"] == pytest.approx(SUNSAT.camera.centre_col_px, abs=0.3)
    assert centre["row_px"] == pytest.approx(SUNSAT.camera.centre_row_px, abs=0.3)
    flat = replace(SUNSAT.camera.distortion, radial=())
    straight = replace(SUNSAT, camera=replace(SUNSAT.camera, distortion=flat))
    angle = np.arange(36) * 2 * np.pi / 36
    outer = np.column_stack([0.06 * np.cos(angle), 0.06 * np.sin(angle), np.ones(36)])
    inner = np.column_stack([0.0 * angle, 0.0 * angle, np.ones(36)])
    places = [straight.camera.project(r / np.linalg.norm(r, axis=1, keepdims=True)) for r in (inner, outer)]
    name = write_table(tmp_path / "pairs.csv", "a,b,c,d", np.hstack(places))
    tilt = run_bench(["tilt", name, "--camera", "sunsat"], capsys)["result"]["tilt"]
    assert np.degrees(tilt["tilt_max_rad"]) == pytest.approx(np.degrees(flat.tilt_max_rad), abs=0.02)


def test_pictures_through_a_second_lens_give_the_principal_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """``gss render`` makes the pictures of a camera with a displaced principal point and dark columns; ``gss bench``
    recovers it within 3 σ and writes a report. Other pictures give exit code 2 and a message.
    """
    pictures = []
    for seed, off in enumerate(("0.004,0", "-0.002,0.0035", "-0.002,-0.0035")):
        pictures.append(str(tmp_path / f"circle-{seed}.png"))
        lens = ["--second-lens", "0.1", f"--second-lens-off={off}", "--centre-off=-31,14.5", "--seed", str(seed)]
        assert main(["render", "--camera", "sunsat", *lens, "--out", pictures[-1]]) == 0
    assert "principal point" in capsys.readouterr().out
    sheet = tmp_path / "centre.pdf"
    report = run_bench(["second-lens", *pictures, "--camera", "sunsat", "--out", str(sheet)], capsys)
    point = report["result"]["second_lens"]
    assert report["kind"] == "bench-second-lens"
    assert [c["sigma_px"] > 0 for c in point["circles"]] == [True] * 3
    for value, centre in (
        (point["col_px"], SUNSAT.camera.centre_col_px - 31),
        (point["row_px"], SUNSAT.camera.centre_row_px + 14.5),
    ):
        assert abs(value - centre) < 3 * point["sigma_px"] < 6
    assert sheet.read_bytes().startswith(b"%PDF")
    assert main(["bench", "second-lens", pictures[0], "--camera", "sunsat"]) == 0
    text = capsys.readouterr().out
    assert text.startswith("Calibration of sunsat")
    assert "by ," not in text
    assert main(["bench", "second-lens", pictures[0], "--camera", "cubestar"]) == 2
    assert "not of this camera" in capsys.readouterr().err
    Image.fromarray(np.full((512, 1024), 9, np.uint8)).save(tmp_path / "even.png")
    assert main(["bench", "second-lens", str(tmp_path / "even.png")]) == 2
    assert "circle of light" in capsys.readouterr().err


def test_dark_current_and_focus_come_from_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Tables give the doubling temperature of the dark current and the best focus position, and reports are written."""
    celsius = np.array([-10.0, 0.0, 10.0, 20.0, 30.0])
    name = write_table(
        tmp_path / "dark.csv", "celsius,electrons", np.column_stack([celsius, 40 * 2 ** ((celsius - 20) / 8)])
    )
    law = run_bench(["dark-law", name], capsys)["result"]["dark_law"]
    assert law["doubling_k"] == pytest.approx(8.0, abs=0.5)
    x = np.linspace(-3, 3, 7)
    name = write_table(tmp_path / "focus.csv", "turn,sigma", np.column_stack([x, np.sqrt(0.16 + 0.2 * (x - 0.5) ** 2)]))
    sheet = tmp_path / "focus.pdf"
    report = run_bench(["focus", "--widths", name, "--camera", "cubestar", "--out", str(sheet)], capsys)
    assert report["result"]["focus_run"]["position"] == pytest.approx(0.5, abs=0.01)
    assert sheet.read_bytes().startswith(b"%PDF")
    assert main(["bench", "dark-law", str(tmp_path / "dark.csv")]) == 0
    assert "doubles every" in capsys.readouterr().out


def test_frames_of_stars_give_focal_length_and_focus(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Pairs of stars give the focal length within one percent. A focus run gives the sharpest setting."""
    frames = [write_star_picture(tmp_path / f"sky-{k}.png", 1.2, k, 1.4 + 0.5 * k) for k in range(4)]
    focal = run_bench(["focal-pairs", *frames, "--camera", "cubestar", "--radius", "200"], capsys)["result"]["focal"]
    assert focal["focal_px"] == pytest.approx(focal["documented_px"], rel=0.01)
    radial = run_bench(["radial", *frames, "--camera", "cubestar", "--order", "2"], capsys)["result"]["radial"]
    assert len(radial["coefficients"]) == 2
    settings = [-2.0, -1.0, 0.0, 1.0, 2.0]
    focus_frames = [
        write_star_picture(tmp_path / f"run-{k}.png", float(np.hypot(0.9, 0.5 * (p - 0.4))), 10)
        for k, p in enumerate(settings)
    ]
    focus = run_bench(["focus", *focus_frames, "--at=-2,-1,0,1,2", "--camera", "cubestar"], capsys)["result"][
        "focus_run"
    ]
    assert focus["position"] == pytest.approx(0.4, abs=0.15)


@pytest.mark.skipif(importlib.util.find_spec("cv2") is None, reason="no OpenCV here")
def test_pictures_without_a_board_are_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Grey pictures without a checkerboard give exit code 2 and a message."""
    names = []
    for k in range(3):
        Image.fromarray(np.full((240, 320), 90 + k, np.uint8)).save(tmp_path / f"{k}.png")
        names.append(str(tmp_path / f"{k}.png"))
    assert main(["bench", "checkerboard", *names, "--corners", "8x6", "--square-mm", "14"]) == 2
    assert "too few pictures" in capsys.readouterr().err.lower()


def test_invalid_bench_input_is_rejected_with_a_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Invalid tables, cameras and settings give exit code 2 and a message."""
    short, words = tmp_path / "short.csv", tmp_path / "words.csv"
    short.write_text("col,row\n1,2\n3\n")
    words.write_text("1,two\n")
    image = tmp_path / "grey.png"
    Image.fromarray(np.zeros((512, 1024), np.uint8)).save(image)
    cases = (
        (["dots", str(tmp_path / "none.csv")], "cannot be read"),
        (["dots", str(short)], "dots_px, item 2"),
        (["dots", str(words)], "line 1"),
        (["focus", "--camera", "cubestar"], "--at, or --widths"),
        (["focus", str(image), "--at", "1,2", "--camera", "cubestar"], "its setting"),
        (["focal-pairs", str(image), "--camera", "hubble"], "Unknown instrument"),
        (["radial", str(image), "--camera", "cubestar", "--order", "7"], "Order is out of range"),
        (["checkerboard", str(image), "--corners", "many", "--square-mm", "1"], "corners"),
    )
    for arguments, expected in cases:
        assert main(["bench", *arguments]) == 2, arguments
        assert expected.lower() in capsys.readouterr().err.lower(), arguments


def test_an_unknown_report_format_is_rejected_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The table does not exist either, but only the format is reported."""
    with pytest.raises(SystemExit) as ended:
        main(["bench", "dots", str(tmp_path / "none.csv"), "--out", str(tmp_path / "result.txt")])
    assert ended.value.code == 2
    assert "unknown report format" in capsys.readouterr().err
