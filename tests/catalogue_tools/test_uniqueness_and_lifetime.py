"""Ambiguity of the sky, the field with the fewest stars, accidental matches, drift out of the envelope, and the blocks
of Jacobs.
"""

import itertools
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from gss.catalogue_tools.envelope.attitude import AttitudeLimits
from gss.catalogue_tools.envelope.blocks import RULES, BlockEnvelope, BlockSteps, stepped
from gss.catalogue_tools.envelope.envelope import BandEnvelope, PatchEnvelope, WholeSky
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.healpix import centres
from gss.catalogue_tools.envelope.lifetime import lifetime
from gss.catalogue_tools.envelope.orbits import from_elements
from gss.catalogue_tools.selection.ambiguity import ambiguity_map, wrong_matches
from gss.catalogue_tools.selection.poorest import search_poorest
from gss.catalogue_tools.selection.quality import assess, candidates_per_star, stars_per_field
from gss.catalogue_tools.selection.screening import companions, false_matches, screen
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera
from gss.pipeline.identify.geometric_voting import pairs_of, vote
from gss.skytables.pairs import distance_table


def deg(*values):
    return tuple(float(np.radians(v)) for v in values)


LIMITS = AttitudeLimits("sunsat", deg(-10, 10), deg(-5, 5), deg(130, 140))
SUNSAT, CUBESTAR = (FieldShape(shipped_camera(name).camera) for name in ("sunsat", "cubestar"))
VALID_TO = datetime(2026, 12, 15, tzinfo=UTC)


def sunsat(low, high):
    """Return Sunsat's envelope for a range of nodes."""
    return BandEnvelope(SUNSAT, LIMITS, from_elements(deg(97, 97), deg(low, high)))


def random_directions(count, seed=2):
    """Return random unit vectors."""
    unit = np.random.default_rng(seed).normal(size=(count, 3))
    return unit / np.linalg.norm(unit, axis=1, keepdims=True)


# Ambiguity


def test_wrong_triangles_agree_with_full_enumeration():
    """Among 40 stars, every other triangle with the same sides in any order, and every other pair, is counted once."""
    unit, tolerance, longest = random_directions(40), 0.05, 1.2
    separations = separation_rad(unit[:, None], unit[None])
    triangles_to_match = np.array(
        [
            t
            for t in itertools.combinations(range(40), 3)
            if max(separations[i, j] for i, j in itertools.combinations(t, 2)) < longest
        ]
    )[:60]
    pairs, triangles = wrong_matches(unit, triangles_to_match, tolerance, longest)
    pair_distances = [
        separations[i, j] for i, j in itertools.combinations(range(40), 2) if separations[i, j] <= longest + tolerance
    ]
    for trio, triangle_count, pair_count in zip(triangles_to_match, triangles, pairs, strict=True):
        a, b, c = trio
        sides = separations[a, b], separations[a, c], separations[b, c]
        similar = {
            tuple(sorted(t))
            for t in itertools.permutations(range(40), 3)
            if abs(separations[t[0], t[1]] - sides[0]) <= tolerance
            and abs(separations[t[0], t[2]] - sides[1]) <= tolerance
            and abs(separations[t[1], t[2]] - sides[2]) <= tolerance
        }
        assert triangle_count == len(similar - {tuple(trio)})
        assert pair_count == pytest.approx(
            np.mean([sum(abs(d - s) <= tolerance for d in pair_distances) for s in sides]) - 1
        )


@pytest.mark.parametrize(("tolerance", "times"), [(0.001, 5), (0.003, 2)])
def test_rivals_predict_where_the_voting_matcher_fails(tolerance, times):
    """If geometric voting matches noisy fields of a small catalogue, far more stars are misidentified in the third of
    the sky that the map rates most ambiguous than in the third that it rates most unique.
    """
    stars = load_stars(3.2).brighter_than(3.2)
    longest, radius = float(np.radians(43)), CUBESTAR.equal_circle_rad
    ambiguity = ambiguity_map(stars.icrs, WholeSky(CUBESTAR), radius, tolerance, longest, nside=8)
    table = distance_table(stars, 1e-4, longest)
    rng, rivals, wrong_shares = np.random.default_rng(4), [], []
    for pixel in np.flatnonzero(ambiguity.stars >= 3):
        rows = np.flatnonzero(separation_rad(stars.icrs, centres(8)[pixel]) <= radius)[:6]
        measured = stars.icrs[rows] + rng.normal(size=(len(rows), 3)) * tolerance / 4
        measured /= np.linalg.norm(measured, axis=1, keepdims=True)
        ballot = vote(pairs_of(measured), len(rows), table, len(stars), tolerance)
        rivals.append(ambiguity.rivals[pixel])
        wrong_shares.append(np.mean(ballot.row != rows))
    order, third = np.argsort(rivals, kind="stable"), len(rivals) // 3
    unique, ambiguous = np.array(wrong_shares)[order[:third]].mean(), np.array(wrong_shares)[order[-third:]].mean()
    assert ambiguous > times * unique
    assert np.corrcoef(np.argsort(np.argsort(rivals)), wrong_shares)[0, 1] > 0.4


