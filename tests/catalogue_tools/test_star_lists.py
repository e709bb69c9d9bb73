"""Star lists of users: recognised columns, questions to the user, and the reason for each rejected row."""

from __future__ import annotations

import gzip
import io
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK4, FK5, SkyCoord
from astropy.table import Table
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.catalogue_tools.corrections.correction_switches import Corrections
from gss.catalogue_tools.corrections.sky_source import corrected
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.sources.star_list_export import write_star_list
from gss.catalogue_tools.sources.star_list_mapping import KINDS, ListMapping, plain_unit
from gss.catalogue_tools.sources.star_lists import read_star_list
from gss.domain.angles import ARCSEC_RAD, ra_dec_from_unit, separation_rad, unit_from_ra_dec
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_NO_PROPER_MOTION, FLAG_VARIABLE, StarTable

MAS_RAD = ARCSEC_RAD / 1000
MAPPING = ListMapping(epoch_jyear=2000.0, frame="icrs")
NANOARCSEC_RAD = 1e-6 * MAS_RAD
SMALL_FILES = {kind: write_star_list(load_stars(1.0), kind) for kind in KINDS}


def _csv(*rows: str, head: str = "hip,ra,dec,v") -> bytes:
    """Return a CSV file with this header and rows."""
    return "\n".join([head, *rows, ""]).encode()


def _assert_equal(actual: StarTable, expected: StarTable, names: bool = True) -> None:
    """Check that two tables are equal; positions and motions within a nanoarcsecond."""
    for name in ("hip", "v_mag", "b_v", "flags"):
        assert np.array_equal(getattr(actual, name), getattr(expected, name), equal_nan=name == "b_v"), name
    assert separation_rad(actual.icrs, expected.icrs).max() < NANOARCSEC_RAD
    assert np.abs(actual.proper_motion_rad_yr - expected.proper_motion_rad_yr).max() < NANOARCSEC_RAD
    assert np.abs(actual.parallax_rad - expected.parallax_rad).max() < NANOARCSEC_RAD
    assert actual.epoch_jyear == expected.epoch_jyear
    if names:
        assert {
            number: actual.names[number] for number in actual.hip.tolist() if number in actual.names
        } == expected.names


@pytest.mark.parametrize("kind", KINDS)
def test_an_exported_list_is_read_back(kind: str) -> None:
    """Every file format restores the table: all columns, epoch, flags and names (in FITS as ASCII)."""
    stars = load_stars(4.5)
    result = read_star_list(write_star_list(stars, kind), kind)
    _assert_equal(stars, result.stars, names=kind != "fits")
    assert (result.dropped_count, result.frame, result.epoch_jyear) == (0, "icrs", 1991.25)
    if kind == "fits":
        assert result.stars.names[30867] == "bet Mon"


@settings(max_examples=25, deadline=None)
@given(
    ra=st.lists(st.floats(0, 359.999999), min_size=2, max_size=12),
    seed=st.integers(0, 1000),
    kind=st.sampled_from(("csv", "fits")),
    epoch=st.floats(1900, 2100),
)
def test_any_table_is_restored_after_export(ra: list[float], seed: int, kind: str, epoch: float) -> None:
    """Positions including the poles, negative parallaxes and unknown colours are restored within a nanoarcsecond."""
    rng = np.random.default_rng(seed)
    n = len(ra)
    dec = rng.choice([-90.0, 90.0, 0.0, 89.9999999, *rng.uniform(-90, 90, 5)], n)
    unit = unit_from_ra_dec(np.radians(ra), np.radians(dec))
    motion = np.cross(unit, rng.normal(size=(n, 3))) * 1e-7
    stars = StarTable(
        rng.choice(np.arange(1, 10_000), n, replace=False).astype(np.int32),
        unit,
        rng.uniform(-1, 12, n).round(3),
        np.where(rng.random(n) < 0.3, np.nan, rng.uniform(-0.3, 2, n)),
        motion,
        rng.normal(size=n) * 1e-7,
        rng.integers(0, 16, n).astype(np.uint16),
        epoch,
    )
    result = read_star_list(write_star_list(stars, kind), kind)
    _assert_equal(replace(stars, names={}), result.stars)


