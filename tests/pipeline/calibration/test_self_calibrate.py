"""Cameras calibrated from their own star frames, compared with the cameras that took them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Brown, Camera, RadialTilt
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import pointing_difference_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.registry import shipped_registry
from gss.pipeline.calibration.apply import calibrated_profile, camera_difference
from gss.pipeline.calibration.bundle import Prior
from gss.pipeline.calibration.self_calibrate import calibrate_camera

StarFrames = Callable[..., list]
BROWN_MODELS = ("pinhole", "brown-2", "brown-4", "brown-5")
CENTRE = ("centre_col_px", "centre_row_px")


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_camera_is_recovered_from_rendered_frames(
    name: str, rendered: Callable, rough_camera: Callable, profile_of: Callable[[str], CameraProfile]
) -> None:
    """30 rendered frames give the projection within 0.05 px rms, and the focal length within 0.02 % unless a lens term
    is degenerate with it. The centre is found within its stated σ, and the residual scatter is that of the centroids.
    """
    profile = profile_of(name)
    frames, errors = rendered(name)
    start = rough_camera(profile.camera)
    # Sunsat's optical centre is far from the middle of the detector, so the start is a bench value with an error.
    if name == "sunsat":
        start = replace(
            start, centre_col_px=profile.camera.centre_col_px + 3, centre_row_px=profile.camera.centre_row_px - 4
        )
    calibration = calibrate_camera(frames, start, focal_mm=profile.focal_mm)
    difference = camera_difference(calibration.camera, profile.camera)
    assert difference.rms_px < 0.05
    assert difference.max_px < 0.2
    if name != "sunsat":
        focal = np.sqrt(profile.camera.focal_col_px * profile.camera.focal_row_px)
        assert calibration.parameter("focal_px").value == pytest.approx(focal, rel=2e-4)
    for axis in CENTRE:
        if axis in calibration.names and calibration.model != "radial-tilt":
            centre = calibration.parameter(axis)
            assert abs(centre.value - getattr(profile.camera, axis)) < 4 * centre.sigma + 0.02
    assert not any(f.excluded for f in calibration.frames)
    true_errors = np.concatenate(errors)[calibration.stars.used]
    assert calibration.residuals.noise_px == pytest.approx(float(np.sqrt(np.mean(true_errors**2))), rel=0.05)
    assert calibration.held_out is not None
    assert calibration.held_out.rms_px < 1.1 * calibration.residuals.noise_px
    assert calibration.before.rms_px > 2 * calibration.residuals.rms_px


@pytest.mark.parametrize("name", ["cubestar", "far_mst", "oersted"])
def test_wide_cameras_meet_the_target(
    name: str, star_frames: StarFrames, rough_camera: Callable, profile_of: Callable[[str], CameraProfile]
) -> None:
    """From 30 frames with errors of 0.1 px, the focal length is found within 0.02 %, the centre within 0.5 px, and the
    noise within 5 %.
    """
    camera = profile_of(name).camera
    calibration = calibrate_camera(
        star_frames(camera, limit_mag=5.5, seed=4), rough_camera(camera), models=BROWN_MODELS
    )
    focal = np.sqrt(camera.focal_col_px * camera.focal_row_px)
    assert calibration.parameter("focal_px").value == pytest.approx(focal, rel=2e-4)
    assert abs(calibration.camera.centre_col_px - camera.centre_col_px) < 0.5
    assert abs(calibration.camera.centre_row_px - camera.centre_row_px) < 0.5
    assert calibration.residuals.noise_px == pytest.approx(0.1, rel=0.05)


def test_parameter_errors_agree_with_their_stated_sigma(
    star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]
) -> None:
    """Over repeated sets of frames, the errors of all parameters scatter with their stated σ."""
    camera = profile_of("far_mst").camera
    camera = replace(camera, distortion=Brown(-0.1, 0.02))
    focal = float(np.sqrt(camera.focal_col_px * camera.focal_row_px))
    truth = {"focal_px": focal, "aspect": 1.0, "centre_col_px": 639.5, "centre_row_px": 511.5, "k1": -0.1, "k2": 0.02}
    scaled = []
    for seed in range(12):
        calibration = calibrate_camera(star_frames(camera, frames=10, seed=seed), camera, models=["brown-2"], folds=1)
        scaled += [(p.value - truth[p.name]) / p.sigma for p in calibration.parameters]
    assert 0.75 < np.sqrt(np.mean(np.square(scaled))) < 1.3


def test_covariance_matches_a_dense_solver(star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]) -> None:
    """Parameters and covariance agree with scipy's dense least squares over all unknowns."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    camera = replace(profile_of("far_mst").camera, distortion=Brown(-0.05))
    frames = star_frames(camera, frames=5, seed=3)
    calibration = calibrate_camera(frames, camera, models=["brown-2"], folds=1)
    start = [matrix_from_quaternion(f.quaternion) for f in calibration.frames]

    def misfit(p: np.ndarray) -> np.ndarray:
        focal, aspect, col, row, k1, k2 = p[:6]
        residuals = []
        for k, frame in enumerate(frames):
            rotation = Rotation.from_rotvec(p[6 + 3 * k : 9 + 3 * k]).as_matrix() @ start[k]
            v = frame.icrs @ rotation.T
            x, y = v[:, 0] / v[:, 2], v[:, 1] / v[:, 2]
            r2 = x * x + y * y
            radial = 1 + k1 * r2 + k2 * r2 * r2
            residuals.append((frame.pixels[:, 0] - col - focal * np.sqrt(aspect) * x * radial) / 0.1)
            residuals.append((frame.pixels[:, 1] - row - focal / np.sqrt(aspect) * y * radial) / 0.1)
        return np.concatenate(residuals)

    first = np.concatenate([[p.value for p in calibration.parameters], np.zeros(15)])
    dense = least_squares(misfit, first, x_scale=np.concatenate([[1, 1e-3, 1, 1, 1e-2, 1e-2], np.full(15, 1e-5)]))
    covariance = np.linalg.inv(dense.jac.T @ dense.jac)
    sigma = np.sqrt(np.diag(covariance)[:6])
    assert np.all(np.abs(dense.x[:6] - first[:6]) < 0.3 * sigma)
    stated_sigma = np.array([p.sigma for p in calibration.parameters])
    assert np.allclose(stated_sigma / sigma, stated_sigma[0] / sigma[0], rtol=0.02)
    assert 0.8 < stated_sigma[0] / sigma[0] < 1.2


