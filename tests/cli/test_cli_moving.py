"""``gss moving`` on rendered files: a satellite is detected, named and written as TDM."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from gss.cli import main
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from validation.moving.population import population
from validation.moving.scenes import scene

FRAMES = 5


@pytest.fixture(scope="module")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with frames of a scene with a bright satellite, its elements and the orbit of the camera."""
    folder = tmp_path_factory.mktemp("sequence")
    profile, objects = shipped_camera("sunsat"), population(60, np.random.default_rng(1))
    rendered = scene(profile, SolverCache().stars(2026.25), objects, (3.0, 3.5), np.random.default_rng(2))
    for k in range(FRAMES):
        hdu = fits.PrimaryHDU(rendered.images[k])
        hdu.header["DATE-OBS"] = datetime.fromtimestamp(rendered.times_s[k], UTC).isoformat()[:-6]
        hdu.header["EXPTIME"] = profile.sensor.exposure_s
        hdu.writeto(folder / f"{k}.fits")
    (folder / "objects.tle").write_text(objects.text)
    (folder / "orbit.tle").write_text(f"CARRIER\n{objects.observer}\n")
    (folder / "truth").write_text(f"SIM {rendered.tracks[0].row}")
    return folder


def test_a_satellite_is_found_and_named(sequence: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A track has the name of the rendered satellite. The TDM contains one direction per observation of a track."""
    files = [str(sequence / f"{k}.fits") for k in range(FRAMES)]
    orbit_files = ["--objects", str(sequence / "objects.tle"), "--orbit", str(sequence / "orbit.tle")]
    out = sequence / "tracks.tdm"
    command = ["moving", *files, "--camera", "sunsat", "--keep-aberration", *orbit_files]
    assert main([*command, "--json", "--out", str(out)]) == 0
    record = json.loads(capsys.readouterr().out)
    tracks = [t for t in record["tracks"] if not t["streak"]]
    assert (sequence / "truth").read_text() in [t["name"]["name"] for t in tracks]
    assert out.read_text().count("MAG = ") == sum(len(t["times_s"]) for t in record["tracks"])
    assert "PARTICIPANT_1 = CARRIER" in out.read_text()
    assert sum(record["reasons"].values()) >= len(record["rejected"]) > 0


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--site", "1,2"], "Site"),
        (["--site", "here"], "three numbers"),
        (["--objects", "nothing.tle"], "does not exist"),
        (["--rate", "0"], "top_rate_deg_s"),
    ],
)
def test_invalid_arguments_are_rejected(
    sequence: Path, more: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message names the wrong argument."""
    assert main(["moving", str(sequence / "0.fits"), "--camera", "sunsat", *more]) == 2
    assert words.lower() in capsys.readouterr().err.lower()
