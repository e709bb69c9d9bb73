"""``gss render --frames`` writes a sequence with truth that ``gss solve`` reads and the solver confirms."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gss.cli import main
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs, orbit_from_icrs, pointing_difference_rad
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix
from gss.instruments.registry import shipped_camera
from gss.operations.frames.frame_files import read_frame
from gss.operations.frames.rendered_sequence import constant_rate, earth_pointing, moments_of
from gss.orbit.attitude import AttitudeHistory
from gss.orbit.read_orbit import read_orbit
from gss.orbit.trajectory import EphemerisSegment, EphemerisTrajectory
from gss.orbit.write_attitude import aem_of

TLE = (
    "1 44714U 19074B   26181.50000000  .00001103  00000+0  92918-4 0  9991\n"
    "2 44714  53.0540 120.0000 0001400  80.0000 280.0000 15.06400000    12\n"
)
START = "2026-11-26T00:00:00Z"
MOVING = ["--at", "84,-2,30", "--rate", "0.1,0.05,-0.2", "--interval", "2", "--start", START]


def render(out: Path, *options: str, camera: str = "cubestar") -> int:
    return main(["render", "--camera", camera, "--out", str(out), *options])


def read_truth(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "truth.json").read_text()))


def test_a_sequence_is_solved_and_agrees_with_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``gss solve --sequence`` of a rotating camera gives the attitudes within 20″ and the rates within 0.01°/s of the truth,
    with the times of the files."""
    folder = tmp_path / "pass"
    assert render(folder, *MOVING, "--frames", "3", "--false-stars", "2") == 0
    assert "3 images" in capsys.readouterr().out
    truth = read_truth(folder)
    files = sorted(folder.glob("*.fits"))
    assert [f.name for f in files] == list(truth) == [f"image-000{k}.fits" for k in (1, 2, 3)]
    solve = ["solve", *map(str, files), "--camera", "cubestar", "--sequence", "--json"]
    assert main([*solve, "--truth", str(folder / "truth.json")]) == 0
    results = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    for k, (result, row) in enumerate(zip(results, truth.values(), strict=True)):
        assert result["truth"]["verdict"] == "correct"
        assert result["truth"]["error_arcsec"] < 20
        assert row["time_utc"] == f"2026-11-26T00:00:0{2 * k}.000+00:00"
        assert row["rate_deg_s"] == pytest.approx([0.1, 0.05, -0.2], abs=1e-9)
        if k:
            assert result["rate"]["interval_s"] == 2.0
            assert result["rate"]["deg_s"] == pytest.approx(row["rate_deg_s"], abs=0.01)


def test_truth_describes_the_pixels(tmp_path: Path) -> None:
    """A file has time, exposure and camera. The quaternion equals the angles and the positions of the stars are the
    projections by the camera; the brightest star is bright in the image."""
    folder = tmp_path / "still"
    assert render(folder, "--at", "84,-2,30", "--frames", "2", "--start", START, "--no-noise", camera="sunsat") == 0
    row = read_truth(folder)["image-0002.fits"]
    profile = shipped_camera("sunsat")
    frame = read_frame((folder / "image-0002.fits").read_bytes(), "image-0002.fits")
    assert frame.taken_at == datetime(2026, 11, 26, 0, 0, 1, tzinfo=UTC)
    assert frame.seen_at is None, "the sky is drawn without aberration"
    assert frame.exposure_s == row["exposure_s"] == profile.sensor.exposure_s
    assert frame.source["instrume"] == "sunsat"
    attitude = cam_from_icrs(*np.radians(row["attitude_deg"]))
    assert np.allclose(matrix_from_quaternion(np.array(row["quaternion"])), attitude, atol=1e-12)
    pixels, dark = profile.sensor.dark_columns.split(frame.pixels, profile.camera.columns)
    assert dark is not None
    magnitudes = [star["v_mag"] for star in row["stars"]]
    assert len(magnitudes) > 5
    assert magnitudes == sorted(magnitudes)
    assert magnitudes[-1] <= profile.sensor.faint_limit_mag
    for star in row["stars"][:3]:
        col, line = round(star["col_px"]), round(star["row_px"])
        assert pixels[line, col] > np.median(pixels) + 5


