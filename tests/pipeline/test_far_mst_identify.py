"""FAR-MST's single matchers: the document's examples, comparison with brute force, and pairs of frames."""

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


def _baselines_of(s_matrix: dict[int, dict[int, list[int]]], vertices: int) -> Baselines:
    """Return baselines with the candidates of a given matrix S instead of those of a directory."""
    empty = sin2_directory(distance_table(load_stars(0.0), 0.0, 1e-6), 100)
    table = Baselines(empty, np.zeros((vertices, vertices), np.intp), np.zeros((vertices, vertices), np.intp))
    for number, (i, j) in enumerate(combinations(range(vertices), 2), start=1):
        keys = sorted({p * 100 + q for p, row in s_matrix.items() for q in row.get(number, [])})
        table._columns[(i, j)] = BaselineCandidates(np.array(keys, np.intp), 100)
    return table


def test_matrix_s_of_the_document_gives_its_stars() -> None:
    """Matrix S of Table 5.4 (star C in columns 2, 4 and 6) gives A = 45, B = 46, C = 47 and D = 48."""
    s_matrix = {
        45: {1: [46], 2: [47], 3: [48]},
        46: {1: [45], 4: [47], 5: [48]},
        47: {2: [45], 4: [46], 6: [48]},
        48: {3: [45], 5: [46], 6: [47]},
    }
    names = consistent_names((0, 1, 2, 3), _baselines_of(s_matrix, 4))
    np.testing.assert_array_equal(names, [[45, 46, 47, 48]])


def test_candidate_star_matrix_of_the_document_is_reduced() -> None:
    """The matrix of Fig. 5.6, with the 9 that the text requires, reduces to star 1 = 3, star 2 = 5 and star 3 = 9."""
    masks = [np.zeros((10, 10), bool) for _ in range(3)]
    for mask, (i, j) in zip(masks, ((3, 5), (9, 5), (3, 9)), strict=True):
        mask[i, j] = mask[j, i] = True
    masks[2][5, 4] = masks[2][4, 5] = True
    remaining = candidate_star_matrix(*masks)
    assert len(remaining) == 3
    assert sorted(map(tuple, remaining.tolist())) == [(-1, 5, 9), (3, -1, 9), (3, 5, -1)]


