"""Cameras calibrated from their own star frames against the cameras that took them."""

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

Night = Callable[..., list]
BROWN_MODELS = ("pinhole", "brown-2", "brown-4", "brown-5")
CENTRE = ("centre_col_px", "centre_row_px")


@pytest.mark.parametrize("name", [i.name for i in shipped_registry().all() if i.profile.chain])
def test_camera_is_recovered_from_rendered_frames(
    name: str, rendered: Callable, rough_camera: Callable, known: Callable[[str], CameraProfile]
) -> None:
    """From 30 rendered frames: the map from sky to pixels within a few hundredths of a pixel, the focal length within
    0.02 % if no lens term is degenerate with it; σ covers the errors, and the residual scatter is that of the
    centroids.
    """
    own = known(name)
    frames, errors = rendered(name)
    start = rough_camera(own.camera)
    if name == "sunsat":  # its centre is far from the middle: from the bench, a few pixels off
        start = replace(start, centre_col_px=own.camera.centre_col_px + 3, centre_row_px=own.camera.centre_row_px - 4)
    made = calibrate_camera(frames, start, focal_mm=own.focal_mm)
    off = camera_difference(made.camera, own.camera)
    assert off.rms_px < 0.05
    assert off.max_px < 0.2
    if name != "sunsat":
        focal = np.sqrt(own.camera.focal_col_px * own.camera.focal_row_px)
        assert made.parameter("focal_px").value == pytest.approx(focal, rel=2e-4)
    for axis in CENTRE:
        if axis in made.names and made.model != "radial-tilt":
            found = made.parameter(axis)
            assert abs(found.value - getattr(own.camera, axis)) < 4 * found.sigma + 0.02
    assert not any(f.excluded for f in made.frames)
    true = np.concatenate(errors)[made.stars.used]
    assert made.residuals.noise_px == pytest.approx(float(np.sqrt(np.mean(true**2))), rel=0.05)
    assert made.held_out is not None
    assert made.held_out.rms_px < 1.1 * made.residuals.noise_px
    assert made.before.rms_px > 2 * made.residuals.rms_px


@pytest.mark.parametrize("name", ["cubestar", "far_mst", "oersted"])
def test_wide_cameras_meet_the_target(
    name: str, night: Night, rough_camera: Callable, known: Callable[[str], CameraProfile]
) -> None:
    """30 frames with 0.1 px: focal length within 0.02 %, centre within 0.5 px, residuals within 5 % of the noise."""
    camera = known(name).camera
    made = calibrate_camera(night(camera, limit_mag=5.5, seed=4), rough_camera(camera), models=BROWN_MODELS)
    focal = np.sqrt(camera.focal_col_px * camera.focal_row_px)
    assert made.parameter("focal_px").value == pytest.approx(focal, rel=2e-4)
    assert abs(made.camera.centre_col_px - camera.centre_col_px) < 0.5
    assert abs(made.camera.centre_row_px - camera.centre_row_px) < 0.5
    assert made.residuals.noise_px == pytest.approx(0.1, rel=0.05)


def test_errors_agree_with_their_stated_sigma(night: Night, known: Callable[[str], CameraProfile]) -> None:
    """Over repeated nights the errors of every parameter scatter with its own σ, and the errors of attitude with theirs."""
    camera = known("far_mst").camera
    camera = replace(camera, distortion=Brown(-0.1, 0.02))
    focal = float(np.sqrt(camera.focal_col_px * camera.focal_row_px))
    truth = {"focal_px": focal, "aspect": 1.0, "centre_col_px": 639.5, "centre_row_px": 511.5, "k1": -0.1, "k2": 0.02}
    scaled = []
    for seed in range(12):
        made = calibrate_camera(night(camera, frames=10, seed=seed), camera, models=["brown-2"], folds=1)
        scaled += [(p.value - truth[p.name]) / p.sigma for p in made.parameters]
    assert 0.75 < np.sqrt(np.mean(np.square(scaled))) < 1.3


