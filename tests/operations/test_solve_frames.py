"""Solving of rendered frames: results are correct, or absent with a reason, and never wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.domain.results import Outcome, Verdict
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solve import Solver, SolveRequest
from gss.pipeline.identify.near import BoundedPrior
from gss.pipeline.render import FalseStar, HotPixel, Rendered, render
from gss.pipeline.score import assess

SOLVER = Solver(shipped_camera, epoch_jyear=2025.0)
STARS = SOLVER.cache.stars(2025.0)
ORION = cam_from_icrs(1.4, 0.0, 1.0)


def shot(name: str, rotation: Array, seed: int = 1, **options: object) -> Rendered:
    p = shipped_camera(name)
    stars = STARS.brighter_than(p.sensor.faint_limit_mag + 1)
    rng = np.random.default_rng(seed)
    return render(stars, p.camera, p.sensor, rotation, p.sensor.exposure_s, rng, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_rendered_frames_are_solved_correctly(name: str) -> None:
    """Of thirty random frames at least 27 are correct, at most two have no solution, and none is wrong."""
    rng = np.random.default_rng(3)
    verdicts = []
    for seed in range(30):
        frame = shot(name, matrix_from_quaternion(random_quaternion(rng)), seed)
        result = SOLVER.solve(frame.pixels, SolveRequest(profile=name))
        verdicts.append(assess(result, frame.truth, shipped_camera(name).camera).verdict)
    assert Verdict.WRONG not in verdicts
    assert sum(v is Verdict.CORRECT for v in verdicts) >= 27
    assert sum(v is Verdict.NONE for v in verdicts) <= 2


def test_result_has_every_field() -> None:
    """A solution has quaternion, covariance, residuals, probability, regions and epoch, but no measured times."""
    result = SOLVER.solve(shot("cubestar", ORION).pixels, SolveRequest(profile="cubestar"))
    assert result.outcome is Outcome.SOLVED
    assert result.attitude is not None
    assert result.matches is not None
    assert np.isfinite(result.attitude.covariance_rad2).all()
    assert (np.linalg.eigvalsh(result.attitude.covariance_rad2) > 0).all()
    assert result.residual_rms_px < 0.5
    assert 0 < result.false_match_probability < 1e-6
    assert len(result.regions) >= len(result.centroids)
    assert any("2025" in note for note in result.notes)
    assert set(result.timing_s) == set()


def test_the_same_frame_gives_the_same_result() -> None:
    """Two solvers give bit-identical quaternions for one frame."""
    frame = shot("sunsat", ORION)
    a = SOLVER.solve(frame.pixels, SolveRequest(profile="sunsat"))
    b = Solver(shipped_camera, epoch_jyear=2025.0).solve(frame.pixels, SolveRequest(profile="sunsat"))
    assert a.attitude is not None
    assert b.attitude is not None
    assert (a.attitude.quaternion == b.attitude.quaternion).all()


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
def test_mirrored_frames_are_reported(name: str) -> None:
    """A mirrored frame has no solution, with a known or unknown camera, and the reason states this."""
    frame = shot(name, ORION).pixels[:, ::-1]
    for request in (SolveRequest(profile=name), SolveRequest(fov_rad=shipped_camera(name).camera.fov_rad[0])):
        result = SOLVER.solve(frame, request)
        assert result.outcome is Outcome.NONE
        assert "mirrored" in result.reason


def test_frame_of_another_camera_is_not_solved() -> None:
    """A frame taken with a focal length 10 % longer than stated has no solution."""
    p = shipped_camera("cubestar")
    longer = p.camera.with_focal_scaled(1.1)
    rng = np.random.default_rng(5)
    frame = render(STARS.brighter_than(4), longer, p.sensor, ORION, p.sensor.exposure_s, rng)
    result = SOLVER.solve(frame.pixels, SolveRequest(profile="cubestar"))
    assert result.outcome is Outcome.NONE
    assert "camera" in result.reason


@pytest.mark.parametrize("stars", [0, 1, 2, 3])
def test_too_few_stars_have_no_solution(stars: int) -> None:
    """Frames of zero to three stars give a reason with their number."""
    p = shipped_camera("cubestar")
    bright = STARS.brighter_than(3.5)
    inside = p.camera.contains(p.camera.project(bright.icrs @ ORION.T), 40)
    few = bright.take(np.flatnonzero(inside & (bright.v_mag > 1.5))[:stars])
    frame = render(few, p.camera, p.sensor, ORION, p.sensor.exposure_s, np.random.default_rng(6))
    result = SOLVER.solve(frame.pixels, SolveRequest(profile="cubestar"))
    assert result.outcome is Outcome.NONE
    assert result.reason.startswith(f"{stars} star")


@pytest.mark.parametrize("kind", ["black", "white", "noise", "all values", "salt", "ramp"])
@pytest.mark.parametrize(
    "request_", [SolveRequest(profile="cubestar"), SolveRequest(blind=True)], ids=["known", "blind"]
)
def test_frames_without_sky_have_no_solution(kind: str, request_: SolveRequest) -> None:
    """Blank, saturated, noisy, salted and ramped frames give no attitude and a reason."""
    rng = np.random.default_rng(7)
    shape = (512, 1024)
    salt = np.full(shape, 20)
    salt[rng.integers(0, 512, 3000), rng.integers(0, 1024, 3000)] = 255
    frames = {
        "black": np.zeros(shape),
        "white": np.full(shape, 255),
        "noise": rng.normal(30, 5, shape),
        "all values": rng.integers(0, 256, shape),
        "salt": salt,
        "ramp": np.linspace(0, 200, 1024)[None] + rng.normal(0, 3, shape),
    }
    result = SOLVER.solve(frames[kind].clip(0, 255).astype(np.uint8), request_)
    assert result.outcome is Outcome.NONE
    assert result.reason


@pytest.mark.parametrize("name", ["cubestar", "sunsat"])
@pytest.mark.parametrize("false", [10, 100])
def test_false_stars_and_hot_pixels_do_not_prevent_a_solution(name: str, false: int) -> None:
    """A rich field is solved with ten or a hundred false stars and five hundred hot pixels."""
    p = shipped_camera(name)
    c, s = p.camera, p.sensor
    rng = np.random.default_rng(false)
    limit = s.faint_limit_mag
    spots = [
        FalseStar(rng.uniform(0, c.columns), rng.uniform(0, c.rows), rng.uniform(limit - 3, limit))
        for _ in range(false)
    ]
    hot = [
        HotPixel(
            int(rng.integers(c.columns)),
            int(rng.integers(c.rows)),
            rng.uniform(20, 200) * s.gain_e_per_dn / s.exposure_s,
        )
        for _ in range(500)
    ]
    frame = shot(name, ORION, false_stars=spots, hot_pixels=hot)
    result = SOLVER.solve(frame.pixels, SolveRequest(profile=name))
    assert assess(result, frame.truth, c).verdict in (Verdict.CORRECT, Verdict.IMPRECISE)


def test_a_hint_is_used_and_a_wrong_one_tolerated() -> None:
    """With a hint that is wrong by half a degree the frame is solved near it. A hint elsewhere in the sky is ignored with a
    note, and the frame is solved."""
    frame = shot("sunsat", ORION)
    near = BoundedPrior(rotation_from_vector(np.array([0.005, -0.005, 0.004])) @ ORION, 0.012)
    good = SOLVER.solve(frame.pixels, SolveRequest(profile="sunsat", hint=near))
    assert assess(good, frame.truth, shipped_camera("sunsat").camera).verdict is Verdict.CORRECT
    assert not any("hint" in note for note in good.notes)
    far = BoundedPrior(cam_from_icrs(4.5, 0.5, 0.0), 0.012)
    other = SOLVER.solve(frame.pixels, SolveRequest(profile="sunsat", hint=far))
    assert assess(other, frame.truth, shipped_camera("sunsat").camera).verdict is Verdict.CORRECT
    assert any("hint" in note for note in other.notes)


def test_non_square_pixels_are_solved_by_geometry() -> None:
    """A camera given by its geometry alone, with pixels 20 % longer than wide, is solved."""
    p = shipped_camera("cubestar")
    tall = Camera(1024, 512, 1200.0, 1000.0, 511.5, 255.5)
    sensor = replace(p.sensor, psf_sigma_px=1.1)
    frame = render(STARS.brighter_than(4.5), tall, sensor, ORION, sensor.exposure_s, np.random.default_rng(8))
    result = SOLVER.solve(frame.pixels, SolveRequest(camera=tall))
    assert assess(result, frame.truth, tall).verdict in (Verdict.CORRECT, Verdict.IMPRECISE)


def test_field_of_view_alone_gives_geometry_and_image_centre() -> None:
    """With the field of view known to 4 %, or unknown, the direction of the image centre and the focal length are right."""
    camera = Camera.from_fov(800, 600, np.radians(20))
    sensor = replace(shipped_camera("sunsat").sensor, psf_sigma_px=1.2)
    frame = render(STARS.brighter_than(6.5), camera, sensor, ORION, sensor.exposure_s, np.random.default_rng(9))
    for request in (SolveRequest(fov_rad=np.radians(20.8)), SolveRequest(blind=True)):
        result = SOLVER.solve(frame.pixels, request)
        assert result.attitude is not None
        assert abs(result.camera.focal_col_px / camera.focal_col_px - 1) < 1e-3
        assert np.linalg.norm(result.attitude.cam_from_icrs[2] - ORION[2]) < 0.3 * camera.pixel_rad


def test_cubestar_chain_agrees_with_the_reference() -> None:
    """Results of the sensor's chain and of the reference chain differ by less than 0.05°."""
    frame = shot("cubestar", ORION)
    ours = SOLVER.solve(frame.pixels, SolveRequest(profile="cubestar"))
    theirs = SOLVER.solve(frame.pixels, SolveRequest(chain="cubestar", profile="cubestar"))
    assert ours.attitude is not None
    assert theirs.attitude is not None
    assert theirs.chain == "cubestar"
    assert np.linalg.norm(ours.attitude.cam_from_icrs[2] - theirs.attitude.cam_from_icrs[2]) < np.radians(0.05)


def test_impossible_requests_are_rejected_with_a_reason() -> None:
    """Requests with an unknown chain or profile, without or with two cameras, with an invalid field of view or image size
    are rejected."""
    frame = np.zeros((512, 1024), np.uint8)
    with pytest.raises(NotFound):
        SOLVER.solve(frame, SolveRequest(chain="magic", blind=True))
    with pytest.raises(NotFound):
        SOLVER.solve(frame, SolveRequest(profile="hubble"))
    for request in (
        SolveRequest(),
        SolveRequest(profile="cubestar", blind=True),
        SolveRequest(fov_rad=3.0),
        SolveRequest(chain="cubestar", blind=True),
    ):
        with pytest.raises(BadInput):
            SOLVER.solve(frame, request)
    with pytest.raises(BadInput, match="not of this camera"):
        SOLVER.solve(frame[:, :500], SolveRequest(profile="cubestar"))