def test_columns_and_units_of_public_catalogues_are_recognised() -> None:
    """Column names of public catalogues, units in names and any order are accepted; other columns are ignored."""
    data = b"Vmag;comment;DE_ICRS;RA_ICRS;pmDE;pmRA;Plx;HIP;B-V\n3.76;x;-7.033;97.204;-4.66;-7.02;4.78;30867;-0.1\n"
    result = read_star_list(data, "csv", ListMapping(epoch_jyear=1991.25))
    assert result.frame == "icrs"
    assert result.columns == {
        "id": "HIP", "ra": "RA_ICRS", "dec": "DE_ICRS", "v": "Vmag", "b_v": "B-V",
        "pm_ra": "pmRA", "pm_dec": "pmDE", "parallax": "Plx",
    }  # fmt: skip
    ra, dec = ra_dec_from_unit(result.stars.icrs)
    assert np.degrees([ra[0], dec[0]]) == pytest.approx([97.204, -7.033])
    assert np.linalg.norm(result.stars.proper_motion_rad_yr) == pytest.approx(np.hypot(4.66, 7.02) * MAS_RAD)


@pytest.mark.parametrize(
    ("ra", "dec", "units"),
    [
        ("6.4802889", "-7.0330", {"ra": "hourangle"}),
        ("1.69653566", "-0.12274901", {"ra": "rad", "dec": "radians"}),
        ("06:28:49.04", "-07:01:58.8", {}),
        ("06 28 49.04", "-07 01 58.8", {}),
        ("6h28m49.04s", "-7d01m58.8s", {}),
        ("97.2043333", "-421.98", {"dec": "arcmin"}),
    ],
)
def test_positions_in_any_unit_are_read(ra: str, dec: str, units: dict[str, str]) -> None:
    """Degrees, hours, radians, arcminutes and sexagesimal text give the same position."""
    result = read_star_list(_csv(f"1,{ra},{dec},3.76"), "csv", replace(MAPPING, units=units))
    expected = unit_from_ra_dec(np.radians(97.2043333), np.radians(-7.0330))
    assert separation_rad(result.stars.icrs[0], expected) < 0.05 * ARCSEC_RAD


def test_small_negative_declinations_keep_their_sign() -> None:
    """A declination of −00:30 is read as negative."""
    result = read_star_list(_csv("1,00:00:01,-00:30:00,3"), "csv", MAPPING)
    assert np.degrees(ra_dec_from_unit(result.stars.icrs)[1][0]) == pytest.approx(-0.5)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("mas/yr", "mas/yr"),
        ("mas / yr", "mas/yr"),
        ("mas.yr-1", "mas/yr"),
        ("mas yr-1", "mas/yr"),
        ("arcsec/a", "arcsec/yr"),
        ("deg/year", "deg/yr"),
        ("arcsec/cy", "arcsec/century"),
    ],
)
def test_spellings_of_motion_units_are_recognised(text: str, unit: str) -> None:
    """Spellings of CDS, astropy and common usage are accepted."""
    assert plain_unit("pm_ra", text) == unit


def test_motion_in_right_ascension_with_or_without_cos_dec() -> None:
    """A motion in right ascension without the factor cos δ is multiplied by it."""
    head, row = "hip,ra,dec,v,pm_ra,pm_dec", "1,10,60,3,100,0"
    with_factor = read_star_list(_csv(row, head=head), "csv", MAPPING).stars
    without_factor = read_star_list(_csv(row, head=head), "csv", replace(MAPPING, pm_ra_has_cos_dec=False)).stars
    assert np.linalg.norm(without_factor.proper_motion_rad_yr) == pytest.approx(
        np.linalg.norm(with_factor.proper_motion_rad_yr) / 2
    )


