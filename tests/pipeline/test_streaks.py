"""Angular velocity from the trails of a single frame, against rendered truth."""

from __future__ import annotations

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import Turning
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.pipeline.detect import find_stars
from gss.pipeline.render import Rendered, render
from gss.pipeline.streaks import measure_turning, trail_per_rad, with_sign_of
from gss.pipeline.trail_shape import trailed_gaussian

STARS = load_stars(6.0)


def shot(known: CameraProfile, rate_rad_s: Array, rng: np.random.Generator) -> Rendered:
    """A frame of a turning camera at a random attitude."""
    pose = matrix_from_quaternion(random_quaternion(rng))
    return render(STARS, known.camera, known.sensor, pose, known.sensor.exposure_s, rng, rate_rad_s=rate_rad_s)


def measured(known: CameraProfile, frame: Rendered) -> Turning | None:
    """Solve the frame with the reference chain."""
    s = known.sensor
    found = find_stars(
        frame.pixels, psf_sigma_px=s.psf_sigma_px, saturation_dn=s.saturation_dn, e_per_dn=s.gain_e_per_dn
    )
    if not found.trailed:
        return None
    return measure_turning(
        frame.pixels,
        found.centroids,
        found.background,
        known.camera,
        s.exposure_s,
        found.psf_covariance_px2,
        psf_sigma_px=s.psf_sigma_px,
        e_per_dn=s.gain_e_per_dn,
        saturation_dn=s.saturation_dn,
    )


def test_trails_give_the_rate_within_its_covariance() -> None:
    """Over random turns, mostly across and mostly about the boresight, the error is centred and as large as the covariance says."""
    known = shipped_camera("cubestar")
    rng = np.random.default_rng(21)
    normalised, chi2, ratio, refused = [], [], [], 0
    for k in range(24):
        direction = rng.normal(size=3) * ([0.1, 0.1, 1.0] if k % 4 == 0 else 1.0)
        trail_px = rng.uniform(4, 10) * (5 if k % 4 == 0 else 1)
        rate = direction / np.linalg.norm(direction) * trail_px * known.camera.pixel_rad / known.sensor.exposure_s
        turning = measured(known, shot(known, rate, rng))
        if turning is None:
            refused += 1
            continue
        assert not turning.sign_known
        error = with_sign_of(turning, rate).vector_rad_s - rate
        normalised.append(error / np.array(turning.sigma_rad_s))
        chi2.append(error @ np.linalg.solve(turning.covariance_rad2_s2, error))
        ratio.append(turning.speed_rad_s / np.linalg.norm(rate))
    assert refused <= 6  # trails of two pixels look like round stars
    assert np.abs(np.mean(normalised, axis=0)).max() < 0.9
    assert 0.5 < np.mean(chi2) / 3 < 1.8
    assert max(chi2) < 30
    assert abs(np.mean(ratio) - 1) < 0.02


def test_standing_cameras_do_not_turn() -> None:
    """Round stars give no rate, with CubeStar's and with Sunsat's camera."""
    rng = np.random.default_rng(22)
    for name in ("cubestar", "sunsat"):
        for _ in range(6):
            assert measured(shipped_camera(name), shot(shipped_camera(name), np.zeros(3), rng)) is None


def test_positions_of_trails_are_those_of_mid_exposure() -> None:
    """Centroids of a turning camera lie where the stars were at mid-exposure, without bias along the trail."""
    known = shipped_camera("cubestar")
    rng = np.random.default_rng(23)
    offsets = []
    for _ in range(6):
        rate = np.array([0.0, 8 * known.camera.pixel_rad / known.sensor.exposure_s, 0.0])
        frame = shot(known, rate, rng)
        found = find_stars(frame.pixels, psf_sigma_px=known.sensor.psf_sigma_px, saturation_dn=255.0).centroids
        distance = np.linalg.norm(found.pixels[:12, None] - frame.truth.pixels[None], axis=2)
        near = distance.argmin(1)
        close = distance.min(1) < 1.0
        offsets.append((found.pixels[:12] - frame.truth.pixels[near])[close])
    off = np.concatenate(offsets)
    assert len(off) > 50
    assert np.abs(np.median(off, axis=0)).max() < 0.06


def test_sign_comes_from_another_measurement() -> None:
    """A rate from elsewhere chooses between the vector and its opposite; the covariance stays."""
    turning = Turning(np.array([0.0, -2.0, 0.1]), np.eye(3), 9)
    settled = with_sign_of(turning, np.array([0.3, 1.0, 0.0]))
    assert settled.sign_known
    assert np.array_equal(settled.vector_rad_s, [0.0, 2.0, -0.1])


def test_trail_of_a_radian_is_that_of_a_small_turn() -> None:
    """The derivative of a place by the turn agrees with turning the direction and projecting it."""
    camera = shipped_camera("cubestar").camera
    pixels = np.array([[100.0, 80.0], [512.0, 256.0], [900.0, 400.0]])
    turn = np.array([2e-5, -3e-5, 5e-5])
    moved = camera.project(camera.unproject(pixels) @ rotation_from_vector(-turn).T)
    assert np.allclose(trail_per_rad(camera, pixels) @ turn, moved - pixels, atol=1e-5)


def test_slopes_of_the_trail_are_its_differences() -> None:
    """Every analytic derivative of the trail's light agrees with a finite difference."""
    rng = np.random.default_rng(24)
    ax, ay = rng.normal(0, 3, (2, 1, 40))
    trail, width2, h = np.array([[3.0, -1.5]]), 1.3, 1e-6
    _, slopes = trailed_gaussian(ax, ay, trail, width2)
    steps = [
        (trailed_gaussian(ax + h, ay, trail, width2), trailed_gaussian(ax - h, ay, trail, width2)),
        (trailed_gaussian(ax, ay + h, trail, width2), trailed_gaussian(ax, ay - h, trail, width2)),
        (
            trailed_gaussian(ax, ay, trail + np.array([[h, 0]]), width2),
            trailed_gaussian(ax, ay, trail - np.array([[h, 0]]), width2),
        ),
        (
            trailed_gaussian(ax, ay, trail + np.array([[0, h]]), width2),
            trailed_gaussian(ax, ay, trail - np.array([[0, h]]), width2),
        ),
        (trailed_gaussian(ax, ay, trail, width2 + h), trailed_gaussian(ax, ay, trail, width2 - h)),
    ]
    for k, (after, before) in enumerate(steps):
        assert np.allclose(slopes[..., k], (after[0] - before[0]) / (2 * h), atol=1e-8)


@pytest.mark.parametrize("columns", [0, 3])
def test_frames_without_trails_to_measure_have_no_rate(columns: int) -> None:
    """A blank frame and one with a few bright columns give none."""
    known = shipped_camera("cubestar")
    rng = np.random.default_rng(25)
    pixels = rng.normal(20, 2, (known.camera.rows, known.camera.columns))
    pixels[:, 100 : 100 + 40 * columns : 40] += 60
    frame = Rendered(np.clip(pixels, 0, 255).astype(np.uint8), shot(known, np.zeros(3), rng).truth)
    assert measured(known, frame) is None