def test_the_map_marks_its_envelope_and_empty_fields():
    """The map is NaN outside the envelope, infinite where fewer than three stars are visible, and finite elsewhere.

    Its worst position is inside.
    """
    stars = load_stars(4.5).brighter_than(4.5)
    envelope = sunsat(133, 149)
    ambiguity = ambiguity_map(stars.icrs, envelope, SUNSAT.equal_circle_rad, 3e-4, np.radians(14))
    inside = envelope.contains(centres(16))
    assert np.array_equal(ambiguity.stars >= 0, inside)
    assert np.isnan(ambiguity.wrong_triangles[~inside]).all()
    assert np.array_equal(np.isinf(ambiguity.wrong_triangles), inside & (ambiguity.stars < 3))
    ra, dec, worst_rivals = ambiguity.worst
    direction = np.array([[np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)]])
    assert separation_rad(direction, centres(16)[inside]).min() < 1e-6
    assert worst_rivals == np.max(ambiguity.rivals[inside])
    facts = ambiguity.facts()
    assert facts["share_without_triangle"] == pytest.approx(np.mean(ambiguity.stars[inside] < 3))
    assert facts["worst_rivals"] is None


def test_a_wider_tolerance_is_more_ambiguous():
    """Wrong pairs and triangles increase with the tolerance. With an empty catalogue the whole map is infinite."""
    stars = load_stars(3.8).brighter_than(3.8)
    sky = WholeSky(CUBESTAR)
    narrow, wide = (ambiguity_map(stars.icrs, sky, 0.3, t, 0.75, nside=4) for t in (5e-4, 5e-3))
    assert np.nanmean(wide.wrong_pairs) > 5 * np.nanmean(narrow.wrong_pairs)
    finite = np.isfinite(narrow.wrong_triangles)
    assert wide.wrong_triangles[finite].sum() > 10 * narrow.wrong_triangles[finite].sum()
    assert np.isinf(ambiguity_map(np.empty((0, 3)), sky, 0.3, 1e-3, 0.7, nside=2).wrong_triangles).all()
    with pytest.raises(BadInput, match="ambiguity needs"):
        ambiguity_map(stars.icrs, sky, 0.3, 0.0, 0.7)


# The poorest field


def test_search_finds_a_hole_that_random_fields_miss():
    """In a uniform sky with a hole smaller than the field, the search finds a field with fewer stars than the same
    number of random fields, within 2° of the centre of the hole.
    """
    unit = random_directions(30_000)
    unit = unit[separation_rad(unit, centres(8)[100]) > SUNSAT.half_diagonal_rad * 0.8]
    sky = WholeSky(SUNSAT)
    poorest = search_poorest(unit, sky, SUNSAT)
    random = stars_per_field(unit, sky.attitudes(np.random.default_rng(3), poorest.searched), SUNSAT)
    assert poorest.stars < random.min()
    assert stars_per_field(unit, poorest.cam_from_icrs[None], SUNSAT)[0] == poorest.stars
    assert separation_rad(poorest.cam_from_icrs[2], centres(8)[100]) < np.radians(2)


def test_quality_reports_the_poorest_field_and_its_position():
    """The worst field has no more stars than any of the pointings, and its boresight is inside the envelope."""
    stars = load_stars(5.0)
    envelope = sunsat(133, 149)
    quality = assess(stars.icrs, envelope, SUNSAT, 2000, np.random.default_rng(1))
    assert quality.worst_stars <= np.flatnonzero(quality.histogram)[0]
    assert quality.searched > 1000
    direction = np.array(
        [
            np.cos(quality.worst_dec_rad) * np.cos(quality.worst_ra_rad),
            np.cos(quality.worst_dec_rad) * np.sin(quality.worst_ra_rad),
            np.sin(quality.worst_dec_rad),
        ]
    )
    assert envelope.contains(direction[None])[0]


def test_candidates_per_star_agree_with_random_draws():
    """The formula for the number of distinct stars in random pairs agrees with random draws. Without a table the number
    is NaN.
    """
    rng = np.random.default_rng(5)
    drawn = [len(np.unique(np.concatenate([rng.choice(200, 2, replace=False) for _ in range(60)]))) for _ in range(300)]
    assert candidates_per_star(200, 10.0, 7.0) == pytest.approx(np.mean(drawn), rel=0.01)
    assert np.isnan(candidates_per_star(200, float("nan"), 7.0))


