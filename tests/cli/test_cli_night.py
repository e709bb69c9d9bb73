"""``gss calibrate``, ``gss analyse`` and ``gss sheet`` on the command line, and export of frames as FITS."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from pydantic import TypeAdapter

from gss.cli import main
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.studies.sheet_record import SheetValues
from gss.pipeline.analysis.steady import SIDEREAL_RAD_S
from gss.pipeline.render import render
from gss.settings import Settings
from gss.wiring.build import build

PROFILE = shipped_camera("cubestar")
TRUE = replace(
    PROFILE.camera, focal_col_px=PROFILE.camera.focal_col_px * 1.001, focal_row_px=PROFILE.camera.focal_row_px * 1.001
)


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Paths of eight frames of a camera on the ground, three minutes apart."""
    folder = tmp_path_factory.mktemp("night")
    stars, rng = SolverCache().stars(2026.5).brighter_than(6.5), np.random.default_rng(3)
    names = []
    for k in range(8):
        at_s = 180.0 * k
        attitude = cam_from_icrs(1.4 + SIDEREAL_RAD_S * at_s, 0.2, 0.5)
        image = render(stars, TRUE, PROFILE.sensor, attitude, 0.25, rng)
        hdu = fits.PrimaryHDU(image.pixels)
        hdu.header["DATE-OBS"] = f"2026-07-01T00:{3 * k:02d}:00"
        hdu.header["EXPTIME"] = 0.25
        path = folder / f"night-{k}.fits"
        hdu.writeto(path)
        names.append(str(path))
    return names


def test_a_camera_is_calibrated_from_files(
    night: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The calibration gives the true focal length of the camera, and the report is written."""
    sheet = tmp_path / "camera.pdf"
    assert main(["calibrate", *night, "--camera", "cubestar", "--model", "brown-4", "--json", "--out", str(sheet)]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["values"]["focal_col_px"] == pytest.approx(TRUE.focal_col_px, rel=5e-4)
    assert sheet.read_bytes().startswith(b"%PDF")


def test_a_night_is_analysed_from_files(night: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The analysis gives the sidereal rate as JSON, a text and a report."""
    assert main(["analyse", "earth-fixed", *night, "--camera", "cubestar", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)["figures"]
    assert np.linalg.norm(figures["rate_icrs_rad_s"]) == pytest.approx(SIDEREAL_RAD_S, rel=0.01)
    sheet = tmp_path / "night.html"
    assert main(["analyse", "earth-fixed", *night, "--camera", "cubestar", "--out", str(sheet)]) == 0
    assert "Steadiness" in capsys.readouterr().out
    assert "<svg" in sheet.read_text()


def test_invalid_input_is_rejected_with_a_message(
    night: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unknown kinds, cameras, files and report formats, missing rates and times, and frames without stars give exit code 2 and a
    message."""
    blank = fits.PrimaryHDU(np.zeros((512, 1024), np.uint8))
    blank.header.update({"DATE-OBS": "2026-07-01T00:00:00", "EXPTIME": 0.25})
    blank.writeto(tmp_path / "blank.fits")
    del blank.header["DATE-OBS"]
    untimed = str(tmp_path / "untimed.fits")
    blank.writeto(untimed)
    cases = (
        (["analyse", "earth-fixed", "nothing.fits", "--camera", "cubestar"], "cannot be read"),
        (["analyse", "tides", night[0], "--camera", "cubestar"], "unknown analysis"),
        (["analyse", "slew", night[0], "--camera", "cubestar"], "commanded rate"),
        (["analyse", "earth-fixed", night[0], "--camera", "hubble"], "Unknown instrument"),
        (["analyse", "earth-fixed", night[0], "--camera", "cubestar"], "too few"),
        (["calibrate", str(tmp_path / "blank.fits"), "--camera", "cubestar"], "No frame could be solved"),
        (["calibrate", night[0], "--darks"], "No camera given"),
        (["calibrate", night[0], "--camera", "cubestar", "--darks", "--flats", night[0]], "in pairs"),
        (["analyse", "earth-fixed", night[0], untimed, "--camera", "cubestar"], "got untimed.fits"),
        (["health", *[untimed] * 30, "--camera", "cubestar"], "unknown time"),
        (["moving", untimed, "--camera", "cubestar"], "unknown time"),
        (["sheet", *[untimed] * 5, "--camera", "cubestar"], "unknown time"),
    )
    for arguments, words in cases:
        assert main(arguments) == 2, arguments
        assert words.lower() in capsys.readouterr().err.lower()
    with pytest.raises(SystemExit):
        main(["calibrate", "nothing.fits", "--camera", "cubestar", "--out", str(tmp_path / "x.doc")])
    assert "unknown report format" in capsys.readouterr().err


def test_stored_frames_are_exported_as_fits_with_the_corrections_of_their_sky(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A simulated frame is exported as FITS. When it is solved, aberration is not corrected, because the sky was
    rendered without it.
    """
    services = build(Settings(data=tmp_path / "store"))
    attitude = cam_from_icrs(1.4, 0.2, 0.5)
    image = render(
        SolverCache().stars(2026.5).brighter_than(6.0),
        PROFILE.camera,
        PROFILE.sensor,
        attitude,
        0.25,
        np.random.default_rng(1),
    )
    services.frames.frames._add(
        image.pixels,
        source="device",
        taken=datetime(2026, 7, 1, tzinfo=UTC),
        bits=8,
        exposure_s=0.25,
        profile="cubestar",
        truth=[float(v) for v in image.truth.quaternion],
    )
    services.frames.frames.stop()
    services.base.database.close()
    folder = tmp_path / "out"
    assert main(["export", "fits", "--frames", "1", "--out", str(folder), "--data", str(tmp_path / "store")]) == 0
    capsys.readouterr()
    assert (
        main(
            [
                "solve",
                str(folder / "frame-1.fits"),
                "--camera",
                "cubestar",
                "--truth",
                "80.2141,11.4592,28.6479",
                "--json",
            ]
        )
        == 0
    )
    record = json.loads(capsys.readouterr().out)
    assert record["truth"]["error_arcsec"] < 8


def test_a_sheet_is_made_from_files_and_follows_its_schema(
    night: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The JSON document has the fields of the printed schema, and the report is written as PDF."""
    assert main(["sheet", "--schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    pdf = tmp_path / "sheet.pdf"
    assert main(["sheet", *night, "--camera", "cubestar", "--json", "--out", str(pdf)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert TypeAdapter(SheetValues).validate_python(document)["rows"][0]["key"] == "bias"
    assert set(document) == set(schema["required"])
    assert pdf.read_bytes().startswith(b"%PDF")


def test_a_sheet_needs_a_camera_and_frames(capsys: pytest.CaptureFixture[str]) -> None:
    """Without a camera or frames the error states what is missing."""
    assert main(["sheet"]) == 2
    assert "--camera" in capsys.readouterr().err
    assert main(["sheet", "--camera", "cubestar"]) == 2
    assert "simulated unit" in capsys.readouterr().err