def test_an_attitude_is_returned_for_every_frame(
    star_frames: StarFrames, rough_camera: Callable, profile_of: Callable[[str], CameraProfile]
) -> None:
    """Every frame has an attitude that projects its stars within 0.3 px rms, with a σ below 1 mrad."""
    camera = profile_of("cubestar").camera
    frames = star_frames(camera, frames=12, seed=6)
    calibration = calibrate_camera(frames, rough_camera(camera), models=["brown-4"])
    assert len(calibration.frames) == 12
    for fit, frame in zip(calibration.frames, frames, strict=True):
        attitude = matrix_from_quaternion(fit.quaternion)
        projected = camera.project(frame.icrs @ attitude.T)
        assert np.sqrt(np.mean((projected - frame.pixels) ** 2)) < 0.3
        assert np.all(np.sqrt(np.diag(fit.covariance_rad2)) < 1e-3)


def test_false_stars_have_no_effect(star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]) -> None:
    """One star in twenty at a wrong position does not affect the camera and is counted as rejected."""
    camera = profile_of("cubestar").camera
    rng = np.random.default_rng(2)
    frames, false_stars = [], 0
    for frame in star_frames(camera, seed=8, limit_mag=4.5):
        is_false = rng.random(len(frame)) < 0.05
        false_stars += int(is_false.sum())
        frames.append(replace(frame, pixels=frame.pixels + is_false[:, None] * rng.normal(0, 15, (len(frame), 2))))
    calibration = calibrate_camera(frames, camera, models=["brown-4"])
    assert camera_difference(calibration.camera, camera).rms_px < 0.05
    assert 0.85 * false_stars <= calibration.residuals.rejected <= 1.3 * false_stars + 3
    assert calibration.residuals.noise_px == pytest.approx(0.1, rel=0.06)