def test_images_differ_in_noise_and_equal_commands_give_equal_files(tmp_path: Path) -> None:
    """Two images of a still camera differ in noise only. The same command gives the same files."""
    for name in ("a", "b"):
        assert render(tmp_path / name, "--at", "84,-2,30", "--frames", "2", "--start", START) == 0
    first, second = (read_frame((tmp_path / "a" / f"image-000{k}.fits").read_bytes(), "f").pixels for k in (1, 2))
    assert (first != second).any()
    for name in ("image-0001.fits", "image-0002.fits", "truth.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_attitudes_of_a_message_are_followed(tmp_path: Path) -> None:
    """The images of an attitude message have its attitudes and rates. A sequence longer than the message is rejected before a
    file is written."""
    start = datetime(2026, 11, 26, tzinfo=UTC)
    times_s = start.timestamp() + np.arange(0.0, 40.0, 4.0)
    motion = constant_rate(cam_from_icrs(1.4, 0.1, 0.5), np.radians([0.02, -0.05, 0.1]), start)
    history = AttitudeHistory("SAT", "STARTRACKER_1", times_s, motion(times_s), np.full((10, 3), np.nan))
    message = tmp_path / "camera.aem"
    message.write_text("".join(aem_of(history, start)))
    options = ["--attitudes", str(message), "--interval", "6"]
    assert render(tmp_path / "out", *options, "--frames", "3") == 0
    for k, row in enumerate(read_truth(tmp_path / "out").values()):
        expected = motion(np.array([times_s[0] + 6 * k]))[0]
        assert np.abs(np.array(row["quaternion"]) @ expected) == pytest.approx(1, abs=1e-9)
        assert row["rate_deg_s"] == pytest.approx([0.02, -0.05, 0.1], abs=1e-4)
    assert render(tmp_path / "long", *options, "--frames", "9") == 2
    assert not (tmp_path / "long").exists()


def test_a_pass_of_an_orbit_points_to_the_zenith(tmp_path: Path) -> None:
    """The camera on an orbit looks to the zenith with +x along the velocity, and rotates once per orbit."""
    orbit = read_orbit(TLE).orbit
    moments = moments_of(earth_pointing(orbit), orbit.epoch, 30.0, 3, 0.3)
    for moment in moments:
        cam = matrix_from_quaternion(moment.quaternion)
        at_s = np.array([moment.at.timestamp()])
        place = orbit.teme_km(at_s)[0]
        ahead = orbit.teme_km(at_s + 1)[0] - place
        # Precession between TEME of date and ICRS is about 0.36° in 2026.
        assert np.degrees(np.arccos(cam[2] @ place / np.linalg.norm(place))) < 0.5
        assert np.degrees(np.arccos(cam[0] @ ahead / np.linalg.norm(ahead))) < 0.5
        assert np.degrees(moment.rate_rad_s) == pytest.approx([0, 360 * 15.064 / 86400, 0], abs=2e-3)
    (tmp_path / "sat.tle").write_text(TLE)
    assert render(tmp_path / "out", "--orbit", str(tmp_path / "sat.tle"), "--frames", "1") == 0
    assert read_truth(tmp_path / "out")["image-0001.fits"]["time_utc"].startswith("2026-06-30T12:00:00")


def test_an_ephemeris_gives_attitudes_from_its_first_to_its_last_state() -> None:
    """The first and last state of an OEM have an attitude and a rate. Later times have none."""
    orbit = read_orbit(TLE).orbit
    seconds = orbit.epoch.timestamp() + 60.0 * np.arange(12)
    ephemeris = EphemerisTrajectory((EphemerisSegment(seconds, orbit.teme_km(seconds)),))
    moments = moments_of(earth_pointing(ephemeris), ephemeris.start, 660.0, 2, 0.3)
    expected = moments_of(earth_pointing(orbit), orbit.epoch, 660.0, 2, 0.3)
    for moment, other in zip(moments, expected, strict=True):
        assert np.abs(moment.quaternion @ other.quaternion) == pytest.approx(1, abs=1e-6)
        assert moment.rate_rad_s == pytest.approx(other.rate_rad_s, abs=1e-5)
    with pytest.raises(BadInput, match="o attitude at"):
        moments_of(earth_pointing(ephemeris), ephemeris.start, 661.0, 2, 0.3)


def test_the_orbit_axes_agree_with_those_of_the_catalogues() -> None:
    """A circular orbit gives the axes of ``orbit_from_icrs`` with the camera along −z, within the precession of TEME."""
    orbit = read_orbit(TLE).orbit
    quaternion = earth_pointing(orbit)(np.array([orbit.epoch.timestamp()]))[0]
    axes = orbit_from_icrs(np.radians(120.0), np.radians(53.054), np.radians(80.0 + 280.0))
    zenith_camera = np.diag([1.0, -1.0, -1.0]) @ axes
    cross_rad, about_rad = pointing_difference_rad(matrix_from_quaternion(quaternion), zenith_camera)
    assert np.degrees([cross_rad, about_rad]).max() < 0.6
    assert quaternion == pytest.approx(quaternion_from_matrix(matrix_from_quaternion(quaternion)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([*MOVING, "--frames", "0"], "1 – 2000"),
        ([*MOVING, "--frames", "2", "--interval", "0.1"], "Interval is out of range"),
        ([*MOVING, "--frames", "2", "--interval", "nan"], "Interval is out of range"),
        ([*MOVING, "--frames", "2", "--truth", "t.json"], "truth.json in its folder"),
        ([*MOVING, "--frames", "2", "--false-stars", "-1"], "0 – 500"),
        ([*MOVING, "--frames", "2", "--rate", "900,0,0"], "rotates too fast"),
        ([*MOVING, "--frames", "2", "--exposure", "0"], "Exposure is out of range"),
        ([*MOVING, "--frames", "2", "--start", "soon"], "Unreadable time"),
        (["--attitudes", "none.aem", "--frames", "2"], "none.aem"),
        (["--orbit", "bad.tle", "--frames", "2"], "line"),
        (["--orbit", "sat.tle", "--frames", "2", "--start", "2036-01-01T00:00:00Z"], "No attitude at 2036-01-01"),
        (["--orbit", "sat.tle"], "--frames N"),
        (["--second-lens", "0.2", "--frames", "2"], "no motion"),
    ],
)
def test_impossible_sequences_are_rejected_before_a_file_is_written(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Impossible options give exit code 2 and the reason, and no folder is created."""
    monkeypatch.chdir(tmp_path)
    Path("bad.tle").write_text("1 nothing\n2 nothing\n")
    Path("sat.tle").write_text(TLE)
    assert render(Path("out"), *options) == 2
    assert message.lower() in capsys.readouterr().err.lower()
    assert not Path("out").exists()


def test_existing_files_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A sequence or an image that would replace a file is rejected without a change; --overwrite replaces it. A file in the
    place of the folder is rejected."""
    folder, image = tmp_path / "out", tmp_path / "a.png"
    folder.mkdir()
    (folder / "image-0002.fits").write_text("mine")
    assert render(folder, *MOVING, "--frames", "2") == 2
    assert "would be overwritten" in capsys.readouterr().err
    assert [p.name for p in folder.iterdir()] == ["image-0002.fits"]
    assert (folder / "image-0002.fits").read_text() == "mine"
    assert render(folder, *MOVING, "--frames", "2", "--overwrite") == 0
    assert sorted(p.name for p in folder.iterdir()) == ["image-0001.fits", "image-0002.fits", "truth.json"]
    image.write_text("mine")
    assert render(image, "--at", "84,-2,30") == 2
    assert render(image, *MOVING, "--frames", "2") == 2
    assert image.read_text() == "mine"
    assert render(image, "--at", "84,-2,30", "--overwrite") == 0


def test_an_interrupted_sequence_keeps_its_images_with_their_truth(tmp_path: Path) -> None:
    """After Ctrl-C the exit code is 130, the truth lists exactly the complete images, and no partial file remains."""
    folder = tmp_path / "long"
    command = [sys.executable, "-m", "gss", "render", "--camera", "aim", *MOVING, "--frames", "2000", "--rate", "0,0,0"]
    # A process that is started in the background ignores Ctrl-C, and the processes that it starts inherit this.
    command = ["env", "--default-signal=INT", *command, "--interval", "10", "--out", str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    try:
        end = time.monotonic() + 120
        while not (folder / "image-0003.fits").exists() and time.monotonic() < end:
            time.sleep(0.02)
        process.send_signal(2)
        assert process.wait(60) == 130
    finally:
        process.kill()
        process.communicate()
    truth = read_truth(folder)
    files = sorted(p.name for p in folder.glob("*.fits"))
    assert 3 <= len(files) < 2000
    # The interrupt can arrive between the rename of an image and its entry.
    assert list(truth) in (files, files[:-1])
    assert not list(folder.glob("*.part"))