# False matches and screening


def test_false_match_probabilities_of_moniteq_are_reproduced():
    """Hipparcos to V 6.49 gives Moniteq's 0.17, 6.4e-5 and 1.1e-5 within 10 % (Moniteq 1983 §2.1)."""
    figures = false_matches(load_stars(6.49).v_mag)
    assert figures.second_probability == pytest.approx(0.17, rel=0.05)
    assert figures.third_probability == pytest.approx(6.4e-5, rel=0.1)
    assert figures.joint_probability == pytest.approx(1.1e-5, rel=0.1)


def test_chance_companions_agree_with_a_uniform_sky():
    """Uniformly distributed stars have, on average, the predicted number of companions in a ring. The counts equal
    brute force.
    """
    unit, mag = random_directions(4000), np.random.default_rng(7).uniform(3, 7, 4000)
    counted = companions(unit, mag, 0.3, 0.02, 6.0, 0.5)
    assert counted.mean() == pytest.approx(false_matches(mag, 6.0, 0.5, 0.02, 0.3).second, rel=0.03)
    separations = separation_rad(unit[11], unit)
    assert counted[11] == np.count_nonzero((np.abs(separations - 0.3) <= 0.02) & (np.abs(mag - 6) <= 0.5))


def test_screening_marks_doubles_variables_and_fast_stars():
    """61 Cygni is marked as fast, Mizar as double and Mira as variable. Vega is not marked except possibly as variable.
    With a separation of zero, no more stars are marked as double.
    """
    stars = load_stars(6.5)
    marks = screen(stars)
    row = stars.row_of_hip
    assert marks.fast[row[104214]]
    assert marks.double[row[65378]]
    assert marks.variable[row[10826]]
    assert not marks.marked[row[91262]] or marks.variable[row[91262]]
    assert marks.counts["any"] <= marks.counts["double"] + marks.counts["variable"] + marks.counts["fast"]
    assert np.count_nonzero(screen(stars, double_rad=0.0).double) <= np.count_nonzero(marks.double)


@pytest.mark.parametrize(
    "invalid", [{"tolerance_mag": 0.0}, {"tolerance_rad": -1.0}, {"arc_rad": 4.0}, {"area_sr": 0.0}]
)
def test_invalid_tolerances_are_rejected(invalid):
    """Invalid tolerances, arcs and areas are rejected."""
    with pytest.raises(BadInput, match="area is out of range"):
        false_matches(np.array([5.0]), **invalid)


# Lifetime


def test_lifetime_ends_when_the_share_reaches_the_threshold():
    """At the end of the lifetime, the catalogue covers exactly the threshold share of the visible sky. A higher
    threshold ends earlier, and twice the drift halves the lifetime.
    """
    envelope = sunsat(133, 149)
    life = lifetime(envelope, np.radians(1.0), VALID_TO, 0.9)
    assert 0 < life.days < 30
    assert life.until == VALID_TO + timedelta(days=life.days)
    moved = sunsat(149 + life.days, 149 + life.days)
    share = moved.time_fraction(centres(32))
    assert share[envelope.contains(centres(32))].sum() / share.sum() == pytest.approx(0.9, abs=0.01)
    assert lifetime(envelope, np.radians(1.0), None, 0.99).days < life.days
    assert lifetime(envelope, np.radians(2.0), None, 0.9).days == pytest.approx(life.days / 2, abs=0.05)
    assert life.share_curve[0] == pytest.approx(1.0, abs=0.01)


def test_a_westward_drift_has_a_longer_lifetime():
    """With drift in the opposite direction the lifetime is longer, because from the end of validity the node first
    crosses the whole band.
    """
    envelope = sunsat(133, 149)
    assert lifetime(envelope, np.radians(-1.0)).days > lifetime(envelope, np.radians(1.0)).days + 10


def test_the_lifetime_without_drift_is_infinite():
    """Without drift, with every node, for the whole sky or an inertially fixed camera, the lifetime is infinite and has
    no date.
    """
    fixed = PatchEnvelope(SUNSAT, AttitudeLimits("inertial", deg(-1, 1), deg(-1, 1)))
    for envelope, rate in ((WholeSky(SUNSAT), 0.1), (fixed, 0.1), (sunsat(0, 360), 0.02), (sunsat(133, 149), 0.0)):
        life = lifetime(envelope, rate, VALID_TO)
        assert np.isinf(life.days)
        assert life.until is None


