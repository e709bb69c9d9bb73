"""``gss catalogue`` build, show, diff and export: output, files and messages."""

import argparse
import hashlib
import json
import re
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.table import Table

from gss.catalogue_tools.manifest import check_image, read_manifest
from gss.catalogue_tools.onboard import decode
from gss.cli import join_negatives, main
from gss.cli.catalogue import register, run_build
from gss.domain.angles import separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput, CorruptData, NotFound

SUNSAT = [
    *("--profile", "sunsat", "--inclination-deg", "97", "--raan-deg", "133:149", "--mag-limit", "6"),
    *("--pointing", "sunsat", "--margin-deg", "0"),
]
TLE = """ISS (ZARYA)
1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""


def parse(*arguments, command="build"):
    parser = argparse.ArgumentParser(prog="gss")
    register(parser.add_subparsers(dest="command", required=True))
    return parser.parse_args(join_negatives(["catalogue", command, *arguments]))


def run_command(command, *arguments):
    parsed = parse(*arguments, command=command)
    return parsed.run(parsed)


def build(*arguments):
    return run_build(parse(*arguments), now=lambda: datetime(2026, 12, 1, 15, 30, tzinfo=UTC))


def test_sunsat_two_weeks_as_json(capsys):
    """The JSON output has the documented fields, also for negative ranges."""
    assert build(*SUNSAT, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    documented_keys = [
        "stars",
        "pairs",
        "valid_from",
        "valid_to",
        "worst_field_stars",
        "p_fewer_than_3",
        "bytes",
        "sha256",
        "elapsed_s",
    ]
    assert set(documented_keys) <= set(facts)
    assert facts["stars"] == 144
    assert facts["bytes"] == 64 + 12 * 144 + 8 * facts["pairs"]
    assert (facts["valid_from"], facts["valid_to"]) == ("2026-12-01T00:00:00+00:00", "2026-12-15T00:00:00+00:00")
    assert 0 <= facts["p_fewer_than_3"] < 0.2
    assert facts["funnel"]["Hipparcos"] == 117955


def test_written_image_and_manifest_belong_together(tmp_path, capsys):
    """The option --out writes the image and its manifest."""
    path = tmp_path / "sunsat.bin"
    assert build(*SUNSAT, "--out", str(path), "--name", "wk 49", "--author", "cm", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    image = path.read_bytes()
    manifest = read_manifest((tmp_path / "sunsat.bin.json").read_text("utf-8"))
    check_image(manifest, image)
    assert hashlib.sha256(image).hexdigest() == facts["sha256"]
    assert len(decode(image, np.array(manifest.hip))) == facts["stars"]
    assert (manifest.name, manifest.author) == ("wk 49", "cm")


def test_whole_sky_without_an_orbit(capsys):
    """Without an orbit CubeStar's catalogue covers the whole sky and does not expire."""
    assert build("--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["profile"], facts["stars"], facts["valid_to"]) == ("cubestar", 411, None)


def test_a_tle_defines_the_orbit(tmp_path, capsys):
    """A TLE, a start date and a number of days define the orbit and the validity."""
    path = tmp_path / "iss.tle"
    path.write_text(TLE)
    assert build("--tle", str(path), "--from", "2019-12-10", "--days", "3", "--mag-limit", "4", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["valid_to"] == "2019-12-13T00:00:00+00:00"
    assert 50 < facts["stars"] < 519
    assert facts["epoch_jyear"] == pytest.approx(2019.943, abs=0.002)


def test_readable_output_names_every_number(capsys):
    """Without --json the output has one line per value."""
    assert build(*SUNSAT) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split() == ["stars", "144"] for line in lines)
    assert any(line.startswith("inside the envelope") for line in lines)


def test_camera_held_still(capsys):
    """Inertial pointing needs no orbit. A negative declination is read as a number, not as an option."""
    still = "--pointing inertial --ra-deg 83.8 --dec-deg -5.4 --roll-deg 0 --pitch-deg 0 --yaw-deg -180:180"
    assert build(*still.split(), "--mag-limit", "5", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["worst_field_stars"] > 20
    assert facts["worst_field_dec_deg"] == pytest.approx(-5.4, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ("--profile hubble", NotFound, "unknown instrument"),
        ("--raan-deg 10:20", BadInput, "needs an inclination"),
        ("--inclination-deg 97 --raan-deg 20:10", BadInput, "the minimum is above the maximum"),
        ("--roll-deg -5:5", BadInput, "attitude limits without an orbit"),
        ("--tle no-such-file", BadInput, "cannot be read"),
        ("--tle x --inclination-deg 3", BadInput, "two orbits"),
        ("--from yesterday", BadInput, "the start is not a date"),
        ("--mag-limit 9", BadInput, "does not reach this magnitude limit"),
        ("--mag-limit 6", BadInput, "too large for the bank"),
        ("--out /no/such/folder/file", BadInput, "folder of the output does not exist"),
    ],
)
def test_bad_input_has_a_clear_message(arguments, error, words):
    """Each invalid argument raises an error with a message, which gives exit code 2."""
    with pytest.raises(error, match=words):
        build(*arguments.split())


@pytest.mark.parametrize("text", ["ten", "1:2:3", ":", "5:"])
def test_an_invalid_range_is_rejected(text, capsys):
    """A range that is neither MIN:MAX nor a number gives exit code 2 and a message."""
    with pytest.raises(SystemExit, match="2"):
        parse("--roll-deg", text)
    assert "expected MIN:MAX or one number in degrees" in capsys.readouterr().err


@pytest.fixture
def two_weeks(tmp_path, capsys):
    """Two catalogues of consecutive two-week periods, from Ω 133° and from Ω 149°."""
    paths = [tmp_path / "a.bin", tmp_path / "b.bin"]
    for path, raan in zip(paths, ("133:149", "149:165"), strict=True):
        arguments = [raan if a == "133:149" else a for a in SUNSAT]
        assert build(*arguments, "--epoch", "2026.95", "--out", str(path)) == 0
    capsys.readouterr()
    return paths


def test_show_checks_the_image_and_prints_its_content(two_weeks, capsys):
    """``show`` prints the content of image and manifest, and rejects an image with a changed byte."""
    assert run_command("show", str(two_weeks[0]), "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["stars"], facts["profile"], facts["frame"]) == (144, "sunsat", "ICRS")
    assert facts["bytes"] == two_weeks[0].stat().st_size
    image = bytearray(two_weeks[0].read_bytes())
    image[500] ^= 1
    two_weeks[0].write_bytes(image)
    with pytest.raises(CorruptData, match="does not belong to the manifest"):
        run_command("show", str(two_weeks[0]))


def test_diff_lists_added_and_removed_stars(two_weeks, capsys):
    """``diff`` lists stars that were added and removed after two weeks, and no moved stars."""
    assert run_command("diff", *map(str, two_weeks), "--json") == 0
    difference = json.loads(capsys.readouterr().out)
    assert len(difference["dropped"]) + difference["same"] == 144
    assert difference["added"]
    assert difference["dropped"]
    assert (difference["moved"], difference["magnitude_changed"]) == ([], [])


@pytest.mark.parametrize("kind", ["csv", "ecsv", "fits"])
def test_exports_hold_the_stars(two_weeks, kind, tmp_path):
    """astropy reads the stars of the image from each kind of export."""
    out = tmp_path / f"stars.{kind}"
    assert run_command("export", str(two_weeks[0]), "--kind", kind, "--out", str(out)) == 0
    formats = {"csv": {"format": "ascii.csv"}, "ecsv": {"format": "ascii.ecsv"}, "fits": {"format": "fits", "hdu": 1}}
    table = Table.read(out, **formats[kind])
    manifest = read_manifest((two_weeks[0].parent / "a.bin.json").read_text("utf-8"))
    catalogue = decode(two_weeks[0].read_bytes(), np.array(manifest.hip))
    assert table["hip"].tolist() == list(manifest.hip)
    ra, dec = (np.radians(np.asarray(table[c])) for c in (table.colnames[2], table.colnames[3]))
    assert separation_rad(unit_from_ra_dec(ra, dec), catalogue.icrs).max() < 3e-9


def test_missing_files_and_unknown_kinds_are_named(two_weeks, tmp_path):
    """Missing files and unknown kinds of export are rejected with a message."""
    with pytest.raises(BadInput, match="cannot be read"):
        run_command("show", str(tmp_path / "none.bin"))
    with pytest.raises(BadInput, match=r"csv \| ecsv \| fits"):
        run_command("export", str(two_weeks[0]), "--kind", "papyrus", "--out", str(tmp_path / "x"))


def test_the_bank_size_is_that_of_the_package(tmp_path, capsys, monkeypatch):
    """Without --bank-bytes, a catalogue is built for the banks of the package. A catalogue larger than this bank is rejected,
    even if it fits the banks of the shipped instruments.
    """
    monkeypatch.setenv("GSS_DATA", str(tmp_path))
    folder = tmp_path / "instruments" / "small_unit"
    assert main(["instrument", "new", "small_unit", "--from", "sunsat", "--into", str(folder.parent)]) == 0
    capsys.readouterr()
    few_stars = ("--mag-limit", "5.5", "--json")
    assert build(*SUNSAT, *few_stars) == 0
    shipped = json.loads(capsys.readouterr().out)
    assert shipped["bank_bytes"] == 196_608
    unit = ("--profile", "small_unit", *SUNSAT[2:], *few_stars)
    catalogue = folder / "catalogue.yaml"
    for bank_bytes, fits in ((shipped["bytes"], True), (shipped["bytes"] - 1, False)):
        catalogue.write_text(re.sub(r"bank_bytes: \d+", f"bank_bytes: {bank_bytes}", catalogue.read_text()))
        if fits:
            assert build(*unit) == 0
            assert json.loads(capsys.readouterr().out)["bank_bytes"] == bank_bytes
        else:
            with pytest.raises(BadInput, match="too large for the bank"):
                build(*unit)