def test_covariance_matches_a_dense_solver(night: Night, known: Callable[[str], CameraProfile]) -> None:
    """Parameters and covariance agree with scipy's dense least squares over all unknowns at once."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    camera = replace(known("far_mst").camera, distortion=Brown(-0.05))
    frames = night(camera, frames=5, seed=3)
    made = calibrate_camera(frames, camera, models=["brown-2"], folds=1)
    start = [matrix_from_quaternion(f.quaternion) for f in made.frames]

    def misfit(p: np.ndarray) -> np.ndarray:
        focal, aspect, col, row, k1, k2 = p[:6]
        out = []
        for k, frame in enumerate(frames):
            turn = Rotation.from_rotvec(p[6 + 3 * k : 9 + 3 * k]).as_matrix() @ start[k]
            v = frame.icrs @ turn.T
            x, y = v[:, 0] / v[:, 2], v[:, 1] / v[:, 2]
            r2 = x * x + y * y
            radial = 1 + k1 * r2 + k2 * r2 * r2
            out.append((frame.pixels[:, 0] - col - focal * np.sqrt(aspect) * x * radial) / 0.1)
            out.append((frame.pixels[:, 1] - row - focal / np.sqrt(aspect) * y * radial) / 0.1)
        return np.concatenate(out)

    first = np.concatenate([[p.value for p in made.parameters], np.zeros(15)])
    dense = least_squares(misfit, first, x_scale=np.concatenate([[1, 1e-3, 1, 1, 1e-2, 1e-2], np.full(15, 1e-5)]))
    full = np.linalg.inv(dense.jac.T @ dense.jac)
    sigma = np.sqrt(np.diag(full)[:6])
    assert np.all(np.abs(dense.x[:6] - first[:6]) < 0.3 * sigma)
    ours = np.array([p.sigma for p in made.parameters])
    assert np.allclose(ours / sigma, ours[0] / sigma[0], rtol=0.02)
    assert 0.8 < ours[0] / sigma[0] < 1.2


def test_attitudes_are_returned(night: Night, rough_camera: Callable, known: Callable[[str], CameraProfile]) -> None:
    """Every frame has an attitude within a small multiple of its standard deviation of the true one."""
    camera = known("cubestar").camera
    frames = night(camera, frames=12, seed=6)
    made = calibrate_camera(frames, rough_camera(camera), models=["brown-4"])
    assert len(made.frames) == 12
    for fit, frame in zip(made.frames, frames, strict=True):
        turn = matrix_from_quaternion(fit.quaternion)
        ideal = camera.project(frame.icrs @ turn.T)
        assert np.sqrt(np.mean((ideal - frame.pixels) ** 2)) < 0.3
        assert np.all(np.sqrt(np.diag(fit.covariance_rad2)) < 1e-3)


def test_false_stars_have_no_effect(night: Night, known: Callable[[str], CameraProfile]) -> None:
    """One star in twenty at a wrong position has no effect and is counted as rejected."""
    camera = known("cubestar").camera
    rng = np.random.default_rng(2)
    spoilt, wrong = [], 0
    for frame in night(camera, seed=8, limit_mag=4.5):
        bad = rng.random(len(frame)) < 0.05
        wrong += int(bad.sum())
        spoilt.append(replace(frame, pixels=frame.pixels + bad[:, None] * rng.normal(0, 15, (len(frame), 2))))
    made = calibrate_camera(spoilt, camera, models=["brown-4"])
    assert camera_difference(made.camera, camera).rms_px < 0.05
    assert 0.85 * wrong <= made.residuals.rejected <= 1.3 * wrong + 3
    assert made.residuals.noise_px == pytest.approx(0.1, rel=0.06)


def test_criterion_selects_the_true_lens_model(
    night: Night, rough_camera: Callable, known: Callable[[str], CameraProfile]
) -> None:
    """Pinhole, two and four coefficients are each recognised, and the comparison states how much worse the others are."""
    bare = known("far_mst").camera
    for lens, name in (
        (Brown(), "pinhole"),
        (Brown(-0.2, 0.05), "brown-2"),
        (Brown(-0.2, 0.05, 2e-3, -3e-3), "brown-4"),
    ):
        frames = night(replace(bare, distortion=lens), seed=5)
        made = calibrate_camera(frames, rough_camera(bare), models=BROWN_MODELS, folds=2)
        assert made.model == name
        assert [m.model for m in made.comparison if m.chosen] == [name]
        assert min(m.bic for m in made.comparison) == 0
        outside = {m.model: m.held_out_px for m in made.comparison}
        assert outside[name] == pytest.approx(0.1, rel=0.08)
        if name != "pinhole":
            assert outside["pinhole"] > 2 * outside[name]


def test_tilt_and_polynomial_are_recovered_with_the_centre_from_the_bench(
    night: Night, known: Callable[[str], CameraProfile]
) -> None:
    """Jacobs' tilt within a tenth of a degree once the bench has said where the centre is."""
    own = known("sunsat")
    lens = own.camera.distortion
    assert isinstance(lens, RadialTilt)
    start = replace(own.camera, distortion=RadialTilt(25.0, 0.0, 0.0, (1e-3,)))
    bench = {n: Prior(getattr(own.camera, n) + 0.2, 0.5) for n in CENTRE}
    made = calibrate_camera(
        night(own.camera, limit_mag=7.0, seed=2), start, models=["radial-tilt"], focal_mm=25.0, priors=bench
    )
    found = made.camera.distortion
    assert isinstance(found, RadialTilt)
    assert np.degrees(found.tilt_max_rad) == pytest.approx(0.733, abs=0.1)
    assert np.degrees(found.tilt_direction_rad) == pytest.approx(np.degrees(lens.tilt_direction_rad), abs=8)
    assert found.radial[0] == 1e-3
    assert made.parameter("focal_px").value == pytest.approx(
        np.sqrt(own.camera.focal_col_px * own.camera.focal_row_px), rel=4e-4
    )
    assert camera_difference(made.camera, own.camera).rms_px < 0.03