def test_the_lifetime_of_an_anti_sun_camera_is_about_its_field_width():
    """The field of a camera that points away from the Sun moves by 1° per day and leaves the catalogue after 3 to 9
    days.
    """
    envelope = PatchEnvelope(SUNSAT, AttitudeLimits("anti_sun"), deg(70, 84))
    days = lifetime(envelope, 2 * np.pi / 365.25, threshold=0.5).days
    assert 3 < days < 9


@pytest.mark.parametrize(
    "invalid", [{"threshold": 0.0}, {"threshold": 1.5}, {"longest_days": 0.0}, {"rate_rad_day": float("nan")}]
)
def test_invalid_lifetime_parameters_are_rejected(invalid):
    """Invalid thresholds, durations and drifts are rejected."""
    with pytest.raises(BadInput):
        lifetime(sunsat(0, 1), **({"rate_rad_day": 0.01} | invalid))


# Jacobs' blocks


@pytest.mark.parametrize("rule", RULES)
def test_blocks_agree_with_stepping_every_field(rule):
    """Blocks marked by rotation with the node equal those of stepping every node and applying the rule to each field."""
    orbit = from_elements(deg(97, 97), deg(133, 134))
    steps = BlockSteps(*deg(20, 10, 20, 120, 1, 1))
    blocks = BlockEnvelope(SUNSAT, LIMITS, orbit, steps, rule)
    marked = np.zeros((180, 360), bool)
    for node in stepped(orbit.raan_rad, steps.raan_rad):
        for cam in np.concatenate(list(blocks._attitudes(float(node)))):
            marked |= _blocks_of(SUNSAT, cam, rule)
    assert marked.any()
    assert np.mean(marked != blocks.marked) < 2e-4


def _blocks_of(shape, cam, rule):
    offsets = {"centre": [0.5], "whole": [0, 1], "touched": np.linspace(0, 1, 5)}[rule]
    dec, ra = np.meshgrid(np.arange(180) - 90.0, np.arange(360.0), indexing="ij")
    middle = _unit(ra + 0.5, dec + 0.5)
    near = middle @ cam[2] > np.cos(shape.half_diagonal_rad + np.radians(1.5))
    states = [shape.inside(_unit(ra[near] + x, dec[near] + y) @ cam.T) for y, x in itertools.product(offsets, offsets)]
    blocks = np.zeros((180, 360), bool)
    blocks[near] = np.all(states, axis=0) if rule == "whole" else np.any(states, axis=0)
    return blocks


def _unit(ra_deg, dec_deg):
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def test_whole_blocks_reproduce_the_counts_of_jacobs():
    """Whole blocks give Jacobs' 113, 540 and 1300 stars within 10 %. Block centres give more, and the exact envelope
    gives the most.
    """
    stars = load_stars(6.0).icrs
    steps = BlockSteps(*deg(20, 10, 10, 30, 1, 4))
    for (low, high), paper in (((133, 149), 113), ((0, 120), 540), ((0, 360), 1300)):
        orbit = from_elements(deg(97, 97), deg(low, high))
        whole, centre = (
            BlockEnvelope(SUNSAT, LIMITS, orbit, steps, rule).contains(stars).sum() for rule in ("whole", "centre")
        )
        assert whole == pytest.approx(paper, rel=0.1)
        assert whole < centre < BandEnvelope(SUNSAT, LIMITS, orbit).contains(stars).sum()


def test_blocks_across_ra_0_and_the_pole_have_no_gap():
    """Bands across RA 0 and across the pole are marked without a gap."""
    across = BlockEnvelope(
        SUNSAT, LIMITS, from_elements(deg(97, 97), deg(260, 280)), BlockSteps(*deg(20, 10, 10, 30, 1, 1))
    )
    assert across.marked[97, 350:].all()
    assert across.marked[97, :10].all()
    polar = BlockEnvelope(SUNSAT, LIMITS, from_elements(deg(1, 1), deg(0, 359)), BlockSteps(*deg(10, 5, 5, 30, 1, 1)))
    assert polar.marked[0].all()


def test_steps_end_at_the_maximum_if_they_fit():
    """Steps begin at the minimum and end at the maximum only if they reach it exactly.

    A step of zero raises BadInput.
    """
    assert np.degrees(stepped(deg(-10, 10), deg(5)[0])) == pytest.approx([-10, -5, 0, 5, 10])
    assert np.degrees(stepped(deg(133, 149), deg(5)[0])) == pytest.approx([133, 138, 143, 148])
    with pytest.raises(BadInput, match="step of yaw"):
        BlockSteps(yaw_rad=0.0)
