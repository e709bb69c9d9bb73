"""``gss solve`` on the command line: output, exit codes and messages."""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import shutil
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.cli import main
from gss.cli.solve import julian_year, register
from gss.domain.frames import cam_from_icrs, ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion, rotation_from_vector
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.operations.frames.solve import CHAINS
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.render import render


@pytest.fixture(scope="module")
def sky_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a rendered CubeStar frame at RA 80.2°, Dec 0°, roll 57.3°, dated 2025."""
    profile = shipped_camera("cubestar")
    stars = SolverCache().stars(2025.0).brighter_than(4.5)
    rotation = cam_from_icrs(np.radians(80.2), 0.0, 1.0)
    frame = render(stars, profile.camera, profile.sensor, rotation, profile.sensor.exposure_s, np.random.default_rng(1))
    path = tmp_path_factory.mktemp("sky") / "frame.fits"
    hdu = fits.PrimaryHDU(frame.pixels)
    hdu.header["DATE-OBS"] = "2025-01-01T12:00:00"
    hdu.writeto(path)
    return path


def run_solve(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    register(parser.add_subparsers(required=True))
    parsed = parser.parse_args(["solve", *arguments])
    return int(parsed.run(parsed))


def test_json_has_the_attitude_and_its_errors(sky_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The JSON object has all documented keys, the correct attitude and the epoch of the image."""
    assert run_solve(str(sky_file), "--camera", "cubestar", "--json") == 0
    out = json.loads(capsys.readouterr().out)
    assert {
        "outcome", "ra_deg", "dec_deg", "roll_deg", "quaternion", "sigma_arcsec", "matched", "centroids",
        "false_match_probability", "fov_deg", "timing_ms", "reason", "residual_rms_px", "file", "chain",
    } <= set(out)  # fmt: skip
    assert out["outcome"] == "solved"
    assert out["chain"] == "reference"
    assert abs(out["ra_deg"] - 80.2) < 0.01
    assert abs(out["dec_deg"]) < 0.01
    assert abs(out["roll_deg"] - np.degrees(1.0)) < 0.05
    truth = cam_from_icrs(np.radians(80.2), 0.0, 1.0)
    assert np.abs(matrix_from_quaternion(np.array(out["quaternion"])) - truth).max() < 1e-3
    assert 0 < out["sigma_arcsec"] < 60
    assert any("2025.00" in note for note in out["notes"])
    assert out["timing_ms"]["detect"] > 0