def test_undetermined_parameters_are_held_and_named(
    night: Night, rough_camera: Callable, known: Callable[[str], CameraProfile]
) -> None:
    """Behind a long lens the centre is degenerate with attitude: it is held, with a reason and a warning."""
    camera = known("aim").camera
    made = calibrate_camera(night(camera, limit_mag=8.0, seed=1), rough_camera(camera))
    assert {f.name for f in made.frozen} >= set(CENTRE)
    assert all(f.reason for f in made.frozen)
    assert made.camera.centre_col_px == (camera.columns - 1) / 2
    assert "unsupported" in {w.code for w in made.warnings}
    assert camera_difference(made.camera, camera).rms_px < 0.05


def test_stars_in_one_part_are_a_warning(night: Night, known: Callable[[str], CameraProfile]) -> None:
    """Stars on the left half only."""
    camera = known("far_mst").camera
    half = [f.take(f.pixels[:, 0] < 640) for f in night(camera, seed=3)]
    made = calibrate_camera([f for f in half if len(f) > 3], camera, models=["brown-2"])
    assert {w.code for w in made.warnings} >= {"one-part"}


def test_residual_maps_show_the_lens_before_calibration_only(
    night: Night, rough_camera: Callable, known: Callable[[str], CameraProfile]
) -> None:
    """Residuals are pixels before and within a few hundredths of a pixel after calibration."""
    camera = known("cubestar").camera
    made = calibrate_camera(night(camera, limit_mag=5.0), rough_camera(camera), models=["brown-4"])
    before, after = made.before_map, made.after_map
    assert before.mean_px.shape == (6, 12, 2)
    assert after.count.sum() == made.residuals.stars
    assert np.nanmax(np.abs(before.mean_px)) > 3
    full = after.count >= 5
    assert np.abs(after.mean_px[full]).max() < 0.3
    assert np.sqrt(np.mean(after.mean_px[full] ** 2 * after.count[full][:, None])) == pytest.approx(0.1, rel=0.3)


def test_a_lens_model_worse_than_the_previous_camera_is_reported(
    night: Night, known: Callable[[str], CameraProfile]
) -> None:
    """A camera with known distortion calibrated without it: the result states which of the two to keep."""
    camera = replace(known("far_mst").camera, distortion=Brown(-0.1, 0.02))
    frames = night(camera, frames=10, seed=6)
    codes = {
        model: {said.code for said in calibrate_camera(frames, camera, models=[model], folds=1).warnings}
        for model in ("pinhole", "brown-2")
    }
    assert "worse" in codes["pinhole"]
    assert "worse" not in codes["brown-2"]


def test_the_same_frames_give_the_same_camera(night: Night, known: Callable[[str], CameraProfile]) -> None:
    """The result is deterministic, and the order of the frames changes it by less than a thousandth of σ."""
    camera = known("oersted").camera
    frames = night(camera, frames=10)
    one, two = (calibrate_camera(f, camera, models=["brown-2"]) for f in (frames, frames))
    other = calibrate_camera(frames[::-1], camera, models=["brown-2"])
    assert [p.value for p in one.parameters] == [p.value for p in two.parameters]
    for p in one.parameters:
        assert abs(other.parameter(p.name).value - p.value) < 0.01 * p.sigma


def test_calibration_goes_into_a_profile(night: Night, known: Callable[[str], CameraProfile]) -> None:
    """The profile has the new camera; a calibration of another detector is refused."""
    own = known("cubestar")
    made = calibrate_camera(night(own.camera, frames=8), own.camera, models=["brown-4"])
    profile = calibrated_profile(own, made)
    assert profile.camera == made.camera
    assert profile.sensor == own.sensor
    with pytest.raises(BadInput, match="another detector"):
        calibrated_profile(known("aim"), made)
    with pytest.raises(NotFound):
        made.parameter("k9")


def test_attitudes_differ_as_the_cameras_predict(known: Callable[[str], CameraProfile]) -> None:
    """A moved centre is, for attitude, a rotation; the rest is small."""
    camera = known("far_mst").camera
    moved = replace(camera, centre_col_px=camera.centre_col_px + 2)
    off = camera_difference(camera, moved)
    assert abs(off.rotation_rad[1]) == pytest.approx(2 * camera.pixel_rad, rel=0.1)
    assert 0.01 < off.rms_px < 0.2
    assert camera_difference(camera, camera).max_px < 1e-9
    cross, _ = pointing_difference_rad(np.eye(3), np.eye(3))
    assert cross == 0
    with pytest.raises(BadInput):
        camera_difference(camera, Camera.from_fov(10, 10, 0.1))
