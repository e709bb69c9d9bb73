"""Moving objects in rendered frames are found, measured within their errors, and distinguished from defective pixels,
particles and stars.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.angles import Array, separation_rad
from gss.domain.camera import Camera
from gss.domain.rotation import rotation_from_vector
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.moving.line_fit import LINE, POINT, WIDTH, Cutout, fit_line
from gss.pipeline.moving.spots import FrameSpots, SolvedView, find_spots, tangent
from gss.pipeline.moving.tracklets import HOT, ONCE, REST, SHARP, Linked, link
from gss.pipeline.readout import HotPixel
from gss.pipeline.render import FalseStar, Lights, render
from gss.pipeline.trail_shape import trailed_gaussian

CAMERA = Camera.from_fov(384, 288, float(np.radians(14.0)))
SENSOR = replace(shipped_camera("sunsat").sensor, faint_limit_mag=6.0)
EXPOSURE_S, FRAMES = 0.5, 8
RATE = np.radians([0.03, -0.02, 0.05])
ATTITUDE = rotation_from_vector(np.array([0.3, -1.1, 0.4]))
TOP_RATE = float(np.radians(2.0))
SLOW, FAST = np.array([60.0, 80.0]), np.array([11.0, 7.0])
"""Start of a slow object and its motion per second, in pixels of the first frame."""


@pytest.fixture(scope="module")
def stars() -> StarTable:
    """Stars to V 8 at epoch 2026."""
    return SolverCache().stars(2026.0).brighter_than(8.0)


def attitude_at(time_s: float) -> Array:
    """Return the attitude of the rotating camera."""
    return np.asarray(rotation_from_vector(-RATE * time_s) @ ATTITUDE)


def direction(start_px: Array, step_px: Array, time_s: float) -> Array:
    """Return the ICRS direction of an object that moves along a straight line in pixels of the first frame."""
    return np.asarray(CAMERA.unproject((start_px + step_px * time_s)[None])[0] @ ATTITUDE)


def trail_points(start_px: Array, step_px: Array, time_s: float, v_mag: float) -> list[FalseStar]:
    """Return the light of the object during one exposure, as points."""
    points = []
    for offset_s in (np.arange(24) + 0.5) / 24 * EXPOSURE_S - EXPOSURE_S / 2:
        icrs = direction(start_px, step_px, time_s + offset_s)
        col, row = CAMERA.project((attitude_at(time_s + offset_s) @ icrs)[None])[0]
        points.append(FalseStar(float(col), float(row), v_mag + 2.5 * float(np.log10(24))))
    return points


def view_at(time_s: float) -> SolvedView:
    """Return the view of a frame with exactly known attitude."""
    return SolvedView(time_s, EXPOSURE_S, CAMERA, attitude_at(time_s), np.zeros((3, 3)), RATE)


@pytest.fixture(scope="module")
def detected(stars: StarTable) -> tuple[list[FrameSpots], Linked]:
    """Detection and linking in eight frames with an object, a fast object in one frame, hot pixels, a particle track, a
    flash and a new star.
    """
    rng = np.random.default_rng(4)
    new_star = Lights(direction(np.array([300.0, 60.0]), np.zeros(2), 0.0)[None], np.array([4.0]))
    hot = [HotPixel(c, r, 0.2 * SENSOR.full_well_e) for c in (150, 151) for r in (200, 201)]
    frames = []
    for k in range(FRAMES):
        points = trail_points(SLOW, FAST, float(k), 4.0)
        extra_hot = list(hot)
        if k == 3:
            points += trail_points(np.array([240.0, 150.0]) - 3 * 60.0, np.array([60.0, 60.0]), 3.0, 3.0)
            points.append(FalseStar(330.0, 230.0, 4.0))
        if k == 5:
            extra_hot += [HotPixel(200 + j, 100, 0.2 * SENSOR.full_well_e) for j in range(25)]
        image = render(
            stars,
            CAMERA,
            SENSOR,
            attitude_at(k),
            EXPOSURE_S,
            rng,
            rate_rad_s=RATE,
            hot_pixels=extra_hot,
            false_stars=points,
            lights=new_star,
        )
        spots = find_spots(image.pixels, view_at(float(k)), stars, SENSOR)
        assert spots is not None
        frames.append(spots)
    return frames, link(frames, TOP_RATE)


def test_an_object_gives_one_track_with_correct_positions(detected: tuple[list[FrameSpots], Linked]) -> None:
    """The directions and the ends of the trails agree with the truth within their covariances."""
    [track] = detected[1].moving
    assert len(track) >= FRAMES - 1
    true = np.array([direction(SLOW, FAST, t) for t in track.times_s])
    error = np.einsum("nij,nj->ni", tangent(track.icrs), true - track.icrs)
    assert np.einsum("ni,nij,nj->n", error, np.linalg.inv(track.covariance_rad2), error).max() < 16
    assert track.speed_rad_s == pytest.approx(np.hypot(*FAST) * CAMERA.pixel_rad, rel=0.05)
    assert np.median(track.v_mag) == pytest.approx(4.0, abs=0.15)
    assert track.chance < 1e-6
    measured = np.isfinite(track.ends_sigma_rad).all(axis=1)
    assert np.count_nonzero(measured) >= FRAMES - 1
    assert np.median(track.ends_sigma_rad[measured]) < CAMERA.pixel_rad
    for end, sign in enumerate((-1, 1)):
        ends = np.array([direction(SLOW, FAST, t + sign * EXPOSURE_S / 2) for t in track.times_s])
        error_rad = separation_rad(ends, track.ends_icrs[:, end])
        assert np.max(error_rad[measured] / track.ends_sigma_rad[measured, end]) < 5


def test_a_trail_in_one_frame_has_both_ends(detected: tuple[list[FrameSpots], Linked]) -> None:
    """A fast object that appears in one frame is reported with both ends, in either order."""
    [streak] = detected[1].streaks
    start, step = np.array([240.0, 150.0]) - 3 * 60.0, np.array([60.0, 60.0])
    ends = [direction(start, step, 3.0 + s * EXPOSURE_S / 2) for s in (-1, 1)]
    error_px = separation_rad(streak.ends_icrs[0][:, None], np.array(ends)[None]) / CAMERA.pixel_rad
    assert min(error_px[0, 0] + error_px[1, 1], error_px[0, 1] + error_px[1, 0]) < 3


def test_everything_else_is_rejected_with_its_reason(detected: tuple[list[FrameSpots], Linked]) -> None:
    """Hot pixels, the particle, the flash and the star that is not in the catalogue are each rejected with their
    reason.
    """
    frames, linked = detected
    reason_at = {
        (k, int(np.rint(c)), int(np.rint(r))): linked.reasons[k][row]
        for k, frame in enumerate(frames)
        for row, (c, r) in enumerate(frame.pixels)
    }
    rounded = {(c, r, why) for (_, c, r), why in reason_at.items()}
    assert any(why == HOT and abs(c - 150) <= 1 and abs(r - 200) <= 1 for c, r, why in rounded)
    assert any(why == SHARP and abs(r - 100) <= 2 for _, r, why in rounded)
    assert reason_at[3, 330, 230] == ONCE
    assert sum(why == REST for why in reason_at.values()) >= FRAMES - 1
    assert len(linked.resting) == 1


def test_unrelated_sources_give_no_track() -> None:
    """Twenty random sources in each of ten frames are not linked."""
    rng = np.random.default_rng(8)
    frames = [spots_at(float(k), rng.uniform((0, 0), (384, 288), (20, 2))) for k in range(10)]
    linked = link(frames, TOP_RATE)
    assert linked.moving == linked.resting == linked.streaks == []


def spots_at(time_s: float, pixels: Array) -> FrameSpots:
    """Return point sources of one frame with an error of a tenth of a pixel."""
    n = len(pixels)
    icrs = CAMERA.unproject(pixels) @ attitude_at(time_s)
    ends = np.broadcast_to(icrs[:, None, None], (n, 2, 2, 3))
    ones = np.ones(n)
    covariance = np.broadcast_to(np.eye(2) * (0.1 * CAMERA.pixel_rad) ** 2, (n, 2, 2))
    zeros = np.zeros((n, 2))
    return FrameSpots(
        view_at(time_s), pixels, zeros, ones, icrs, covariance, ends, zeros, ones, ones, 10 * ones, ones < 0, 7.0, 1.2
    )


def test_the_ends_of_a_trail_have_the_stated_errors() -> None:
    """For sixty noisy trails, the normalised errors of the ends have unit scatter and no bias. A single bright pixel
    is narrower than a star.
    """
    rng = np.random.default_rng(1)
    dy, dx = (a.ravel().astype(float) for a in np.mgrid[-12:13, -12:13])
    trail = np.array([[9.0, 5.0]])
    shape, _ = trailed_gaussian(dx[None] - 0.3, dy[None] + 0.2, trail, 1.5)
    normalised = []
    for _ in range(60):
        cut = Cutout(dx, dy, 900 * shape[0] + rng.normal(0, 3.0, len(dx)), 9.0, 0.0)
        fit = fit_line(cut, np.array([700.0, 0.0, 0.0, 7.0, 6.0, 1.5]), LINE)
        assert fit is not None
        ends = fit.centre_px + np.array([[-0.5], [0.5]]) * fit.trail_px
        error = ends - (np.array([0.3, -0.2]) + np.array([[-0.5], [0.5]]) * trail)
        normalised.append(error / np.sqrt(np.diagonal(fit.end_covariance(), axis1=1, axis2=2)))
    assert 0.8 < float(np.sqrt(np.mean(np.square(normalised)))) < 1.25
    assert np.abs(np.mean(normalised, axis=0)).max() < 4 / np.sqrt(len(normalised))
    single_pixel = Cutout(dx, dy, 300.0 * ((dx == 0) & (dy == 0)) + rng.normal(0, 3.0, len(dx)), 9.0, 0.0)
    sharp = fit_line(single_pixel, np.array([300.0, 0.0, 0.0, 0.0, 0.0, 1.5]), (*POINT, WIDTH))
    assert sharp is not None
    assert sharp.variance_px2 < 0.4


@pytest.mark.parametrize("v_mag", [3.0, 3.5])
def test_a_faint_long_trail_is_fitted_over_its_whole_length(stars: StarTable, v_mag: float) -> None:
    """Only parts of a trail near the threshold exceed it, and a star on it divides it. The fitted length is nevertheless
    that of the motion, in every frame.
    """
    step = np.array([80.0, 30.0])
    lengths, errors = [], []
    for k in range(4):
        rng = np.random.default_rng([9, k])
        image = render(
            stars,
            CAMERA,
            SENSOR,
            attitude_at(0.0),
            EXPOSURE_S,
            rng,
            rate_rad_s=RATE,
            false_stars=trail_points(np.array([190.0, 140.0]), step, 0.0, v_mag),
        )
        spots = find_spots(image.pixels, view_at(0.0), stars, SENSOR)
        assert spots is not None
        distance_px = np.linalg.norm(spots.pixels - [190.0, 140.0], axis=1)
        best = int(np.argmin(distance_px))
        lengths.append(float(np.hypot(*spots.trail_px[best])))
        errors.append(float(distance_px[best]))
    true_px = EXPOSURE_S * float(np.hypot(*step))
    assert lengths == pytest.approx([true_px] * len(lengths), rel=0.05)
    assert np.median(errors) < 1.5