def test_text_is_short_and_readable(sky_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without --json the output is a few lines with right ascension and false-match probability."""
    assert run_solve(str(sky_file), "--fov-deg", "50") == 0
    out = capsys.readouterr().out
    assert "RA 80.1" in out or "RA 80.2" in out
    assert "false-match probability" in out
    assert len(out.splitlines()) < 8


def test_cubestar_chain(sky_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The option --chain cubestar runs the chain of the sensor."""
    assert run_solve(str(sky_file), "--camera", "cubestar", "--chain", "cubestar", "--json") == 0
    out = json.loads(capsys.readouterr().out)
    assert out["chain"] == "cubestar"
    assert abs(out["ra_deg"] - 80.2) < 0.05


def test_no_solution_is_exit_code_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An image without stars gives exit code 3, a reason, nulls in the JSON and no text on standard error."""
    path = tmp_path / "empty.png"
    Image.fromarray(np.random.default_rng(2).normal(40, 4, (300, 400)).astype(np.uint8)).save(path)
    assert run_solve(str(path), "--blind", "--json") == 3
    captured = capsys.readouterr()
    out = json.loads(captured.out)
    assert out["outcome"] == "none"
    assert out["reason"]
    assert out["ra_deg"] is None
    assert captured.err == ""
    assert run_solve(str(path), "--blind") == 3
    assert "no solution" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "does not exist"), (b"", "is empty"), (b"hello world, this is text", "is not a supported image file")],
)
def test_bad_input_is_exit_code_2_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, words: str
) -> None:
    """A missing, empty or unsupported file gives exit code 2 and one line on standard error."""
    path = tmp_path / "file.png"
    if content is not None:
        path.write_bytes(content)
    assert run_solve(str(path), "--blind") == 2
    captured = capsys.readouterr()
    assert words.lower() in captured.err.lower()
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""


def test_unknown_names_and_sizes_are_exit_code_2(
    sky_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An unknown profile or chain, a folder, a frame of another size and an impossible field of view give exit code
    2.
    """
    assert run_solve(str(sky_file), "--camera", "hubble") == 2
    assert run_solve(str(sky_file), "--camera", "cubestar", "--chain", "magic") == 2
    assert run_solve(str(sky_file), "--camera", "sunsat") == 2
    assert run_solve(str(tmp_path), "--blind") == 2
    assert run_solve(str(sky_file), "--fov-deg", "500") == 2
    assert len(capsys.readouterr().err.splitlines()) == 5


def test_several_files_continue_after_an_invalid_one(
    sky_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A valid file after an invalid one is solved. The exit code reports the invalid file."""
    assert run_solve(str(tmp_path / "nothing"), str(sky_file), "--camera", "cubestar", "--json") == 2
    assert json.loads(capsys.readouterr().out)["outcome"] == "solved"


def test_exactly_one_camera_option_is_required(sky_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The parser rejects a missing, an invalid and a second camera option."""
    for options in ([], ["--blind", "--camera", "cubestar"], ["--fov-deg", "wide"]):
        with pytest.raises(SystemExit) as stop:
            run_solve(str(sky_file), *options)
        assert stop.value.code == 2
    capsys.readouterr()


def test_julian_year() -> None:
    """J2000.0 is noon of 1 January 2000, TT."""
    assert julian_year(datetime(2000, 1, 1, 11, 58, 55, 816000, tzinfo=UTC)) == pytest.approx(2000.0, abs=1e-9)
    assert julian_year(datetime(2025, 1, 1, tzinfo=UTC)) == pytest.approx(2025.0, abs=0.003)


def test_as_a_process(sky_file: Path) -> None:
    """As a process, the command prints JSON to a pipe and ends with exit code 0."""
    code = (
        "import argparse, sys; from gss.cli.solve import register; p = argparse.ArgumentParser(); "
        "register(p.add_subparsers(required=True)); a = p.parse_args(sys.argv[1:]); sys.exit(a.run(a))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "solve", str(sky_file), "--camera", "cubestar", "--json"],
        capture_output=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.load(io.BytesIO(done.stdout))["outcome"] == "solved"


@pytest.mark.parametrize("encoding", ["ascii", "utf-8:strict"])
@pytest.mark.parametrize("form", [[], ["--json"]])
def test_any_encoding_and_any_file_name_can_be_printed(
    sky_file: Path, tmp_path: Path, encoding: str, form: list[str]
) -> None:
    """Degrees, and a file name that is not UTF-8, do not end the command; JSON stays valid."""
    name = tmp_path / os.fsdecode(b"sk\xffy.png")
    shutil.copy(sky_file, name)
    done = subprocess.run(
        [sys.executable, "-m", "gss", "solve", str(name), "--camera", "cubestar", *form],
        capture_output=True, timeout=60, check=False, env=os.environ | {"PYTHONIOENCODING": encoding},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")
    if form:
        assert json.loads(done.stdout.decode("utf-8"))["outcome"] == "solved"


def test_a_few_files_of_an_unknown_camera_load_no_compiled_loops_and_no_registry(sky_file: Path) -> None:
    """Both take longer to load than the solution of a file."""
    code = f"import sys; from gss.cli import main; main(['solve', {str(sky_file)!r}, '--blind']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "gss.operations.frames.solve" in loaded
    assert not {"numba", "gss.pipeline.loops", "gss.instruments.registry"} & loaded


def test_a_sequence_has_no_rate_across_an_unreadable_image(
    sky_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """After an unreadable image of a sequence, the next image has no rate and the one after it has a rate."""
    damaged, sky = tmp_path / "damaged.png", tmp_path / "sky.png"
    damaged.write_bytes(b"text")
    Image.fromarray(fits.getdata(sky_file).astype(np.uint8)).save(sky)
    files = [str(sky), str(damaged), str(sky), str(sky)]
    assert run_solve(*files, "--camera", "cubestar", "--sequence", "--interval", "1", "--json") == 2
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["outcome"] for record in records] == ["solved"] * 3
    assert [record["rate"] is None for record in records] == [True, True, False]


def test_a_sequence_is_tracked_and_reports_the_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rate of a camera that rotates by 0.1°/s about its y axis is measured in a sequence of three images."""
    stars, profile, rng = propagate(load_stars(6.0), 2026.0), shipped_camera("cubestar"), np.random.default_rng(2)
    start, names, truths = cam_from_icrs(1.4, 0.1, 0.5), [], {}
    for k in range(3):
        attitude = rotation_from_vector(np.array([0.0, -math.radians(0.1) * k, 0.0])) @ start
        rendered = render(stars, profile.camera, profile.sensor, attitude, 0.25, rng)
        names.append(str(tmp_path / f"{k}.png"))
        Image.fromarray(rendered.pixels).save(names[-1])
        truths[f"{k}.png"] = [math.degrees(a) for a in ra_dec_roll_rad(attitude)]
    (tmp_path / "truth.json").write_text(json.dumps(truths))
    options = ["--camera", "cubestar", "--sequence", "--interval", "1", "--epoch", "2026", "--json"]
    assert main(["solve", *names, *options, "--truth", str(tmp_path / "truth.json")]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert records[0]["rate"] is None
    for record in records[1:]:
        assert record["rate"]["deg_s"] == pytest.approx([0.0, 0.1, 0.0], abs=0.02)
    assert all(r["truth"]["verdict"] in ("correct", "imprecise") for r in records)
    assert all(r["truth"]["error_arcsec"] < 30 for r in records)


@pytest.mark.parametrize("chain", CHAINS)
def test_every_chain_takes_a_hint(chain: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With its camera and a hint within a degree, each chain finds the true attitude or no solution."""
    profile = shipped_camera(chain) if chain in shipped_registry().cameras() else shipped_camera("cubestar")
    stars = propagate(load_stars(7.5), 2026.0)
    rendered = render(
        stars,
        profile.camera,
        profile.sensor,
        cam_from_icrs(1.45, 0.05, 0.3),
        profile.sensor.exposure_s,
        np.random.default_rng(4),
    )
    file = tmp_path / "one.png"
    Image.fromarray(rendered.pixels).save(file)
    options = ["--camera", profile.name, "--chain", chain, "--epoch", "2026", "--json"]
    hint = f"{math.degrees(1.45) + 0.4},{math.degrees(0.05)},{math.degrees(0.3)},1"
    code = main(
        [
            "solve",
            str(file),
            *options,
            "--hint",
            hint,
            "--truth",
            f"{math.degrees(1.45)},{math.degrees(0.05)},{math.degrees(0.3)}",
        ]
    )
    record = json.loads(capsys.readouterr().out)
    assert (code, record["chain"]) in ((0, chain), (3, chain))
    if code == 0:
        assert record["truth"]["verdict"] != "wrong"


@pytest.mark.parametrize(
    "options", [["--hint", "1,2"], ["--hint", "1,200,3"], ["--truth", "x"], ["--sequence", "--interval", "-1"]]
)
def test_invalid_hints_and_truths_are_rejected(
    options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Invalid hints, truths and intervals give exit code 2 and a message."""
    assert main(["solve", str(tmp_path / "x.png"), "--camera", "cubestar", *options]) == 2
    assert "Expected" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"x.png": {"attitude_deg": [NaN, 10, 0]}}', "got [nan, 10, 0]"),
        ('{"x.png": [84, 10]}', "got [84, 10]"),
        ('{"y.png": [84, 10, 0]}', "got no x.png"),
    ],
)
def test_a_truth_file_without_a_finite_attitude_of_each_image_is_rejected(
    content: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a true attitude there is no verdict; the solution is neither wrong nor silently unchecked."""
    truth = tmp_path / "truth.json"
    truth.write_text(content, "utf-8")
    assert main(["solve", str(tmp_path / "x.png"), "--camera", "cubestar", "--truth", str(truth)]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--exposure", "inf"), "Exposure is out of range"),
        (("--exposure", "1e308"), "at most 86400 s"),
        (("--utc", "9999-12-31T23:59:59"), "Time is out of range"),
        (("--utc", "0001-01-01"), "Time is out of range"),
        (("--utc", "2026-12-01", "--tle", "no-such.tle"), "Expected a two-line element set"),
        (("--utc", "2026-12-01", "--tle", "."), "Expected a two-line element set"),
    ],
)
def test_impossible_exposures_and_times_are_rejected(
    sky_file: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], words: str
) -> None:
    """Impossible exposures and times and missing element sets give exit code 2 and one message."""
    assert run_solve(str(sky_file), "--camera", "cubestar", *more) == 2
    errors = capsys.readouterr().err
    assert words in errors
    assert len(errors.splitlines()) == 1
