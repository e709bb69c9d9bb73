"""FAR-MST's matchers one by one: the document's examples, brute force, and pairs of frames."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Attitude, Centroids
from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_angle_rad,
    rotation_from_vector,
)
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains.far_mst_parameters import default_parameters
from gss.pipeline.chains.far_mst_relative import Relative, chained, relative_attitude
from gss.pipeline.identify.baselines import BaselineCandidates, Baselines, baselines
from gss.pipeline.identify.frame_matching import candidate_star_matrix, pair_match, triangle_match
from gss.pipeline.identify.n_vertex import consistent_names, figures, match_figure
from gss.pipeline.identify.pair_directory_stars import brightest_per_field
from gss.pipeline.identify.triad_pyramid import pyramids
from gss.pipeline.render import stars_near, truth_of
from gss.pipeline.track.constant_rate import extrapolate
from gss.pipeline.track.rate_match import mutual_nearest, rate_match
from gss.skytables.cells import lattice
from gss.skytables.pairs import distance_table
from gss.skytables.sin2 import sin2_directory

PROFILE = shipped_camera("far_mst")
CAMERA = PROFILE.camera
PARAMETERS = default_parameters(PROFILE)


def _by_columns(s_matrix: dict[int, dict[int, list[int]]], vertices: int) -> Baselines:
    """Return baselines that answer from a given matrix S instead of a directory."""
    empty = sin2_directory(distance_table(load_stars(0.0), 0.0, 1e-6), 100)
    made = Baselines(empty, np.zeros((vertices, vertices), np.intp), np.zeros((vertices, vertices), np.intp))
    for number, (i, j) in enumerate(combinations(range(vertices), 2), start=1):
        keys = sorted({p * 100 + q for p, row in s_matrix.items() for q in row.get(number, [])})
        made._columns[(i, j)] = BaselineCandidates(np.array(keys, np.intp), 100)
    return made


def test_the_documents_matrix_gives_its_stars() -> None:
    """Matrix S of Table 5.4 (star C in columns 2, 4, 6) leads to A = 45, B = 46, C = 47, D = 48."""
    s_matrix = {
        45: {1: [46], 2: [47], 3: [48]},
        46: {1: [45], 4: [47], 5: [48]},
        47: {2: [45], 4: [46], 6: [48]},
        48: {3: [45], 5: [46], 6: [47]},
    }
    names = consistent_names((0, 1, 2, 3), _by_columns(s_matrix, 4))
    np.testing.assert_array_equal(names, [[45, 46, 47, 48]])


def test_the_documents_candidate_star_matrix_reduces() -> None:
    """Fig. 5.6 with the 9 that the text requires: star 1 is 3, star 2 is 5, star 3 is 9."""
    masks = [np.zeros((10, 10), bool) for _ in range(3)]
    for mask, (i, j) in zip(masks, ((3, 5), (9, 5), (3, 9)), strict=True):
        mask[i, j] = mask[j, i] = True
    masks[2][5, 4] = masks[2][4, 5] = True
    left = candidate_star_matrix(*masks)
    assert len(left) == 3
    assert sorted(map(tuple, left.tolist())) == [(-1, 5, 9), (3, -1, 9), (3, 5, -1)]


@pytest.mark.parametrize("vertices", [3, 4, 5])
def test_figures_are_complete_and_bright_ones_first(vertices: int) -> None:
    """Every figure of eight stars is generated once; at first a star is in at most three consecutive triads (§5.5.2)."""
    made = figures(8, vertices)
    assert sorted(made) == list(combinations(range(8), vertices))
    assert made[0] == tuple(range(vertices))
    if vertices == 3:
        runs = [sum(all(star in t for t in made[k : k + 4]) for star in range(8)) for k in range(len(made) // 2)]
        assert max(runs) == 0
    assert figures(2, 3) == ()


def test_consistent_matches_equal_brute_force() -> None:
    """For 30 random figures the sets of matches are those of comparing every angle."""
    rng = np.random.default_rng(3)
    stars = load_stars(2.0)
    directory = sin2_directory(distance_table(stars, 0.0, 0.9), len(stars))
    tolerance = 0.02
    found = 0
    for _ in range(30):
        centre = stars.icrs[rng.integers(len(stars))]
        near = np.flatnonzero(stars.icrs @ centre > np.cos(0.42))[:6]
        if len(near) < 3:
            continue
        unit = stars.icrs[near]
        table = baselines(unit, np.full((len(near), len(near)), tolerance), directory)
        expected: set[tuple[int, ...]] = set()
        angle = np.arccos(np.clip(stars.icrs @ stars.icrs.T, -1, 1))
        seen = np.arccos(np.clip(unit @ unit.T, -1, 1))
        apart = (angle > 1e-6) & (angle <= 0.9)
        fits = {p: (np.abs(angle - seen[p]) <= tolerance) & apart for p in combinations(range(3), 2)}
        a, b = np.nonzero(fits[(0, 1)])
        for p, q in zip(a.tolist(), b.tolist(), strict=True):
            for r in np.flatnonzero(fits[(0, 2)][p] & fits[(1, 2)][q]).tolist():
                expected.add((p, q, r))
        got = set(map(tuple, consistent_names((0, 1, 2), table).tolist()))
        assert got == expected
        assert tuple(near[:3].tolist()) in got
        found += 1
    assert found >= 10


def test_a_mirrored_figure_is_excluded() -> None:
    """The matches of a mirrored triangle are consistent but of the wrong handedness; none remains."""
    stars = load_stars(3.0)
    directory = sin2_directory(distance_table(stars, 0.0, 0.6), len(stars))
    rotation = cam_from_icrs(np.radians(84.0), 0.0, 0.7)
    near = np.flatnonzero(stars.icrs @ rotation[2] > np.cos(0.25))[:4]
    unit = stars.icrs[near] @ rotation.T
    mirrored = unit * [-1.0, 1.0, 1.0]
    for seen, expected in ((unit, True), (mirrored, False)):
        table = baselines(seen, np.full((4, 4), 3e-4), directory)
        assert len(consistent_names((0, 1, 2, 3), table)) >= 1
        names = match_figure((0, 1, 2, 3), table, seen, stars.icrs)
        assert (near.tolist() in names.tolist()) is expected


def test_pyramids_are_confirmed_by_a_fourth_star() -> None:
    """Each pyramid matches four different stars correctly; without a fourth star there is no match."""
    stars = load_stars(3.5)
    directory = sin2_directory(distance_table(stars, 0.0, 0.6), len(stars))
    rotation = cam_from_icrs(np.radians(84.0), 0.0, 2.7)
    near = np.flatnonzero(stars.icrs @ rotation[2] > np.cos(0.2))
    unit = stars.icrs[near] @ rotation.T
    table = baselines(unit, np.full((len(near), len(near)), 2e-4), directory)
    found = next(pyramids(unit, stars.icrs, table, 100))
    np.testing.assert_array_equal(found.names, near[list(found.figure)])
    assert list(pyramids(unit[:3], stars.icrs, baselines(unit[:3], np.full((3, 3), 2e-4), directory), 100)) == []


def test_the_processors_density_rule_keeps_the_brightest() -> None:
    """Every star among the five brightest of the circle around it is kept, and the lattice has no gap."""
    stars = load_stars(4.0)
    kept = brightest_per_field(stars.icrs, np.arange(len(stars)), 0.25, 5)
    assert 0 < kept.sum() < len(stars)
    in_circle = stars.icrs @ lattice(0.0625).T >= np.cos(0.25)
    brighter = np.cumsum(in_circle, axis=0) - in_circle
    np.testing.assert_array_equal(kept, (in_circle & (brighter < 5)).any(axis=1))
    rng = np.random.default_rng(6)
    at = rng.normal(size=(500, 3))
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    assert np.arccos((at @ lattice(0.1).T).max(axis=1)).max() < 0.1


def _frames(seed: int, turn_rad: float, noise_px: float = 0.1) -> tuple[Centroids, Centroids, Array, Array]:
    """Return two frames of the sky, the rotation between them and the attitude of the first."""
    rng = np.random.default_rng(seed)
    stars = load_stars(4.0)
    axis = rng.normal(size=3)
    turn = rotation_from_vector(axis / np.linalg.norm(axis) * turn_rad)
    first = matrix_from_quaternion(random_quaternion(rng))
    made = []
    for rotation in (first, turn @ first):
        truth = truth_of(stars_near(stars, CAMERA, rotation), CAMERA, rotation)
        pixels = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
        made.append(Centroids.from_pixels(pixels, 10 ** (-0.4 * truth.v_mag), noise_px))
    return made[0], made[1], turn, first


@pytest.mark.parametrize("method", ["triangle", "rate", "auto"])
def test_the_rotation_between_two_frames_is_measured(method: str) -> None:
    """Thirty pairs of frames 2° apart: every result is the true rotation within five standard deviations, 26 have a
    result.
    """
    answered = 0
    for seed in range(30):
        before, after, turn, _ = _frames(seed, np.radians(2))
        near = quaternion_from_matrix(rotation_from_vector(np.array([0.003, -0.002, 0.004])) @ turn)
        expected = near if method == "rate" else None
        found = relative_attitude(before, after, CAMERA, PARAMETERS, method, expected)
        if found.quaternion is None:
            assert found.reason
            continue
        answered += 1
        off = rotation_angle_rad(matrix_from_quaternion(found.quaternion), turn)
        assert off < 5 * np.sqrt(np.trace(found.covariance_rad2))
    assert answered >= 26


def test_frames_of_different_skies_have_no_rotation() -> None:
    """Frames without common stars give no rotation, by any matcher, in 30 trials."""
    for seed in range(30):
        before, after = _frames(seed, 0.0)[0], _frames(seed + 500, 0.0)[1]
        for method in ("triangle", "rate"):
            found = relative_attitude(before, after, CAMERA, PARAMETERS, method, np.array([0.0, 0, 0, 1]))
            assert found.quaternion is None
            assert found.reason


def test_two_stars_match_by_distance_and_brightness() -> None:
    """The pair matcher orders the two by brightness; with a second pair of that length it gives no match."""
    a = CAMERA.unproject(np.array([[200.0, 300.0], [900.0, 700.0]]))
    turn = rotation_from_vector(np.array([0.01, 0.02, 2.5]))
    b = (a @ turn.T)[::-1]
    pairs = pair_match(a, b, np.array([9.0, 2.0]), np.array([2.1, 8.7]), 1e-4)
    np.testing.assert_array_equal(pairs, [[0, 1], [1, 0]])
    doubled = np.vstack([b, CAMERA.unproject(np.array([[600.0, 100.0]]))])
    doubled[2] = doubled[0] @ rotation_from_vector(2.0 * doubled[1]).T
    assert len(pair_match(a, doubled, np.array([9.0, 2.0]), np.array([2.0, 8.0, 1.0]), 1e-4)) == 0


def test_mirrored_triangles_do_not_match() -> None:
    """A triangle and its mirror image have the same sides and are not matched."""
    before = CAMERA.unproject(np.array([[200.0, 300.0], [900.0, 700.0], [700.0, 100.0]]))
    assert len(triangle_match(before, before * [-1.0, 1, 1], 1e-4)) == 0
    assert len(triangle_match(before, before, 1e-4)) == 3


def test_nearest_in_both_directions_is_required() -> None:
    """Two predictions for one measured star: only the nearer is matched; beyond the radius none."""
    base = CAMERA.unproject(np.array([[100.0, 100.0], [104.0, 100.0], [900.0, 900.0]]))
    seen = CAMERA.unproject(np.array([[103.0, 100.0], [950.0, 900.0]]))
    np.testing.assert_array_equal(mutual_nearest(base, seen, 10 * CAMERA.pixel_rad), [[1, 0]])
    assert mutual_nearest(base[:0], seen, 1.0).shape == (0, 2)


def test_stars_that_leave_the_frame_are_not_predicted() -> None:
    """After a rotation by half a frame a star at the leading edge is outside and has no partner."""
    pixels = np.array([[1200.0, 500.0], [100.0, 500.0]])
    before = CAMERA.unproject(pixels)
    turn = rotation_from_vector(np.array([0.0, 0.2, 0.0]))
    pairs = rate_match(before, before @ turn.T, turn, CAMERA, 1e-3)
    assert pairs[:, 0].tolist() == [1]


def test_constant_rate_predicts_the_next_attitude() -> None:
    """Two attitudes one rotation apart give the third."""
    rng = np.random.default_rng(7)
    first, turn = matrix_from_quaternion(random_quaternion(rng)), rotation_from_vector(np.array([0.1, -0.2, 0.05]))
    second, third = turn @ first, turn @ turn @ first
    found = extrapolate(quaternion_from_matrix(second), quaternion_from_matrix(first))
    assert rotation_angle_rad(found, third) < 1e-14


def test_errors_of_chained_attitudes_accumulate() -> None:
    """Over ten frames the chained attitude stays within its covariance, which grows (Huffman 2006 eq. 7.1)."""
    rng = np.random.default_rng(8)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    attitude = Attitude(quaternion_from_matrix(rotation), np.eye(3) * 1e-10)
    before_trace = np.trace(attitude.covariance_rad2)
    for _ in range(10):
        turn = rotation_from_vector(rng.normal(size=3) * 0.01)
        sigma = 1e-5
        noisy = rotation_from_vector(rng.normal(size=3) * sigma) @ turn
        pairs = np.zeros((3, 2), np.intp)
        step = Relative(quaternion_from_matrix(noisy), np.eye(3) * sigma**2, pairs, "rate", 0.0, "")
        attitude, rotation = chained(attitude, step), turn @ rotation
        assert np.trace(attitude.covariance_rad2) > before_trace
        before_trace = np.trace(attitude.covariance_rad2)
    assert before_trace == pytest.approx(3 * (1e-10 + 10 * 1e-10), rel=1e-6)
    assert rotation_angle_rad(attitude.cam_from_icrs, rotation) < 4 * np.sqrt(before_trace)


def test_invalid_relative_requests_are_rejected() -> None:
    """Unknown matchers, a rate match without a rotation, and chaining nothing are rejected; a single star gives a
    reason.
    """
    before, after, _, _ = _frames(1, 0.01)
    with pytest.raises(BadInput, match="matcher"):
        relative_attitude(before, after, CAMERA, PARAMETERS, "magic")
    with pytest.raises(BadInput, match="interval"):
        relative_attitude(before, after, CAMERA, PARAMETERS, "rate")
    nothing = relative_attitude(before.take(np.arange(1)), after, CAMERA, PARAMETERS)
    assert nothing.quaternion is None
    assert "too few" in nothing.reason
    with pytest.raises(BadInput, match="chain"):
        chained(Attitude(np.array([0.0, 0, 0, 1]), np.eye(3)), nothing)