@pytest.mark.parametrize(("frame", "tolerance_mas"), [("fk5", 0.001), ("b1950", 0.001)])
def test_other_frames_are_converted_as_in_astropy(frame: str, tolerance_mas: float) -> None:
    """Positions in FK5 and in FK4 (B1950) are converted to ICRS as by astropy."""
    rng = np.random.default_rng(2)
    ra, dec = rng.uniform(0, 360, 40), rng.uniform(-90, 90, 40)
    rows = [f"{i + 1},{a!r},{d!r},3" for i, (a, d) in enumerate(zip(ra.tolist(), dec.tolist(), strict=True))]
    result = read_star_list(_csv(*rows), "csv", ListMapping(epoch_jyear=1975.0, frame=frame))
    epoch = Time(1975.0, format="jyear", scale="tt")
    astropy_frame = FK5(equinox="J2000") if frame == "fk5" else FK4(equinox="B1950", obstime=epoch)
    expected = SkyCoord(ra * u.deg, dec * u.deg, frame=astropy_frame).icrs.cartesian.xyz.value.T
    assert separation_rad(result.stars.icrs, expected).max() < tolerance_mas * MAS_RAD


def test_epoch_and_frame_are_read_from_the_file() -> None:
    """Epoch and frame are read from comments of a CSV, the metadata of an ECSV, the header of a FITS file or a
    VOTable's COOSYS.
    """
    csv = b"# epoch = J2016.0\n# frame: ICRS\n" + _csv("1,10,20,3")
    assert read_star_list(csv, "csv").epoch_jyear == 2016.0
    table = Table({"id": [7, 8], "ra": [10.0, 11] * u.deg, "dec": [0.3, 0.4] * u.rad, "mag": [3.0, 4.0]})
    table.meta = {"EPOCH": 1980.5, "RADESYS": "FK5"}
    for kind, writer in (("fits", "fits"), ("ecsv", "ascii.ecsv")):
        file = io.BytesIO() if kind == "fits" else io.StringIO()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table.write(file, format=writer)
        data = file.getvalue()
        result = read_star_list(data if isinstance(data, bytes) else data.encode(), kind)
        assert (result.epoch_jyear, result.frame, result.stars.hip.tolist()) == (1980.5, "fk5", [7, 8])
        assert result.units["dec"] == "rad"
    votable = write_star_list(load_stars(2.0), "votable").replace(b"J1991.25", b"B1950.0 ")
    besselian = read_star_list(votable, "votable")
    assert besselian.epoch_jyear == pytest.approx(Time("B1950").jyear, abs=1e-6)


def test_masked_values_are_not_read_as_zero() -> None:
    """Masked cells of integer and float columns in a VOTable are unknown, not 0."""
    table = Table(
        {"hip": [1, 2, 3], "ra": [1.0, 2, 3], "dec": [1.0, 2, 3], "v": [3, 4, 5], "plx": [1.0, 2, 3]}, masked=True
    )
    table["v"].mask = [False, True, False]
    table["plx"].mask = [True, False, False]
    file = io.BytesIO()
    table.write(file, format="votable")
    result = read_star_list(file.getvalue(), "votable", MAPPING)
    assert result.stars.hip.tolist() == [1, 3]
    assert result.stars.parallax_rad[0] == 0
    (dropped,) = result.dropped
    assert (dropped.row, dropped.column, dropped.reason) == (2, "v", "empty")


