"""Angular velocity measured from the trails of a single rendered frame, compared with the truth."""

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


def rendered_frame(profile: CameraProfile, rate_rad_s: Array, rng: np.random.Generator) -> Rendered:
    """Render a frame of a rotating camera at a random attitude."""
    attitude = matrix_from_quaternion(random_quaternion(rng))
    return render(
        STARS, profile.camera, profile.sensor, attitude, profile.sensor.exposure_s, rng, rate_rad_s=rate_rad_s
    )


def measured_rate(profile: CameraProfile, frame: Rendered, fast: bool | None = None) -> Turning | None:
    """Measure the rotation from the trails of the frame, or return None if there are no trails."""
    sensor = profile.sensor
    detected = find_stars(
        frame.pixels,
        psf_sigma_px=sensor.psf_sigma_px,
        saturation_dn=sensor.saturation_dn,
        e_per_dn=sensor.gain_e_per_dn,
    )
    if not detected.trailed:
        return None
    return measure_turning(
        frame.pixels,
        detected.centroids,
        detected.background,
        profile.camera,
        sensor.exposure_s,
        detected.psf_covariance_px2,
        psf_sigma_px=sensor.psf_sigma_px,
        e_per_dn=sensor.gain_e_per_dn,
        saturation_dn=sensor.saturation_dn,
        fast=fast,
    )


def test_trails_give_the_rate_within_its_covariance() -> None:
    """For random rotations about all axes, the errors have no bias and agree with the covariance. Short trails may give
    no rate.
    """
    profile = shipped_camera("cubestar")
    rng = np.random.default_rng(21)
    normalised, chi2, ratio, unmeasured = [], [], [], 0
    for k in range(24):
        direction = rng.normal(size=3) * ([0.1, 0.1, 1.0] if k % 4 == 0 else 1.0)
        trail_px = rng.uniform(4, 10) * (5 if k % 4 == 0 else 1)
        rate = direction / np.linalg.norm(direction) * trail_px * profile.camera.pixel_rad / profile.sensor.exposure_s
        turning = measured_rate(profile, rendered_frame(profile, rate, rng))
        if turning is None:
            unmeasured += 1
            continue
        assert not turning.sign_known
        error = with_sign_of(turning, rate).vector_rad_s - rate
        normalised.append(error / np.array(turning.sigma_rad_s))
        chi2.append(error @ np.linalg.solve(turning.covariance_rad2_s2, error))
        ratio.append(turning.speed_rad_s / np.linalg.norm(rate))
    assert unmeasured <= 6  # trails of two pixels look like round stars
    assert np.abs(np.mean(normalised, axis=0)).max() < 0.9
    assert 0.5 < np.mean(chi2) / 3 < 1.8
    assert max(chi2) < 30
    assert abs(np.mean(ratio) - 1) < 0.02


def test_round_stars_give_no_rate() -> None:
    """Round stars give no rate, with CubeStar's and Sunsat's cameras."""
    rng = np.random.default_rng(22)
    for name in ("cubestar", "sunsat"):
        for _ in range(6):
            assert measured_rate(shipped_camera(name), rendered_frame(shipped_camera(name), np.zeros(3), rng)) is None


def test_positions_of_trails_are_those_of_mid_exposure() -> None:
    """Centroids of a rotating camera are the positions of the stars at mid-exposure, without bias along the trail."""
    profile = shipped_camera("cubestar")
    rng = np.random.default_rng(23)
    offsets = []
    for _ in range(6):
        rate = np.array([0.0, 8 * profile.camera.pixel_rad / profile.sensor.exposure_s, 0.0])
        frame = rendered_frame(profile, rate, rng)
        centroids = find_stars(frame.pixels, psf_sigma_px=profile.sensor.psf_sigma_px, saturation_dn=255.0).centroids
        distance = np.linalg.norm(centroids.pixels[:12, None] - frame.truth.pixels[None], axis=2)
        nearest = distance.argmin(1)
        close = distance.min(1) < 1.0
        offsets.append((centroids.pixels[:12] - frame.truth.pixels[nearest])[close])
    errors_px = np.concatenate(offsets)
    assert len(errors_px) > 50
    assert np.abs(np.median(errors_px, axis=0)).max() < 0.06


