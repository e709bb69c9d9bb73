"""Builds from the request to the verified image: funnel, quality, manifest, cancellation and invalid requests."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from gss.catalogue_tools.build import build, estimate_pairs, preview
from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.manifest import check_image, read_manifest
from gss.catalogue_tools.onboard import decode
from gss.catalogue_tools.request import BuildRequest, ElementsOrbit, TleOrbit
from gss.catalogue_tools.selection.quality import stars_per_field
from gss.catalogue_tools.selection.selection import Fate, SelectionRules
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput, CorruptData, GssError
from gss.domain.stars import FLAG_VARIABLE
from gss.instruments.registry import shipped_camera
from gss.skytables.pairs import distance_table

START = datetime(2026, 12, 1, tzinfo=UTC)


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


SUNSAT = BuildRequest(
    shipped_camera("sunsat"),
    "sunsat",
    SelectionRules(6.0, 2.5, *deg(0.25), brightest_per_field=0, drop_variables=True),
    name="two weeks",
    author="a catalogue manager",
    orbit=ElementsOrbit(deg(97, 97), deg(133, 149)),
    attitude=AttitudeLimits("sunsat", deg(-10, 10), deg(-5, 5), deg(130, 140)),
    start=START,
    pointings=2000,
)
WHOLE_SKY = BuildRequest(
    shipped_camera("cubestar"), "cubestar", SelectionRules(3.8), pair_max_rad=float(np.radians(43)), pointings=2000
)


@pytest.fixture(scope="module")
def stars():
    return load_stars()


@pytest.fixture(scope="module")
def sunsat(stars):
    return build(SUNSAT, stars)


def test_the_image_contains_the_kept_stars_at_mid_validity(sunsat):
    """The image decodes to the kept stars, with positions for the middle of the validity."""
    onboard = decode(sunsat.image, np.array(sunsat.manifest.hip))
    assert np.array_equal(onboard.hip, sunsat.selection.kept.hip)
    assert separation_rad(onboard.icrs, sunsat.stars.icrs).max() < 1e-6
    assert len(onboard.distances) == len(sunsat.distances)
    assert sunsat.stars.epoch_jyear == pytest.approx(2026.935, abs=0.002)


def test_funnel_adds_up(sunsat):
    """Input minus removed stars equals the kept stars, all of which satisfy the rules."""
    remaining, dropped = 0, 0
    for step in sunsat.selection.funnel[2:-1]:
        remaining, dropped = (remaining, dropped + step.stars) if step.dropped else (step.stars, dropped)
    assert remaining - dropped == sunsat.selection.funnel[-1].stars == len(sunsat.stars)
    assert sunsat.stars.v_mag.min() >= 2.5
    assert sunsat.stars.v_mag.max() <= 6.0
    assert not np.any(sunsat.stars.flags & FLAG_VARIABLE)
    assert sunsat.plan.envelope.contains(sunsat.stars.icrs).all()
    assert sunsat.selection.count(Fate.DOUBLE) > 0


def test_close_doubles_are_removed_unless_the_neighbour_is_faint(sunsat, stars):
    """Every neighbour of a kept star within the separation is at least 2.5 mag fainter."""
    others = sunsat.selection.candidates
    distance = separation_rad(sunsat.stars.icrs[:, None], others.icrs[None])
    close = (distance < np.radians(0.25)) & (sunsat.stars.hip[:, None] != others.hip[None])
    fainter = others.v_mag[None] - sunsat.stars.v_mag[:, None]
    assert np.all(fainter[close] >= 2.5)


def test_thinning_keeps_the_brightest_of_every_field(stars):
    """With 6 stars per field, 20 % to 80 % of the stars remain, including the brightest 20. Fields that had at least 6
    stars keep at least 3.
    """
    request = replace(WHOLE_SKY, rules=SelectionRules(4.5, brightest_per_field=6), pair_max_rad=None)
    thinned, full = (
        preview(request, stars).selection,
        preview(replace(request, rules=SelectionRules(4.5)), stars).selection,
    )
    assert 0.2 * len(full.kept) < len(thinned.kept) < 0.8 * len(full.kept)
    assert np.isin(full.kept.hip[:20], thinned.kept.hip).all()
    shape = FieldShape(shipped_camera("cubestar").camera)
    attitudes = preview(request, stars).plan.envelope.attitudes(np.random.default_rng(3), 1000)
    before = stars_per_field(full.kept.icrs, attitudes, shape)
    after = stars_per_field(thinned.kept.icrs, attitudes, shape)
    assert after[before >= 6].min() >= 3
    assert after.mean() < 0.7 * before.mean()


def test_counts_per_field_agree_with_projection(stars):
    """The fast count equals projecting every star onto the detector."""
    camera = shipped_camera("sunsat").camera
    bright = load_stars(6.0)
    attitudes = preview(SUNSAT, stars).plan.envelope.attitudes(np.random.default_rng(9), 40)
    counts = stars_per_field(bright.icrs, attitudes, FieldShape(camera))
    for attitude, count in zip(attitudes, counts, strict=True):
        cam = bright.icrs @ attitude.T
        in_front = cam[cam[:, 2] > np.cos(np.radians(9))]
        assert count == camera.contains(camera.project(in_front)).sum()


def test_jacobs_statistics_of_the_whole_sky(stars):
    """About 0.5 % of random fields have fewer than three stars of V ≤ 6, and less than 0.03 % are empty (Jacobs 1995
    Table 5-1: 0.56 % and 0.0021 %).
    """
    request = BuildRequest(
        shipped_camera("sunsat"), "sunsat", SelectionRules(6.0), bank_bytes=4_000_000, pointings=20_000
    )
    quality = build(request, stars).quality
    assert quality.p_fewer_than(3) == pytest.approx(0.0050, abs=0.0015)
    assert quality.p_fewer_than(1) < 3e-4
    assert 35 <= len(quality.histogram) - 1 <= 60


def test_quality_report_is_consistent(sunsat):
    """The histogram counts every pointing, and no field has fewer stars than the reported worst one."""
    quality = sunsat.quality
    assert quality.histogram.sum() == quality.pointings == 2000
    assert quality.histogram[: quality.worst_stars].sum() == 0 < quality.histogram[quality.worst_stars]
    assert quality.p_fewer_than(3) == pytest.approx(quality.histogram[:3].sum() / 2000)
    assert quality.candidates_per_query >= 1


def test_preview_agrees_with_the_build(stars, sunsat):
    """The preview has the same stars, map and size as the build."""
    previewed = preview(SUNSAT, stars)
    assert np.array_equal(previewed.selection.kept.hip, sunsat.stars.hip)
    assert previewed.pairs == len(sunsat.distances)
    assert previewed.bytes == len(sunsat.image)
    assert np.array_equal(previewed.map.fraction, sunsat.map.fraction)


def test_pair_estimate_is_close_for_many_stars():
    """For many stars the number of pairs is estimated within 4 %, for 300 stars it is exact."""
    stars = load_stars(6.0)
    low, high = np.radians(0.25), np.radians(13.9)
    assert estimate_pairs(stars.icrs, low, high) == pytest.approx(len(distance_table(stars, low, high)), rel=0.04)
    assert estimate_pairs(stars.icrs[:300], 0.0, np.pi) == 300 * 299 // 2


def test_same_request_gives_the_same_bytes(stars, sunsat):
    """Building twice gives the same image and the same manifest."""
    second = build(SUNSAT, stars)
    assert second.image == sunsat.image
    assert second.manifest.as_json() == sunsat.manifest.as_json()


def test_the_manifest_identifies_the_image(sunsat):
    """A restored manifest is equal, names the star of each row, and matches only this image."""
    text = sunsat.manifest.as_json()
    restored = read_manifest(text)
    assert restored.as_json() == text
    check_image(restored, sunsat.image)
    with pytest.raises(CorruptData, match="does not belong to the manifest"):
        check_image(restored, sunsat.image[:-1] + b"\0")
    content = json.loads(text)
    assert content["hip"] == sunsat.stars.hip.tolist()
    assert content["valid_from"] == "2026-12-01T00:00:00+00:00"
    assert content["valid_to"] == "2026-12-15T00:00:00+00:00"
    assert sum(content["bytes_by_part"].values()) == len(sunsat.image)
    assert content["quantisation"]["position_rad"] < 1e-6


def test_a_changed_manifest_is_rejected(sunsat):
    """An edited manifest and a file of another kind are rejected."""
    with pytest.raises(CorruptData, match="changed after it was written"):
        read_manifest(sunsat.manifest.as_json().replace("two weeks", "ten weeks"))
    with pytest.raises(CorruptData, match="not a catalogue manifest"):
        read_manifest("[]")


def test_whole_sky_does_not_expire(stars):
    """CubeStar's whole-sky catalogue has 411 stars, the table size of the document, and no end of validity."""
    built = build(replace(WHOLE_SKY, start=START), stars)
    assert len(built.stars) == 411
    assert len(built.distances) == pytest.approx(11_486 * (411 / 405) ** 2, rel=0.06)
    assert (built.manifest.valid_from, built.manifest.valid_to) == ("2026-12-01T00:00:00+00:00", "")