@pytest.mark.parametrize("vertices", [3, 4, 5])
def test_figures_are_complete_and_start_with_the_brightest_stars(vertices: int) -> None:
    """Every figure of eight stars is generated once, the brightest first. In the first half of the triads, no star is
    in four consecutive ones (§5.5.2).
    """
    generated = figures(8, vertices)
    assert sorted(generated) == list(combinations(range(8), vertices))
    assert generated[0] == tuple(range(vertices))
    if vertices == 3:
        runs = [
            sum(all(star in t for t in generated[k : k + 4]) for star in range(8)) for k in range(len(generated) // 2)
        ]
        assert max(runs) == 0
    assert figures(2, 3) == ()


def test_consistent_matches_equal_brute_force() -> None:
    """For random triangles, the matches are the same as those of a comparison of all angles."""
    rng = np.random.default_rng(3)
    stars = load_stars(2.0)
    directory = sin2_directory(distance_table(stars, 0.0, 0.9), len(stars))
    tolerance = 0.02
    compared = 0
    for _ in range(30):
        centre = stars.icrs[rng.integers(len(stars))]
        nearby = np.flatnonzero(stars.icrs @ centre > np.cos(0.42))[:6]
        if len(nearby) < 3:
            continue
        unit = stars.icrs[nearby]
        table = baselines(unit, np.full((len(nearby), len(nearby)), tolerance), directory)
        expected: set[tuple[int, ...]] = set()
        angle = np.arccos(np.clip(stars.icrs @ stars.icrs.T, -1, 1))
        measured = np.arccos(np.clip(unit @ unit.T, -1, 1))
        separate = (angle > 1e-6) & (angle <= 0.9)
        fits = {p: (np.abs(angle - measured[p]) <= tolerance) & separate for p in combinations(range(3), 2)}
        a, b = np.nonzero(fits[(0, 1)])
        for p, q in zip(a.tolist(), b.tolist(), strict=True):
            for r in np.flatnonzero(fits[(0, 2)][p] & fits[(1, 2)][q]).tolist():
                expected.add((p, q, r))
        matches = set(map(tuple, consistent_names((0, 1, 2), table).tolist()))
        assert matches == expected
        assert tuple(nearby[:3].tolist()) in matches
        compared += 1
    assert compared >= 10


def test_the_compiled_match_gives_the_same_sets_in_the_same_order() -> None:
    """With a wide tolerance, the sets of random figures of three to five stars are the same with numpy and with the compiled
    loop. The figures have none to hundreds of sets; some contain a false star.
    """
    rng = np.random.default_rng(8)
    stars = load_stars(4.0)
    directory = sin2_directory(distance_table(stars, 0.0, 0.5), len(stars))
    sizes = []
    for number in range(30):
        centre = stars.icrs[rng.integers(len(stars))]
        nearby = rng.permutation(np.flatnonzero(stars.icrs @ centre > np.cos(0.24)))[:5]
        if len(nearby) < 5:
            continue
        unit = stars.icrs[nearby].copy()
        if number % 3 == 0:
            unit[3] = stars.icrs[rng.integers(len(stars))]
        tolerance = np.full((5, 5), 10 ** rng.uniform(-4, -1.5))
        with_numpy, compiled = (baselines(unit, tolerance, directory, fast=fast) for fast in (False, True))
        for vertices in (3, 4, 5):
            expected = consistent_names(tuple(range(vertices)), with_numpy)
            np.testing.assert_array_equal(consistent_names(tuple(range(vertices)), compiled), expected)
            sizes.append(len(expected))
        assert compiled.hits == with_numpy.hits
    assert min(sizes) == 0
    assert max(sizes) > 100


def test_a_mirrored_figure_is_excluded() -> None:
    """The matches of a mirrored triangle are consistent but have the wrong handedness, and are excluded."""
    stars = load_stars(3.0)
    directory = sin2_directory(distance_table(stars, 0.0, 0.6), len(stars))
    rotation = cam_from_icrs(np.radians(84.0), 0.0, 0.7)
    nearby = np.flatnonzero(stars.icrs @ rotation[2] > np.cos(0.25))[:4]
    unit = stars.icrs[nearby] @ rotation.T
    mirrored = unit * [-1.0, 1.0, 1.0]
    for measured, expected in ((unit, True), (mirrored, False)):
        table = baselines(measured, np.full((4, 4), 3e-4), directory)
        assert len(consistent_names((0, 1, 2, 3), table)) >= 1
        names = match_figure((0, 1, 2, 3), table, measured, stars.icrs)
        assert (nearby.tolist() in names.tolist()) is expected


def test_pyramids_are_confirmed_by_a_fourth_star() -> None:
    """A pyramid matches four different stars correctly. Without a fourth star there is no match."""
    stars = load_stars(3.5)
    directory = sin2_directory(distance_table(stars, 0.0, 0.6), len(stars))
    rotation = cam_from_icrs(np.radians(84.0), 0.0, 2.7)
    nearby = np.flatnonzero(stars.icrs @ rotation[2] > np.cos(0.2))
    unit = stars.icrs[nearby] @ rotation.T
    table = baselines(unit, np.full((len(nearby), len(nearby)), 2e-4), directory)
    pyramid = next(pyramids(unit, stars.icrs, table, 100))
    np.testing.assert_array_equal(pyramid.names, nearby[list(pyramid.figure)])
    assert list(pyramids(unit[:3], stars.icrs, baselines(unit[:3], np.full((3, 3), 2e-4), directory), 100)) == []


def test_the_density_rule_keeps_the_brightest_stars() -> None:
    """Exactly the stars that are among the five brightest of some circle are selected, and the lattice of circles has
    no gap.
    """
    stars = load_stars(4.0)
    selected = brightest_per_field(stars.icrs, np.arange(len(stars)), 0.25, 5)
    assert 0 < selected.sum() < len(stars)
    in_circle = stars.icrs @ lattice(0.0625).T >= np.cos(0.25)
    brighter = np.cumsum(in_circle, axis=0) - in_circle
    np.testing.assert_array_equal(selected, (in_circle & (brighter < 5)).any(axis=1))
    rng = np.random.default_rng(6)
    directions = rng.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.arccos((directions @ lattice(0.1).T).max(axis=1)).max() < 0.1


def _frames(seed: int, turn_rad: float, noise_px: float = 0.1) -> tuple[Centroids, Centroids, Array, Array]:
    """Return the centroids of two frames, the rotation between them and the attitude of the first."""
    rng = np.random.default_rng(seed)
    stars = load_stars(4.0)
    axis = rng.normal(size=3)
    turn = rotation_from_vector(axis / np.linalg.norm(axis) * turn_rad)
    first = matrix_from_quaternion(random_quaternion(rng))
    frames = []
    for rotation in (first, turn @ first):
        truth = truth_of(stars_near(stars, CAMERA, rotation), CAMERA, rotation)
        pixels = truth.pixels + noise_px * rng.normal(size=truth.pixels.shape)
        frames.append(Centroids.from_pixels(pixels, 10 ** (-0.4 * truth.v_mag), noise_px))
    return frames[0], frames[1], turn, first


@pytest.mark.parametrize("method", ["triangle", "rate", "auto"])
def test_the_rotation_between_two_frames_is_measured(method: str) -> None:
    """Of thirty pairs of frames 2° apart, at least 26 give a rotation, and every result is correct within five standard
    deviations.
    """
    measured = 0
    for seed in range(30):
        before, after, turn, _ = _frames(seed, np.radians(2))
        approximate = quaternion_from_matrix(rotation_from_vector(np.array([0.003, -0.002, 0.004])) @ turn)
        expected = approximate if method == "rate" else None
        relative = relative_attitude(before, after, CAMERA, PARAMETERS, method, expected)
        if relative.quaternion is None:
            assert relative.reason
            continue
        measured += 1
        error_rad = rotation_angle_rad(matrix_from_quaternion(relative.quaternion), turn)
        assert error_rad < 5 * np.sqrt(np.trace(relative.covariance_rad2))
    assert measured >= 26


def test_frames_of_different_skies_have_no_rotation() -> None:
    """Frames without common stars give no rotation with any matcher, in 30 trials."""
    for seed in range(30):
        before, after = _frames(seed, 0.0)[0], _frames(seed + 500, 0.0)[1]
        for method in ("triangle", "rate"):
            relative = relative_attitude(before, after, CAMERA, PARAMETERS, method, np.array([0.0, 0, 0, 1]))
            assert relative.quaternion is None
            assert relative.reason


def test_two_stars_match_by_distance_and_brightness() -> None:
    """The pair matcher orders two stars by brightness. If a second pair has the same length, there is no match."""
    before = CAMERA.unproject(np.array([[200.0, 300.0], [900.0, 700.0]]))
    turn = rotation_from_vector(np.array([0.01, 0.02, 2.5]))
    after = (before @ turn.T)[::-1]
    pairs = pair_match(before, after, np.array([9.0, 2.0]), np.array([2.1, 8.7]), 1e-4)
    np.testing.assert_array_equal(pairs, [[0, 1], [1, 0]])
    ambiguous = np.vstack([after, CAMERA.unproject(np.array([[600.0, 100.0]]))])
    ambiguous[2] = ambiguous[0] @ rotation_from_vector(2.0 * ambiguous[1]).T
    assert len(pair_match(before, ambiguous, np.array([9.0, 2.0]), np.array([2.0, 8.0, 1.0]), 1e-4)) == 0


def test_mirrored_triangles_do_not_match() -> None:
    """A triangle and its mirror image have the same sides and are not matched."""
    before = CAMERA.unproject(np.array([[200.0, 300.0], [900.0, 700.0], [700.0, 100.0]]))
    assert len(triangle_match(before, before * [-1.0, 1, 1], 1e-4)) == 0
    assert len(triangle_match(before, before, 1e-4)) == 3


def test_matches_are_mutually_nearest() -> None:
    """If two predictions are close to one measured star, only the nearer is matched. Stars beyond the radius are not
    matched.
    """
    predicted = CAMERA.unproject(np.array([[100.0, 100.0], [104.0, 100.0], [900.0, 900.0]]))
    measured = CAMERA.unproject(np.array([[103.0, 100.0], [950.0, 900.0]]))
    np.testing.assert_array_equal(mutual_nearest(predicted, measured, 10 * CAMERA.pixel_rad), [[1, 0]])
    assert mutual_nearest(predicted[:0], measured, 1.0).shape == (0, 2)


def test_stars_that_leave_the_frame_are_not_predicted() -> None:
    """After a rotation that moves a star at the leading edge out of the frame, the star has no match."""
    pixels = np.array([[1200.0, 500.0], [100.0, 500.0]])
    before = CAMERA.unproject(pixels)
    turn = rotation_from_vector(np.array([0.0, 0.2, 0.0]))
    pairs = rate_match(before, before @ turn.T, turn, CAMERA, 1e-3)
    assert pairs[:, 0].tolist() == [1]


def test_constant_rate_predicts_the_next_attitude() -> None:
    """Two attitudes that differ by one rotation predict the third."""
    rng = np.random.default_rng(7)
    first, turn = matrix_from_quaternion(random_quaternion(rng)), rotation_from_vector(np.array([0.1, -0.2, 0.05]))
    second, third = turn @ first, turn @ turn @ first
    predicted = extrapolate(quaternion_from_matrix(second), quaternion_from_matrix(first))
    assert rotation_angle_rad(predicted, third) < 1e-14


def test_errors_of_chained_attitudes_accumulate() -> None:
    """Over ten frames, the error of the chained attitude agrees with its covariance, which grows with each frame
    (Huffman 2006 eq. 7.1).
    """
    rng = np.random.default_rng(8)
    rotation = matrix_from_quaternion(random_quaternion(rng))
    attitude = Attitude(quaternion_from_matrix(rotation), np.eye(3) * 1e-10)
    last_trace = np.trace(attitude.covariance_rad2)
    for _ in range(10):
        turn = rotation_from_vector(rng.normal(size=3) * 0.01)
        sigma = 1e-5
        noisy = rotation_from_vector(rng.normal(size=3) * sigma) @ turn
        pairs = np.zeros((3, 2), np.intp)
        step = Relative(quaternion_from_matrix(noisy), np.eye(3) * sigma**2, pairs, "rate", 0.0, "")
        attitude, rotation = chained(attitude, step), turn @ rotation
        assert np.trace(attitude.covariance_rad2) > last_trace
        last_trace = np.trace(attitude.covariance_rad2)
    assert last_trace == pytest.approx(3 * (1e-10 + 10 * 1e-10), rel=1e-6)
    assert rotation_angle_rad(attitude.cam_from_icrs, rotation) < 4 * np.sqrt(last_trace)


def test_invalid_relative_requests_are_rejected() -> None:
    """Unknown matchers, a rate match without an expected rotation, and chaining without a rotation are rejected. A
    single star gives a reason.
    """
    before, after, _, _ = _frames(1, 0.01)
    with pytest.raises(BadInput, match="matcher"):
        relative_attitude(before, after, CAMERA, PARAMETERS, "magic")
    with pytest.raises(BadInput, match="interval"):
        relative_attitude(before, after, CAMERA, PARAMETERS, "rate")
    no_rotation = relative_attitude(before.take(np.arange(1)), after, CAMERA, PARAMETERS)
    assert no_rotation.quaternion is None
    assert "too few" in no_rotation.reason
    with pytest.raises(BadInput, match="chain"):
        chained(Attitude(np.array([0.0, 0, 0, 1]), np.eye(3)), no_rotation)
