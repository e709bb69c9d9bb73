"""gss catalogue build, from arguments to what it prints and writes."""

import argparse
import hashlib
import json
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy.table import Table

from gss.catalogue_tools.manifest import check_image, read_manifest
from gss.catalogue_tools.onboard import decode
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
    return parser.parse_args(["catalogue", command, *arguments])


def do(command, *arguments):
    parsed = parse(*arguments, command=command)
    return parsed.run(parsed)


def run(*arguments):
    return run_build(parse(*arguments), now=lambda: datetime(2026, 12, 1, 15, 30, tzinfo=UTC))


def test_sunsat_two_weeks_as_json(capsys):
    """The JSON output has the documented fields, also for negative ranges."""
    assert run(*SUNSAT, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    promised = [
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
    assert set(promised) <= set(facts)
    assert facts["stars"] == 144
    assert facts["bytes"] == 64 + 12 * 144 + 8 * facts["pairs"]
    assert (facts["valid_from"], facts["valid_to"]) == ("2026-12-01T00:00:00+00:00", "2026-12-15T00:00:00+00:00")
    assert 0 <= facts["p_fewer_than_3"] < 0.2
    assert facts["funnel"]["Hipparcos"] == 117955


def test_written_image_and_manifest_belong_together(tmp_path, capsys):
    """--out writes the image and, beside it, the manifest that proves it."""
    path = tmp_path / "sunsat.bin"
    assert run(*SUNSAT, "--out", str(path), "--name", "wk 49", "--author", "cm", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    image = path.read_bytes()
    manifest = read_manifest((tmp_path / "sunsat.bin.json").read_text("utf-8"))
    check_image(manifest, image)
    assert hashlib.sha256(image).hexdigest() == facts["sha256"]
    assert len(decode(image, np.array(manifest.hip))) == facts["stars"]
    assert (manifest.name, manifest.author) == ("wk 49", "cm")


def test_whole_sky_without_an_orbit(capsys):
    """Without an orbit CubeStar's catalogue covers the whole sky and does not expire."""
    assert run("--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["profile"], facts["stars"], facts["valid_to"]) == ("cubestar", 411, None)


def test_a_tle_defines_the_orbit(tmp_path, capsys):
    """A TLE with a first day and a number of days."""
    path = tmp_path / "iss.tle"
    path.write_text(TLE)
    assert run("--tle", str(path), "--from", "2019-12-10", "--days", "3", "--mag-limit", "4", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["valid_to"] == "2019-12-13T00:00:00+00:00"
    assert 50 < facts["stars"] < 519
    assert facts["epoch_jyear"] == pytest.approx(2019.943, abs=0.002)


def test_readable_output_names_every_number(capsys):
    """Without --json: one line per fact."""
    assert run(*SUNSAT) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split() == ["stars", "144"] for line in lines)
    assert any(line.startswith("inside the envelope") for line in lines)


def test_camera_held_still(capsys):
    """Inertial pointing needs no orbit; a negative declination is a number, not an option."""
    still = "--pointing inertial --ra-deg 83.8 --dec-deg -5.4 --roll-deg 0 --pitch-deg 0 --yaw-deg -180:180"
    assert run(*still.split(), "--mag-limit", "5", "--json") == 0
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
        ("--out /no/such/folder/file", BadInput, "cannot be written"),
    ],
)
def test_bad_input_has_a_clear_message(arguments, error, words):
    """Each mistake raises the error that ends in exit code 2 and one sentence."""
    with pytest.raises(error, match=words):
        run(*arguments.split())


@pytest.mark.parametrize("text", ["ten", "1:2:3", ":", "5:"])
def test_an_invalid_range_is_rejected(text, capsys):
    """A range is MIN:MAX or a number; anything else ends with exit code 2 and says so."""
    with pytest.raises(SystemExit, match="2"):
        parse("--roll-deg", text)
    assert "expected MIN:MAX or one number in degrees" in capsys.readouterr().err


@pytest.fixture
def two_weeks(tmp_path, capsys):
    """Two catalogues: from Ω 133° and, two weeks later, from Ω 149°."""
    paths = [tmp_path / "a.bin", tmp_path / "b.bin"]
    for path, raan in zip(paths, ("133:149", "149:165"), strict=True):
        arguments = [raan if a == "133:149" else a for a in SUNSAT]
        assert run(*arguments, "--epoch", "2026.95", "--out", str(path)) == 0
    capsys.readouterr()
    return paths


def test_show_checks_and_says_what_is_inside(two_weeks, capsys):
    """``show`` reads image and manifest, and rejects one changed byte."""
    assert do("show", str(two_weeks[0]), "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["stars"], facts["profile"], facts["frame"]) == (144, "sunsat", "ICRS")
    assert facts["bytes"] == two_weeks[0].stat().st_size
    image = bytearray(two_weeks[0].read_bytes())
    image[500] ^= 1
    two_weeks[0].write_bytes(image)
    with pytest.raises(CorruptData, match="does not belong to the manifest"):
        do("show", str(two_weeks[0]))


def test_diff_lists_added_and_removed_stars(two_weeks, capsys):
    """After two weeks some stars are added and some removed; the others have not moved."""
    assert do("diff", *map(str, two_weeks), "--json") == 0
    d = json.loads(capsys.readouterr().out)
    assert len(d["dropped"]) + d["same"] == 144
    assert d["added"]
    assert d["dropped"]
    assert (d["moved"], d["magnitude_changed"]) == ([], [])


@pytest.mark.parametrize("kind", ["csv", "ecsv", "fits"])
def test_exports_hold_the_stars(two_weeks, kind, tmp_path):
    """Each kind reads back with astropy to the image's stars."""
    out = tmp_path / f"stars.{kind}"
    assert do("export", str(two_weeks[0]), "--kind", kind, "--out", str(out)) == 0
    formats = {"csv": {"format": "ascii.csv"}, "ecsv": {"format": "ascii.ecsv"}, "fits": {"format": "fits", "hdu": 1}}
    table = Table.read(out, **formats[kind])
    manifest = read_manifest((two_weeks[0].parent / "a.bin.json").read_text("utf-8"))
    catalogue = decode(two_weeks[0].read_bytes(), np.array(manifest.hip))
    assert table["hip"].tolist() == list(manifest.hip)
    ra, dec = (np.radians(np.asarray(table[c])) for c in (table.colnames[2], table.colnames[3]))
    assert separation_rad(unit_from_ra_dec(ra, dec), catalogue.icrs).max() < 3e-9


def test_missing_files_and_unknown_kinds_are_named(two_weeks, tmp_path):
    """No file, and no such kind of export, are bad input."""
    with pytest.raises(BadInput, match="cannot be read"):
        do("show", str(tmp_path / "none.bin"))
    with pytest.raises(BadInput, match=r"csv \| ecsv \| fits"):
        do("export", str(two_weeks[0]), "--kind", "papyrus", "--out", str(tmp_path / "x"))