def test_criterion_selects_the_true_lens_model(
    star_frames: StarFrames, rough_camera: Callable, profile_of: Callable[[str], CameraProfile]
) -> None:
    """Each of the pinhole, two-coefficient and four-coefficient models is selected when it is the true one, and the
    comparison shows how much worse the others are.
    """
    camera = profile_of("far_mst").camera
    for lens, name in (
        (Brown(), "pinhole"),
        (Brown(-0.2, 0.05), "brown-2"),
        (Brown(-0.2, 0.05, 2e-3, -3e-3), "brown-4"),
    ):
        frames = star_frames(replace(camera, distortion=lens), seed=5)
        calibration = calibrate_camera(frames, rough_camera(camera), models=BROWN_MODELS, folds=2)
        assert calibration.model == name
        assert [m.model for m in calibration.comparison if m.chosen] == [name]
        assert min(m.bic for m in calibration.comparison) == 0
        held_out_px = {m.model: m.held_out_px for m in calibration.comparison}
        assert held_out_px[name] == pytest.approx(0.1, rel=0.08)
        if name != "pinhole":
            assert held_out_px["pinhole"] > 2 * held_out_px[name]


def test_tilt_and_polynomial_are_recovered_with_the_centre_from_the_bench(
    star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]
) -> None:
    """Jacobs' tilt is found within 0.1° if the centre is known from the bench."""
    profile = profile_of("sunsat")
    lens = profile.camera.distortion
    assert isinstance(lens, RadialTilt)
    start = replace(profile.camera, distortion=RadialTilt(25.0, 0.0, 0.0, (1e-3,)))
    bench = {n: Prior(getattr(profile.camera, n) + 0.2, 0.5) for n in CENTRE}
    calibration = calibrate_camera(
        star_frames(profile.camera, limit_mag=7.0, seed=2), start, models=["radial-tilt"], focal_mm=25.0, priors=bench
    )
    tilt = calibration.camera.distortion
    assert isinstance(tilt, RadialTilt)
    assert np.degrees(tilt.tilt_max_rad) == pytest.approx(0.733, abs=0.1)
    assert np.degrees(tilt.tilt_direction_rad) == pytest.approx(np.degrees(lens.tilt_direction_rad), abs=8)
    assert tilt.radial[0] == 1e-3
    assert calibration.parameter("focal_px").value == pytest.approx(
        np.sqrt(profile.camera.focal_col_px * profile.camera.focal_row_px), rel=4e-4
    )
    assert camera_difference(calibration.camera, profile.camera).rms_px < 0.03


def test_undetermined_parameters_are_held_and_named(
    star_frames: StarFrames, rough_camera: Callable, profile_of: Callable[[str], CameraProfile]
) -> None:
    """With a long lens, the centre is degenerate with the attitude. It is held fixed, with a reason and a warning."""
    camera = profile_of("aim").camera
    calibration = calibrate_camera(star_frames(camera, limit_mag=8.0, seed=1), rough_camera(camera))
    assert {f.name for f in calibration.frozen} >= set(CENTRE)
    assert all(f.reason for f in calibration.frozen)
    assert calibration.camera.centre_col_px == (camera.columns - 1) / 2
    assert "unsupported" in {w.code for w in calibration.warnings}
    assert camera_difference(calibration.camera, camera).rms_px < 0.05


def test_stars_in_half_of_the_field_give_a_warning(
    star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]
) -> None:
    """If all stars are in the left half of the field, a warning states it."""
    camera = profile_of("far_mst").camera
    half = [f.take(f.pixels[:, 0] < 640) for f in star_frames(camera, seed=3)]
    calibration = calibrate_camera([f for f in half if len(f) > 3], camera, models=["brown-2"])
    assert {w.code for w in calibration.warnings} >= {"one-part"}