def test_progress_increases_and_the_build_can_be_cancelled(stars):
    """Progress increases from 0 to 1, and an exception from the callback ends the build."""
    shares = []
    build(replace(SUNSAT, pointings=100), stars, lambda stage, share: shares.append((share, stage)))
    assert shares == sorted(shares)
    assert (shares[0][0], shares[-1][0]) == (0.0, 1.0)

    class Cancelled(Exception):
        pass

    def cancel(stage, share):
        if stage == "distances":
            raise Cancelled

    with pytest.raises(Cancelled):
        build(SUNSAT, stars, cancel)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_name": "papyrus"}, "unknown on-board format"),
        ({"orbit": None}, "follows the orbit"),
        ({"attitude": None}, "pointing law with attitude limits"),
        ({"orbit": TleOrbit("x"), "start": None}, "a TLE needs dates"),
        ({"orbit": TleOrbit("x")}, "not a two-line element set"),
        ({"attitude": AttitudeLimits("anti_sun"), "start": None}, "needs dates"),
        ({"days": float("nan")}, "validity is out of range"),
        ({"start": datetime(2026, 12, 1)}, "no time zone"),
        ({"margin_rad": -0.1}, "margin is out of range"),
        ({"epoch_jyear": 1950.0}, "epoch of the positions is far"),
        ({"epoch_jyear": float("nan")}, "epoch of the positions is far"),
        ({"epoch_jyear": 1000.0, "start": None}, "is out of range"),
        ({"pair_min_rad": 0.3}, "shortest distance is not below the longest"),
        ({"bank_bytes": 10_000}, "too large for the bank"),
        ({"bank_bytes": 23_000}, "too large for the bank"),
        ({"pointings": 0}, "number of pointings"),
        ({"rules": SelectionRules(9.0)}, "does not reach this magnitude limit"),
    ],
)
def test_each_invalid_request_is_rejected_with_a_message(stars, change, message):
    """Each invalid request is rejected with the expected message, and nothing is built."""
    with pytest.raises(GssError, match=message):
        build(replace(SUNSAT, **{"rules": SelectionRules(6.0), **change}), stars)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((6.0, 6.5), "not brighter than the faint limit"),
        ((float("nan"),), "not a number"),
        ((6.0, 2.0, -0.1), "cannot be negative"),
    ],
)
def test_invalid_magnitude_limits_are_rejected(arguments, message):
    """Magnitude limits that are out of order or not numbers are rejected."""
    with pytest.raises(BadInput, match=message):
        SelectionRules(*arguments)


