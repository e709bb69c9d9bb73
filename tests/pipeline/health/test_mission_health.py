"""Health of a rendered mission of a small camera: focal-length jump, damaged pixels and particles are found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import reference
from gss.pipeline.health.frame_figures import FIGURES
from gss.pipeline.health.mission import MissionHealth, mission_health
from gss.pipeline.health.trend import DAY_S
from gss.pipeline.identify.verify import SkyCatalogue
from validation.health.year import FOCAL_JUMP, FOCAL_PER_K, START_S, Year, year

pytestmark = pytest.mark.timeout(400)  # the year is rendered once, two minutes on a busy machine

FRAMES = 90


def _profile() -> CameraProfile:
    """Return CubeStar's profile with a smaller detector."""
    shipped = shipped_camera("cubestar")
    return replace(shipped, camera=Camera.from_fov(400, 300, float(np.radians(20.0))))


@pytest.fixture(scope="module")
def mission() -> tuple[CameraProfile, Year, MissionHealth]:
    """Return the profile, the simulated year and the health figures calculated from it."""
    profile = _profile()
    stars = load_stars(7.0)
    sky = reference.known_sky(SkyCatalogue(stars.hip, stars.icrs, stars.v_mag), profile.camera, 5.5)
    sensor = replace(profile.sensor, zero_point_e_s=6 * profile.sensor.zero_point_e_s)
    profile = replace(profile, sensor=sensor)
    simulated = year(
        profile,
        stars,
        FRAMES,
        5,
        lambda pixels: reference.solve_known(pixels, profile.camera, sensor, sky),
        lambda _: None,
    )
    return profile, simulated, mission_health(simulated.frames, profile.camera, sensor, lambda *_: None)


def test_jump_of_the_focal_length_is_found(mission: tuple[CameraProfile, Year, MissionHealth]) -> None:
    """The only jump is found with its time and size, and so is the change with temperature."""
    profile, _, health = mission
    trend = health.figure("focal length").trend
    assert trend is not None
    (jump,) = trend.jumps
    assert jump.time_s.contains(START_S + FOCAL_JUMP[0] * DAY_S)
    assert jump.size.contains(FOCAL_JUMP[1] * profile.camera.focal_col_px)
    assert trend.per_k is not None
    assert trend.per_k.contains(FOCAL_PER_K * profile.camera.focal_col_px)


def test_damaged_pixels_are_dated_without_false_ones(mission: tuple[CameraProfile, Year, MissionHealth]) -> None:
    """Every pixel with an onset is truly damaged, and 90 % of the onsets are within their intervals. All others were
    hot from the start.
    """
    profile, simulated, health = mission
    columns = profile.camera.columns
    true = dict(zip(simulated.damage.place.tolist(), simulated.damage.onset_day.tolist(), strict=True))
    new = [c for c in health.pixels if c.onset_s is not None]
    assert all(c.row * columns + c.col in true for c in new)
    dated = [c.onset_s.contains(START_S + true[c.row * columns + c.col] * DAY_S) for c in new if c.onset_s is not None]
    assert len(new) >= 50
    assert np.mean(dated) >= 0.9
    factory = set(simulated.chip.hot.tolist()) | set(true)
    assert all(c.row * columns + c.col in factory for c in health.pixels)


def test_particles_are_counted_per_frame(mission: tuple[CameraProfile, Year, MissionHealth]) -> None:
    """The number of particles per frame correlates with the simulated hits, and the total agrees."""
    _, simulated, health = mission
    solved = [k for k, f in enumerate(simulated.frames) if f.solved]
    hits = np.array([simulated.true[k].hits for k in solved])
    assert np.corrcoef(hits, health.particles)[0, 1] > 0.95
    assert 0.75 * hits.sum() <= health.particles.sum() <= 1.1 * hits.sum()


def test_dark_current_follows_the_temperature(mission: tuple[CameraProfile, Year, MissionHealth]) -> None:
    """The dark current doubles every 8 K, as simulated. Without a temperature the factor is 1."""
    _, _, health = mission
    assert health.dark.law_known
    assert health.dark.doubling_k.value == pytest.approx(8.0, rel=0.03)
    assert health.dark.factor(np.nan) == 1.0


def test_every_figure_has_samples(mission: tuple[CameraProfile, Year, MissionHealth]) -> None:
    """All figures are present, and at most the light of white stars lacks a trend."""
    _, _, health = mission
    assert {f.name for f in health.figures} == set(FIGURES)
    assert [f.name for f in health.figures if f.trend is None] in ([], ["light of white stars"])


def test_unsuitable_frames_are_rejected(mission: tuple[CameraProfile, Year, MissionHealth]) -> None:
    """Ten frames, frames without solutions, of one time or of another size are rejected."""
    profile, simulated, _ = mission
    with pytest.raises(BadInput, match="too few frames"):
        mission_health(simulated.frames[:10], profile.camera, profile.sensor, lambda *_: None)
    unsolved = [replace(f, result=None) for f in simulated.frames]
    with pytest.raises(BadInput, match="0 of 90"):
        mission_health(unsolved, profile.camera, profile.sensor, lambda *_: None)
    at_once = [replace(f, time_s=START_S) for f in simulated.frames]
    with pytest.raises(BadInput, match="the same time"):
        mission_health(at_once, profile.camera, profile.sensor, lambda *_: None)
    wide = [replace(f, pixels=lambda: np.zeros((300, 443), np.uint8)) for f in simulated.frames]
    with pytest.raises(BadInput, match="443 x 300 px"):
        mission_health(wide, profile.camera, profile.sensor, lambda *_: None)