@pytest.mark.parametrize(
    ("row", "column", "reason"),
    [
        ("2,nan,20,3", "ra", "empty"),
        ("2,,20,3", "ra", "empty"),
        ("2,10,inf,3", "dec", "empty"),
        ("2,10,20,", "v", "empty"),
        ("2,ten,20,3", "ra", "not a number"),
        ("2,361,20,3", "ra", "right ascension out of range"),
        ("2,-181,20,3", "ra", "right ascension out of range"),
        ("2,10,-90.1,3", "dec", "declination beyond a pole"),
        ("2,10,20,99.99", "v", "no star has this magnitude"),
        ("2,10,20,-9", "v", "no star has this magnitude"),
        ("1,10,20,3", "hip", "numbered twice"),
        ("x,10,20,3", "hip", "not a star number"),
        ("0,10,20,3", "hip", "not a star number"),
        ("2.5,10,20,3", "hip", "not a star number"),
        ("2,10,20", "", "3 values, the header names 4"),
        ("2,10,20,3,4", "", "5 values, the header names 4"),
    ],
)
def test_an_invalid_row_is_dropped_with_its_reason(row: str, column: str, reason: str) -> None:
    """An invalid row is reported with its number, column and reason, and the other rows are used. On request, the whole
    list is rejected.
    """
    data = _csv("1,5,6,7", row, "3,8,9,2")
    result = read_star_list(data, "csv", MAPPING)
    assert result.stars.hip.tolist() == [1, 3]
    assert result.dropped_count == 1
    assert (result.dropped[0].row, result.dropped[0].column, result.dropped[0].reason) == (2, column, reason)
    with pytest.raises(BadInput, match=r"row 2, column"):
        read_star_list(data, "csv", replace(MAPPING, bad_rows="refuse"))


def test_too_fast_and_too_near_stars_are_dropped() -> None:
    """Stars with implausible proper motions or parallaxes, which indicate a wrong unit, are dropped."""
    head = "hip,ra,dec,v,pm_ra,pm_dec,plx"
    result = read_star_list(_csv("1,1,1,3,30000,0,1", "2,1,2,3,0,0,5000", "3,1,3,3,,,", head=head), "csv", MAPPING)
    assert [d.reason for d in result.dropped] == ["no star moves so fast", "no star is so near"]
    assert result.stars.flags[0] & FLAG_NO_PROPER_MOTION


def test_row_numbers_count_invalid_and_empty_rows() -> None:
    """After an invalid row and an empty line, the reported row numbers are those that a user counts."""
    result = read_star_list(_csv("1,1,1,3", "2,2", "", "3,3,95,3", "4,4,4,3"), "csv", MAPPING)
    assert [(d.row, d.column) for d in result.dropped] == [(2, ""), (3, "dec")]