def test_limits_that_leave_no_star_are_rejected(stars):
    """A limit without stars, an envelope without stars and too few remaining stars are rejected with different
    messages.
    """
    with pytest.raises(BadInput, match="leaves no stars"):
        build(replace(SUNSAT, rules=SelectionRules(-1.9)), stars)
    empty_field = AttitudeLimits("inertial", ra_rad=1.0, dec_rad=-1.0)
    sirius = AttitudeLimits("inertial", ra_rad=1.7678, dec_rad=-0.2917)
    with pytest.raises(BadInput, match="no star lies in the envelope"):
        build(replace(SUNSAT, orbit=None, attitude=empty_field, rules=SelectionRules(0.0)), stars)
    with pytest.raises(BadInput, match="too few stars are left"):
        build(replace(SUNSAT, orbit=None, attitude=sirius, rules=SelectionRules(0.0)), stars)


def test_invalid_star_tables_are_rejected(stars):
    """NaN directions and duplicate numbers are detected before the build starts."""
    some_stars = stars.take(np.arange(200))
    icrs = some_stars.icrs.copy()
    icrs[7, 1] = np.nan
    with pytest.raises(BadInput, match="not numbers"):
        build(replace(WHOLE_SKY, rules=SelectionRules(3.0)), replace(some_stars, icrs=icrs))
    with pytest.raises(BadInput, match="twice"):
        build(replace(WHOLE_SKY, rules=SelectionRules(3.0)), some_stars.take(np.r_[0:50, 10]))
