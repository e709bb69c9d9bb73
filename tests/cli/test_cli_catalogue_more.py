"""``gss catalogue``: sources, corrections, occultation, reports, differences and import of exported tables."""

from __future__ import annotations

import argparse
import json
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.manifest import read_manifest
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.sources.star_list_export import write_star_list
from gss.cli import join_negatives
from gss.cli.catalogue import register, run_build
from gss.domain.errors import BadInput, CorruptData, GssError

BAND = "--profile sunsat --inclination-deg 97 --raan-deg 133:149 --pointing sunsat --margin-deg 0 --mag-limit 5"
TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482\n"
)


def run_command(command, *arguments):
    parser = argparse.ArgumentParser(prog="gss")
    register(parser.add_subparsers(dest="command", required=True))
    parsed = parser.parse_args(join_negatives(["catalogue", command, *map(str, arguments)]))
    return (
        run_build(parsed, now=lambda: datetime(2026, 12, 1, tzinfo=UTC)) if command == "build" else parsed.run(parsed)
    )


def printed_json(capsys):
    return json.loads(capsys.readouterr().out)


def test_a_build_with_all_options_reports_them(tmp_path, capsys):
    """Output and manifest contain corrections and occultation. The report is a page, and an exported table can be
    imported.
    """
    image, page = tmp_path / "a.bin", tmp_path / "a.html"
    more = "--altitude-km 800 --earth --sun-deg --moon-deg 20 --correct annual_aberration --correct orbital_aberration"
    assert (
        run_command(
            "build", *BAND.split(), *more.split(), "--doubles", "drop", "--out", image, "--report", page, "--json"
        )
        == 0
    )
    result = printed_json(capsys)
    assert result["corrections"] == ["proper_motion", "doubles", "annual_aberration", "orbital_aberration"]
    assert 0 < result["blinded_share"] < 0.5
    assert result["lifetime_days"] > 0
    assert "<svg" in page.read_text("utf-8")
    manifest = json.loads((tmp_path / "a.bin.json").read_text("utf-8"))
    assert manifest["occultation"]["sun_rad"] == pytest.approx(0.4904, abs=1e-3)
    tables = tmp_path / "a.tables.fits"
    assert run_command("export", image, "--kind", "tables-fits", "--out", tables) == 0
    assert run_command("import", tables, "--out", tmp_path / "b.bin") == 0
    assert (tmp_path / "b.bin").read_bytes() == image.read_bytes()
    capsys.readouterr()
    assert run_command("report", image, "--json") == 0
    assert printed_json(capsys)["report"]["quality"]["worst_stars"] == result["worst_field_stars"]
    assert run_command("diff", image, image, "--json") == 0
    same = printed_json(capsys)
    assert (same["same"], same["added"], same["circles_poorer"]) == (result["stars"], [], 0)


def test_a_users_star_list_is_a_source(tmp_path, capsys):
    """A catalogue can be built from a CSV star list of the user."""
    path = tmp_path / "mine.csv"
    path.write_bytes(write_star_list(load_stars(3.0), "csv"))
    assert run_command("build", "--list", path, "--mag-limit", "2.5", "--json") == 0
    result = printed_json(capsys)
    assert (result["source"], result["stars"]) == ("list", len(load_stars(2.5)))


def test_a_list_for_another_camera_is_rejected_by_the_command(tmp_path, capsys):
    """A star list that names a known camera is accepted only for this camera. Another text is accepted for any
    camera.
    """
    path = tmp_path / "mine.csv"
    data = write_star_list(load_stars(3.0), "csv")
    path.write_bytes(b"# camera = sunsat\n" + data)
    with pytest.raises(BadInput, match="star list is for another camera") as caught:
        run_command("build", "--list", path, "--mag-limit", "2.5")
    assert (caught.value.expected, caught.value.got) == ("sunsat", "cubestar")
    assert run_command("build", "--list", path, "--mag-limit", "2.5", "--profile", "sunsat", "--json") == 0
    path.write_bytes(b"# camera = Box Brownie\n" + data)
    assert run_command("build", "--list", path, "--mag-limit", "2.5", "--json") == 0
    capsys.readouterr()


