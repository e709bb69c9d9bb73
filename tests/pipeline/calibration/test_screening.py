"""Frames with faults: each fault is detected and named, and the faulty frames or stars are excluded where possible."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.pipeline.calibration.apply import camera_difference
from gss.pipeline.calibration.bundle import Prior
from gss.pipeline.calibration.result import CameraCalibration
from gss.pipeline.calibration.screening import is_mirrored, plate_scale, screen
from gss.pipeline.calibration.self_calibrate import calibrate_camera
from gss.pipeline.calibration.sightings import FrameStars

ProfileOf = Callable[[str], CameraProfile]
StarFrames = Callable[..., list[FrameStars]]


def _codes(calibration: CameraCalibration) -> set[str]:
    return {w.code for w in calibration.warnings}


def _excluded(calibration: CameraCalibration) -> dict[str, str]:
    return {f.name: f.excluded for f in calibration.frames if f.excluded}


def _mirrored(frame: FrameStars) -> FrameStars:
    return replace(frame, pixels=frame.pixels * [-1, 1] + [frame.columns - 1, 0])


def _with_light(frame: FrameStars, zero: float, loss_mag: float = 0.0) -> FrameStars:
    return replace(frame, flux_dn=10 ** (0.4 * (zero - loss_mag - frame.v_mag)), peak_dn=np.ones(len(frame)))


def test_a_good_night_has_no_warning(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Frames without faults give no warning."""
    camera = profile_of("cubestar").camera
    calibration = calibrate_camera(
        [_with_light(f, 20.0) for f in star_frames(camera, limit_mag=5.0)], camera, models=["brown-4"]
    )
    assert calibration.warnings == ()
    assert not _excluded(calibration)