def test_residual_maps_show_the_distortion_only_before_calibration(
    star_frames: StarFrames, rough_camera: Callable, profile_of: Callable[[str], CameraProfile]
) -> None:
    """Mean residuals exceed 3 px before calibration. Afterwards they are those of the noise of 0.1 px."""
    camera = profile_of("cubestar").camera
    calibration = calibrate_camera(star_frames(camera, limit_mag=5.0), rough_camera(camera), models=["brown-4"])
    before, after = calibration.before_map, calibration.after_map
    assert before.mean_px.shape == (6, 12, 2)
    assert after.count.sum() == calibration.residuals.stars
    assert np.nanmax(np.abs(before.mean_px)) > 3
    full = after.count >= 5
    assert np.abs(after.mean_px[full]).max() < 0.3
    assert np.sqrt(np.mean(after.mean_px[full] ** 2 * after.count[full][:, None])) == pytest.approx(0.1, rel=0.3)


def test_a_lens_model_worse_than_the_previous_camera_is_reported(
    star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]
) -> None:
    """If a camera with known distortion is calibrated with a pinhole model, a warning states that the result is worse
    than the previous camera.
    """
    camera = replace(profile_of("far_mst").camera, distortion=Brown(-0.1, 0.02))
    frames = star_frames(camera, frames=10, seed=6)
    codes = {
        model: {warning.code for warning in calibrate_camera(frames, camera, models=[model], folds=1).warnings}
        for model in ("pinhole", "brown-2")
    }
    assert "worse" in codes["pinhole"]
    assert "worse" not in codes["brown-2"]


def test_the_same_frames_give_the_same_camera(
    star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]
) -> None:
    """The result is deterministic, and the order of the frames changes it by less than a hundredth of σ."""
    camera = profile_of("oersted").camera
    frames = star_frames(camera, frames=10)
    first, second = (calibrate_camera(f, camera, models=["brown-2"]) for f in (frames, frames))
    reversed_order = calibrate_camera(frames[::-1], camera, models=["brown-2"])
    assert [p.value for p in first.parameters] == [p.value for p in second.parameters]
    for p in first.parameters:
        assert abs(reversed_order.parameter(p.name).value - p.value) < 0.01 * p.sigma


def test_calibration_is_applied_to_a_profile(
    star_frames: StarFrames, profile_of: Callable[[str], CameraProfile]
) -> None:
    """The calibrated profile has the new camera. A calibration of another detector is rejected."""
    shipped = profile_of("cubestar")
    calibration = calibrate_camera(star_frames(shipped.camera, frames=8), shipped.camera, models=["brown-4"])
    calibrated = calibrated_profile(shipped, calibration)
    assert calibrated.camera == calibration.camera
    assert calibrated.sensor == shipped.sensor
    with pytest.raises(BadInput, match="another detector"):
        calibrated_profile(profile_of("aim"), calibration)
    with pytest.raises(NotFound):
        calibration.parameter("k9")


def test_a_displaced_centre_is_equivalent_to_a_rotation(profile_of: Callable[[str], CameraProfile]) -> None:
    """A camera with a displaced centre gives attitudes rotated by the same angle. The difference that remains after
    this rotation is small.
    """
    camera = profile_of("far_mst").camera
    moved = replace(camera, centre_col_px=camera.centre_col_px + 2)
    difference = camera_difference(camera, moved)
    assert abs(difference.rotation_rad[1]) == pytest.approx(2 * camera.pixel_rad, rel=0.1)
    assert 0.01 < difference.rms_px < 0.2
    assert camera_difference(camera, camera).max_px < 1e-9
    cross, _ = pointing_difference_rad(np.eye(3), np.eye(3))
    assert cross == 0
    with pytest.raises(BadInput):
        camera_difference(camera, Camera.from_fov(10, 10, 0.1))