def test_the_sign_is_taken_from_another_measurement() -> None:
    """Another measurement selects between the rate vector and its opposite."""
    turning = Turning(np.array([0.0, -2.0, 0.1]), np.eye(3), 9)
    signed = with_sign_of(turning, np.array([0.3, 1.0, 0.0]))
    assert signed.sign_known
    assert np.array_equal(signed.vector_rad_s, [0.0, 2.0, -0.1])


def test_trail_per_radian_agrees_with_a_small_rotation() -> None:
    """The derivative of the position with respect to the rotation agrees with rotating the direction and projecting it."""
    camera = shipped_camera("cubestar").camera
    pixels = np.array([[100.0, 80.0], [512.0, 256.0], [900.0, 400.0]])
    turn = np.array([2e-5, -3e-5, 5e-5])
    moved = camera.project(camera.unproject(pixels) @ rotation_from_vector(-turn).T)
    assert np.allclose(trail_per_rad(camera, pixels) @ turn, moved - pixels, atol=1e-5)


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_numpy_and_compiled_loops_measure_the_same_rate(name: str) -> None:
    """The rates of both agree to a ten-thousandth of their standard deviation, for short and long trails and for a rotation
    about the optical axis."""
    profile, rng = shipped_camera(name), np.random.default_rng(25)
    measured = 0
    for direction in ([0.0, 5.0, 0.0], [3.0, -2.0, 4.0], [0.0, 0.0, 40.0], [-12.0, 9.0, 0.0]):
        rate = np.array(direction) * profile.camera.pixel_rad / profile.sensor.exposure_s
        frame = rendered_frame(profile, rate, rng)
        plain, compiled = (measured_rate(profile, frame, fast=fast) for fast in (False, True))
        assert (plain is None) == (compiled is None)
        if plain is not None and compiled is not None:
            measured += 1
            assert compiled.stars == plain.stars
            difference = compiled.vector_rad_s - plain.vector_rad_s
            assert np.abs(difference / np.array(plain.sigma_rad_s)).max() < 1e-4
            assert compiled.covariance_rad2_s2 == pytest.approx(plain.covariance_rad2_s2, rel=1e-3)
    assert measured >= 2


def test_derivatives_of_the_trail_agree_with_differences() -> None:
    """Every analytic derivative of the trail's light agrees with a finite difference."""
    rng = np.random.default_rng(24)
    ax, ay = rng.normal(0, 3, (2, 1, 40))
    trail, width2, step = np.array([[3.0, -1.5]]), 1.3, 1e-6
    _, slopes = trailed_gaussian(ax, ay, trail, width2)
    steps = [
        (trailed_gaussian(ax + step, ay, trail, width2), trailed_gaussian(ax - step, ay, trail, width2)),
        (trailed_gaussian(ax, ay + step, trail, width2), trailed_gaussian(ax, ay - step, trail, width2)),
        (
            trailed_gaussian(ax, ay, trail + np.array([[step, 0]]), width2),
            trailed_gaussian(ax, ay, trail - np.array([[step, 0]]), width2),
        ),
        (
            trailed_gaussian(ax, ay, trail + np.array([[0, step]]), width2),
            trailed_gaussian(ax, ay, trail - np.array([[0, step]]), width2),
        ),
        (trailed_gaussian(ax, ay, trail, width2 + step), trailed_gaussian(ax, ay, trail, width2 - step)),
    ]
    for k, (after, before) in enumerate(steps):
        assert np.allclose(slopes[..., k], (after[0] - before[0]) / (2 * step), atol=1e-8)


@pytest.mark.parametrize("columns", [0, 3])
def test_frames_without_measurable_trails_give_no_rate(columns: int) -> None:
    """A blank frame and a frame with a few bright columns give no rate."""
    profile = shipped_camera("cubestar")
    rng = np.random.default_rng(25)
    pixels = rng.normal(20, 2, (profile.camera.rows, profile.camera.columns))
    pixels[:, 100 : 100 + 40 * columns : 40] += 60
    frame = Rendered(np.clip(pixels, 0, 255).astype(np.uint8), rendered_frame(profile, np.zeros(3), rng).truth)
    assert measured_rate(profile, frame) is None