def test_options_select_the_stars(tmp_path, capsys):
    """Output and manifest contain the options for screening, reduced catalogue, thinning and mounting."""
    options = "--screen drop --screen-marks doubles,variables --screen-companions 9 --screen-ring-deg 8:0.05"
    more = "--reduced-frame 36x36,8,4 --thinning frames --brightest-per-field 6 --mounting-deg -10,0,90"
    law = "--pointing inertial --roll-deg -9:9 --pitch-deg -9:9 --yaw-deg 0:0"
    out = tmp_path / "image"
    arguments = f"--mag-limit 5 {options} {more} {law} --json --out {out}".split()
    assert run_command("build", *arguments) == 0
    result = printed_json(capsys)
    assert set(result["screened"]) == {"double", "variable", "companions", "any"}
    assert 0 < result["reduced_stars"] <= result["stars"]
    assert "beyond 6 per upright frame" in result["funnel"]
    parameters = read_manifest(out.with_name("image.json").read_text()).parameters
    mounting = np.reshape(parameters["attitude"]["body_from_cam"], (3, 3))
    assert Rotation.from_matrix(mounting).as_euler("XYZ", degrees=True) == pytest.approx([-10, 0, 90])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--screen drop --screen-marks blue", "unknown mark"),
        ("--screen list --screen-ring-deg wide", "ring cannot be read"),
        ("--thinning squares", "thinning is out of range"),
        ("--reduced-frame 0.1x3", "reduced.width_deg is out of range"),
        ("--pointing inertial --mounting-deg 1,2,3 --body-from-cam 1,0,0,0,1,0,0,0,1", "two mountings"),
        (f"{BAND} --mag-limit -1.9", "leaves no stars"),
        (f"{BAND} --epoch 1900", "epoch of the positions is far"),
        (f"{BAND} --earth", "needs the altitude"),
        (f"{BAND} --roll-deg 5:-5", "minimum is above the maximum"),
        (f"{BAND} --correct magic", "unknown correction"),
        (f"{BAND} --doubles magic", "corrections.doubles is out of range"),
        (f"{BAND} --frame b1875", "corrections.frame is out of range"),
        (f"{BAND} --source sdss", "source is out of range"),
        ("--mag-limit 6", "too large for the bank"),
        ("--correct orbital_aberration", "needs an orbit"),
        (
            "--profile sunsat --pointing inertial --ra-deg 57.3 --dec-deg -57.3 --mag-limit 0",
            "star lies in the envelope",
        ),
        ("--list no-such.csv", "cannot be read"),
    ],
)
def test_each_invalid_option_gives_a_message(arguments, words):
    """Each invalid option raises an error with a message."""
    with pytest.raises(GssError, match=words):
        run_command("build", *arguments.split())


@pytest.mark.parametrize(
    ("text", "date", "words"),
    [
        (TLE.replace("9991", "9992"), "2019-12-10", "wrong checksum"),
        (TLE, "2026-12-01", "outside the TLE's validity"),
        (TLE.replace("15.50103472202482", "17.90103472202488"), "2019-12-10", "decayed"),
    ],
)
def test_bad_tles_are_named(tmp_path, text, date, words):
    """A wrong checksum, dates outside the validity, and an orbit below the ground are rejected."""
    path = tmp_path / "a.tle"
    path.write_text(text)
    with pytest.raises(BadInput, match=words):
        run_command("build", "--tle", path, "--from", date)


@pytest.mark.parametrize(
    ("rows", "words"), [("1,10,10,3\n1,20,20,3\n", "twice"), ("1,nan,10,3\n2,20,20,3\n", "row 1, column ra_deg")]
)
def test_invalid_rows_of_a_list_end_the_build_on_request(tmp_path, rows, words):
    """With --refuse-bad-rows, duplicate numbers and invalid values end the build."""
    path = tmp_path / "a.csv"
    path.write_text("id,ra_deg,dec_deg,v_mag\n" + rows)
    with pytest.raises(BadInput, match=words):
        run_command("build", "--list", path, "--list-epoch", "2000", "--list-frame", "icrs", "--refuse-bad-rows")


@pytest.mark.parametrize("days", ["nan", "inf", "1e300", "-1"])
def test_a_timeline_needs_valid_days(days):
    """Days outside the calendar are rejected with the valid range, before any store is opened."""
    with pytest.raises(BadInput, match="0 to 36525"):
        run_command("timeline", f"--days={days}")


@pytest.mark.parametrize("name", ["a\nb", "a\x1b[31m", "a\x00"])
def test_a_name_is_on_one_line(name):
    """Control characters in the name of a catalogue are rejected."""
    with pytest.raises(BadInput, match=r"control characters|NUL"):
        run_command("build", "--name", name, "--mag-limit", "2")


def test_a_deeply_nested_manifest_is_rejected(tmp_path):
    """A file of 100 000 brackets is rejected with a message."""
    (tmp_path / "a.bin").write_bytes(b"x")
    (tmp_path / "a.bin.json").write_text("[" * 100_000)
    with pytest.raises(CorruptData, match="not a catalogue manifest"):
        run_command("show", tmp_path / "a.bin")


@pytest.mark.parametrize("suffix", ["csv", "ecsv", "fits", "vot"])
def test_the_star_table_is_written_as_a_list_and_built_from(tmp_path, capsys, suffix):
    """``gss catalogue stars`` writes a list in every format, and a build from the list has the same stars as a build from
    Hipparcos."""
    out = tmp_path / f"stars.{suffix}"
    assert run_command("stars", "--mag-limit", "4", "--out", out, "--json") == 0
    assert printed_json(capsys) == {"file": str(out), "stars": len(load_stars(4.0)), "epoch_jyear": 1991.25}
    options = ("--profile", "cubestar", "--mag-limit", "3.5", "--json")
    assert run_command("build", *options, "--source", "list", "--list", out) == 0
    from_list = printed_json(capsys)
    assert run_command("build", *options) == 0
    assert printed_json(capsys)["stars"] == from_list["stars"]


def test_a_star_list_of_another_epoch_or_kind(tmp_path, capsys):
    """The epoch moves the stars, and an unknown suffix is rejected."""
    out = tmp_path / "stars.csv"
    assert run_command("stars", "--mag-limit", "3", "--epoch", "2030", "--out", out) == 0
    assert out.read_text("utf-8").startswith("# epoch_jyear = 2030.0")
    with pytest.raises(BadInput, match="unknown kind"):
        run_command("stars", "--out", tmp_path / "stars.xlsx")