def test_too_few_stars_are_rejected_with_advice(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """With fewer equations than unknowns, the error states the expected number, the actual number and advice."""
    camera = profile_of("cubestar").camera
    frames = [f.take(np.arange(2)) for f in star_frames(camera, frames=6)]
    with pytest.raises(BadInput) as error:
        calibrate_camera(frames, camera)
    assert error.value.expected
    assert "0 in 0 of 6 frames" in error.value.got
    assert error.value.hint
    with pytest.raises(BadInput):
        calibrate_camera([], camera)


def test_undetermined_parameters_are_not_fitted(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Two frames of five stars give warnings, at least one of them severe, and some parameters are not fitted."""
    camera = profile_of("cubestar").camera
    calibration = calibrate_camera([f.take(np.arange(5)) for f in star_frames(camera, frames=2)], camera)
    assert {"few-stars", "few-frames"} <= _codes(calibration)
    assert any(w.severe for w in calibration.warnings)
    assert len(calibration.parameters) < 10


def test_stars_in_one_part_of_the_field_are_reported(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """If all stars are in one corner, a severe warning states the share of the field."""
    camera = profile_of("far_mst").camera
    corner = [f.take((f.pixels < [640, 500]).all(axis=1)) for f in star_frames(camera, limit_mag=6.0)]
    calibration = calibrate_camera(corner, camera)
    warning = next(w for w in calibration.warnings if w.code == "one-part")
    assert warning.severe
    assert "%" in warning.text


def test_wrong_plate_scale_is_reported_and_corrected(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """A focal length wrong by 8 % is reported, and the correct one is fitted."""
    camera = profile_of("far_mst").camera
    calibration = calibrate_camera(star_frames(camera), camera.with_focal_scaled(1 / 1.08))
    warning = next(w for w in calibration.warnings if w.code == "plate-scale")
    assert "1.0800" in warning.text
    assert camera_difference(calibration.camera, camera).rms_px < 0.05
    scale, _ = plate_scale(star_frames(camera)[0], camera.with_focal_scaled(0.5))
    assert scale == pytest.approx(2, rel=0.005)


def test_frames_with_trails_are_excluded(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Exposures with trailed stars are excluded. If all exposures are trailed, they are used with a severe warning."""
    camera = profile_of("cubestar").camera
    frames = star_frames(camera, frames=12)
    some_trailed = [replace(f, streak_px=9.0) if k < 3 else f for k, f in enumerate(frames)]
    calibration = calibrate_camera(some_trailed, camera, models=["brown-4"])
    assert "streaks" in _codes(calibration)
    assert list(_excluded(calibration)) == ["frame 0", "frame 1", "frame 2"]
    all_trailed = calibrate_camera([replace(f, streak_px=9.0) for f in frames], camera, models=["brown-4"])
    assert next(w for w in all_trailed.warnings if w.code == "streaks").severe


def test_mirrored_frames_are_recognised(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """One mirrored frame among others is excluded. If all are mirrored, the calibration is rejected."""
    camera = profile_of("oersted").camera
    frames = star_frames(camera, frames=10)
    assert not any(is_mirrored(f, camera) for f in frames)
    one_mirrored = [_mirrored(frames[0]), *frames[1:]]
    calibration = calibrate_camera(one_mirrored, camera)
    assert _excluded(calibration) == {"frame 0": "mirrored"}
    assert "mirrored" in _codes(calibration)
    with pytest.raises(BadInput, match="are not sufficient") as error:
        calibrate_camera([_mirrored(f) for f in frames], camera)
    assert "right way round" in error.value.hint


def test_frames_of_another_lens_are_excluded(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Four frames with another focal length are excluded and do not affect the camera of the other sixteen."""
    camera = profile_of("far_mst").camera
    mixed = star_frames(camera, frames=16) + [
        replace(f, name=f"other {k}")
        for k, f in enumerate(star_frames(camera.with_focal_scaled(1.1), frames=4, seed=7))
    ]
    calibration = calibrate_camera(mixed, camera)
    assert "mixed-cameras" in _codes(calibration)
    assert sorted(_excluded(calibration)) == [f"other {k}" for k in range(4)]
    assert camera_difference(calibration.camera, camera).rms_px < 0.05


def test_a_slightly_different_camera_is_detected_by_residuals(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Frames whose focal length is 0.4 % longer, too little for the plate-scale check, are detected by their residuals
    and excluded.
    """
    camera = profile_of("far_mst").camera
    mixed = star_frames(camera, frames=16) + [
        replace(f, name=f"other {k}")
        for k, f in enumerate(star_frames(camera.with_focal_scaled(1.004), frames=2, seed=7))
    ]
    calibration = calibrate_camera(mixed, camera, models=["pinhole"])
    assert sorted(_excluded(calibration)) == ["other 0", "other 1"]
    assert camera_difference(calibration.camera, camera).rms_px < 0.05


def test_frames_of_another_size_are_excluded(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """A binned frame among the others is excluded, and the reason states its size."""
    camera = profile_of("oersted").camera
    frames = star_frames(camera, frames=8)
    small = replace(frames[0], name="binned", columns=302, rows=288, pixels=frames[0].pixels / 2)
    calibration = calibrate_camera([*frames, small], camera)
    assert "mixed-sizes" in _codes(calibration)
    assert "302 x 288" in _excluded(calibration)["binned"]


def test_clouds_are_reported(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """A loss of one magnitude and a loss of most stars are each reported as clouds."""
    camera = profile_of("cubestar").camera
    frames = [_with_light(f, 20.0) for f in star_frames(camera, frames=12, limit_mag=5.0)]
    dim = [_with_light(f, 20.0, 1.0) if k == 4 else f for k, f in enumerate(frames)]
    assert "frame 4" in next(w for w in screen(dim, camera).warnings if w.code == "clouds").text
    few_stars = [f.take(np.arange(4)) if k in (2, 7, 9) else f for k, f in enumerate(frames)]
    assert "clouds" in {w.code for w in screen(few_stars, camera).warnings}
    assert "clouds" not in {w.code for w in screen(frames, camera).warnings}


def test_clipped_stars_are_excluded(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Saturated stars are excluded, with a warning if there are many."""
    camera = profile_of("cubestar").camera
    rng = np.random.default_rng(1)
    frames = []
    for f in star_frames(camera, limit_mag=5.0):
        bright = rng.random(len(f)) < 0.3
        shifted_px = f.pixels + bright[:, None] * rng.normal(0, 1.0, (len(f), 2))
        frames.append(replace(f, pixels=shifted_px, peak_dn=np.where(bright, 255.0, 100.0), saturation_dn=255.0))
    calibration = calibrate_camera(frames, camera, models=["brown-4"])
    assert "saturated" in _codes(calibration)
    assert calibration.residuals.noise_px == pytest.approx(0.1, rel=0.06)


def test_invalid_positions_are_rejected(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """NaN, zero errors and arrays of unequal length are rejected."""
    frame = star_frames(profile_of("oersted").camera, frames=1)[0]
    with pytest.raises(BadInput, match="invalid positions"):
        replace(frame, pixels=frame.pixels * np.nan)
    with pytest.raises(BadInput, match="invalid positions"):
        replace(frame, sigma_px=frame.sigma_px * 0)
    with pytest.raises(BadInput, match="wrong shape"):
        replace(frame, v_mag=frame.v_mag[1:])


def test_unknown_models_are_rejected(star_frames: StarFrames, profile_of: ProfileOf) -> None:
    """Unknown lens models and invalid priors are rejected. Models in millimetres need a focal length."""
    camera: Camera = profile_of("oersted").camera
    frames = star_frames(camera, frames=6)
    with pytest.raises(BadInput, match="unknown lens model"):
        calibrate_camera(frames, camera, models=["fisheye"])
    with pytest.raises(BadInput, match="millimetres"):
        calibrate_camera(frames, camera, models=["radial-tilt"])
    with pytest.raises(BadInput, match="invalid prior"):
        calibrate_camera(frames, camera, priors={"centre_px": Prior(1.0, 1.0)})
    with pytest.raises(BadInput, match="invalid prior"):
        calibrate_camera(frames, camera, priors={"centre_col_px": Prior(300.0, 0.0)})
    assert "radial-tilt" not in {m.model for m in calibrate_camera(frames, camera).comparison}