@pytest.mark.parametrize(
    ("data", "kind", "mapping", "message"),
    [
        (b"", "csv", MAPPING, "empty"),
        (b"  \n", "csv", MAPPING, "empty"),
        (_csv(), "csv", MAPPING, "empty"),
        (_csv("1,1,91,3"), "csv", MAPPING, "no row of the star list can be used"),
        (_csv("1,1,1,3"), "csv", ListMapping(frame="icrs"), "does not state its epoch"),
        (_csv("1,1,1,3"), "csv", ListMapping(epoch_jyear=2000.0), "does not state its frame"),
        (_csv("1,1,1,3"), "csv", ListMapping(epoch_jyear=1066.0, frame="icrs"), "epoch is out of range"),
        (_csv("1,1,1,3"), "csv", ListMapping(epoch_jyear=float("nan"), frame="icrs"), "epoch is out of range"),
        (b"# epoch = 1991.25\n" + _csv("1,1,1,3"), "csv", MAPPING, "has another epoch"),
        (b"# epoch = now\n" + _csv("1,1,1,3"), "csv", ListMapping(frame="icrs"), "not a year"),
        (b"# frame = fk4\n" + _csv("1,1,1,3"), "csv", MAPPING, "in another frame"),
        (b"# frame = galactic\n" + _csv("1,1,1,3"), "csv", ListMapping(epoch_jyear=2000.0), "frame is unknown"),
        (_csv("1,1,1,3", head="hip,lon,lat,v"), "csv", MAPPING, "no column for ra, dec"),
        (_csv("1,1,1,3", head="hip,ra,ra,v"), "csv", MAPPING, "two columns of the star list have the same name"),
        (_csv("1,1,1,3", head="ra,RA,dec,v"), "csv", MAPPING, "two columns could be ra"),
        (_csv("1,1,1,3"), "csv", replace(MAPPING, columns={"ra": "alpha"}), "no column 'alpha'"),
        (_csv("1,1,1,3"), "xlsx", MAPPING, "unknown kind"),
        (_csv("1,1,1,3"), "fits", MAPPING, "not a fits table"),
        (_csv("1,1,1,3"), "votable", MAPPING, "not a votable table"),
        (_csv("1,1,1,3"), "ecsv", MAPPING, "not an ecsv table"),
        (b"\xff\xfe\x00", "csv", MAPPING, "not text"),
    ],
)
def test_an_unreadable_list_is_rejected(data: bytes, kind: str, mapping: ListMapping, message: str) -> None:
    """Problems that affect the whole list are reported before rows are checked."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(BadInput, match=message):
            read_star_list(data, kind, mapping)


@settings(max_examples=150, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    position=st.integers(0, 4000),
    replacement=st.binary(min_size=1, max_size=8),
    length=st.integers(0, 4000) | st.none(),
)
def test_damaged_files_raise_no_other_error(kind: str, position: int, replacement: bytes, length: int | None) -> None:
    """Corrupted and truncated files give stars or BadInput, and no other error."""
    content = bytearray(SMALL_FILES[kind])
    content[position % len(content) : position % len(content) + len(replacement)] = replacement
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = read_star_list(bytes(content[:length]), kind)
        except BadInput:
            return
    assert len(result.stars) + result.dropped_count >= 1
    assert np.isfinite(result.stars.icrs).all()


def test_compressed_files_are_rejected() -> None:
    """Compressed files are rejected, because a small one can expand to a huge one."""
    for kind in KINDS:
        with pytest.raises(BadInput, match="compressed"):
            read_star_list(gzip.compress(SMALL_FILES[kind]), kind)


@pytest.mark.parametrize(
    "text", ["hip,ra,dec,v\r\n1,10,20,3\r\n", "\ufeffhip;ra;dec;v\n1;10;20;3", "hip\tra\tdec\tv\n1\t10\t20\t3\n\n"]
)
def test_any_line_end_mark_and_separator_is_accepted(text: str) -> None:
    """Files with the line ends, byte-order marks and separators of any system are read."""
    assert read_star_list(text.encode(), "csv", MAPPING).stars.hip.tolist() == [1]


def test_ambiguous_units_raise_a_question() -> None:
    """If all right ascensions are below 24, or all values fit radians, the error requests the unit. With a stated unit
    the list is read.
    """
    stars = load_stars(3.0)
    ra, dec = ra_dec_from_unit(stars.icrs)
    hours = [f"{i},{a},{d},3" for i, (a, d) in enumerate(zip(np.degrees(ra) / 15, np.degrees(dec), strict=True), 1)]
    radians = [f"{i},{a},{d},3" for i, (a, d) in enumerate(zip(ra, dec, strict=True), 1)]
    with pytest.raises(BadInput, match="unit of column ra is not clear") as error:
        read_star_list(_csv(*hours), "csv", MAPPING)
    assert "hourangle" in error.value.hint
    with pytest.raises(BadInput, match="unit of column ra is not clear") as error:
        read_star_list(_csv(*radians), "csv", MAPPING)
    assert '"rad"' in error.value.hint
    result = read_star_list(_csv(*hours), "csv", replace(MAPPING, units={"ra": "hourangle"}))
    assert separation_rad(result.stars.icrs, stars.icrs).max() < NANOARCSEC_RAD
    assert len(read_star_list(_csv(*hours), "csv", replace(MAPPING, units={"ra": "deg"})).stars) == len(stars)


def test_designations_that_are_not_numbers_become_names() -> None:
    """If designations are text or numbers too long to store, rows are numbered and the designations become names.
    Duplicates are still detected.
    """
    long_numbers = read_star_list(_csv("4295806720,1,1,3", "34361129088,2,2,3", "4295806720,3,3,3"), "csv", MAPPING)
    assert long_numbers.stars.hip.tolist() == [1, 2]
    assert long_numbers.stars.name_of(1) == "4295806720"
    assert long_numbers.dropped[0].reason == "named twice"
    text_names = read_star_list(_csv("Foo 1,1,1,3", "Bar 2,2,2,3"), "csv", MAPPING)
    assert text_names.stars.name_of(2) == "Bar 2"
    assert any("numbered by row" in note for note in text_names.notes)


def test_numbers_of_other_lists_are_not_hipparcos_numbers() -> None:
    """A star of another catalogue is labelled with its number there, and a star without number with its row."""
    bright = read_star_list(_csv("7001,1,1,3", "2000001,2,2,3", head="HR,ra,dec,v"), "csv", MAPPING).stars
    assert [bright.name_of(n) for n in bright.hip] == ["HR 7001", "HR 2000001"]
    nameless = read_star_list(_csv("1,1,3", head="ra,dec,v"), "csv", MAPPING).stars
    assert nameless.name_of(1) == "row 1"
    assert read_star_list(_csv("7001,1,1,3"), "csv", MAPPING).stars.name_of(7001) == "HIP 7001"


@pytest.mark.parametrize("column", ["hip", "hd", "sao"])
def test_variable_stars_are_recognized_only_by_hipparcos_numbers(column: str) -> None:
    """The number of Mira in Hipparcos changes magnitude and flag only in a column of Hipparcos numbers, also after the list is
    exported and read again."""
    stars = read_star_list(_csv("10826,1,1,3", head=f"{column},ra,dec,v"), "csv", MAPPING).stars
    exported = read_star_list(write_star_list(stars, "csv"), "csv").stars
    for table in (stars, exported):
        switches = Corrections(proper_motion=False, flag_variables=True, variables_at_date=True)
        seen = corrected(table, switches, 2026.0).stars
        is_mira = column == "hip"
        assert (bool(seen.flags[0] & FLAG_VARIABLE), seen.v_mag[0] != 3.0) == (is_mira, is_mira)
    assert exported.name_of(10826) == stars.name_of(10826)


def test_a_list_without_motions_is_reported() -> None:
    """Positions without proper motions are unchanged and flagged, and the report states their epoch."""
    result = read_star_list(_csv("1,1,1,3"), "csv", MAPPING)
    assert result.notes == ("no proper motions: the positions of J2000 are used at every epoch",)
    assert np.all(result.stars.flags & FLAG_NO_PROPER_MOTION)


def test_only_the_first_hundred_bad_rows_are_listed() -> None:
    """All invalid rows are counted, and the first hundred are listed in the order of the file."""
    result = read_star_list(_csv("1,1,1,3", *(f"{i},1,99,3" for i in range(2, 400))), "csv", MAPPING)
    assert (result.dropped_count, len(result.dropped)) == (398, 100)
    assert [d.row for d in result.dropped] == list(range(2, 102))


def test_a_hundred_thousand_rows_are_read() -> None:
    """A long list is read completely, and each invalid row is reported."""
    n = 100_000
    rng = np.random.default_rng(0)
    ra, dec, v = rng.uniform(0, 360, n).round(6), rng.uniform(-90, 90, n).round(6), rng.uniform(0, 12, n).round(2)
    v[::1000] = 77
    rows = "\n".join(f"{i + 1},{a},{d},{m}" for i, (a, d, m) in enumerate(zip(ra, dec, v, strict=True)))
    result = read_star_list(("hip,ra,dec,v\n" + rows).encode(), "csv", MAPPING)
    assert (len(result.stars), result.dropped_count) == (n - 100, 100)


@pytest.mark.parametrize(
    "make",
    [
        lambda: ListMapping(columns={"rigth": "ra"}),
        lambda: ListMapping(units={"ra": "furlong"}),
        lambda: ListMapping(units={"name": "deg"}),
        lambda: ListMapping(frame="galactic"),
        lambda: ListMapping(bad_rows="ignore"),
        lambda: write_star_list(load_stars(2.0), "xlsx"),
        lambda: write_star_list(load_stars(2.0).take(np.arange(0)), "csv"),
    ],
)
def test_invalid_mappings_are_rejected(make) -> None:  # type: ignore[no-untyped-def]
    """Invalid mappings and exports are rejected."""
    with pytest.raises(BadInput):
        make()
