"""Stray light: its sources, its decrease with angle, and occultation by the Earth."""

from __future__ import annotations

import numpy as np
import pytest

from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.veil import BLIND_E_S, earth_disc, earth_stray, grid_of, halo, sun_stray


def _direction(angle_deg: float, side_deg: float = 0.0) -> np.ndarray:
    """Unit vector at ``angle_deg`` from the boresight, in the direction of +x rotated by ``side_deg`` towards +y."""
    angle, azimuth = np.radians([angle_deg, side_deg])
    return np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])


def test_sun_stray_light_decreases_with_the_angle() -> None:
    """At the limit angle, stray light equals the reference. Outside it decreases as in Moniteq's table, and inside it
    rises e-fold every 3°.
    """
    profile = shipped_camera("aim")
    middle = (profile.camera.rows // 2, profile.camera.columns // 2)

    def stray_e_s(angle_deg: float) -> float:
        return float(sun_stray(profile.camera, profile.baffle, _direction(angle_deg))[middle])

    assert stray_e_s(20.0) == pytest.approx(154.0, rel=0.02)
    # Moniteq 1983 Table 5.3, electrons per second at 27°, 37° and 58°.
    for angle_deg, electrons in ((27, 104.0), (37, 71.2), (58, 39.7)):
        assert stray_e_s(angle_deg) == pytest.approx(electrons, rel=0.1)
    assert stray_e_s(14.0) == pytest.approx(154 * np.exp(2), rel=0.05)
    assert stray_e_s(5.0) == BLIND_E_S


def test_stray_light_increases_towards_its_source() -> None:
    """Over a wide field, stray light increases towards the Sun and towards the Earth."""
    profile = shipped_camera("cubestar")
    field = sun_stray(profile.camera, profile.baffle, _direction(40.0))
    assert 10 * field[256, 20] < field[256, 1000] < 40 * field[256, 20]
    lower = earth_stray(profile.camera, profile.baffle, _direction(110.0, 90.0), np.radians(66.0), 1.0)
    assert lower[500, 512] > lower[10, 512] > 0


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_the_earth_blocks_pixels_behind_its_limb(name: str) -> None:
    """A pixel is blocked if its direction, including distortion, is within the Earth's radius of the centre. The limb
    is accurate to a pixel, and the day side saturates.
    """
    profile = shipped_camera(name)
    earth_rad = np.radians(66.0)
    nadir = _direction(66.0 + np.degrees(profile.camera.half_diagonal_rad) * 0.2, 30.0)
    blocked, light = earth_disc(profile.camera, profile.sensor, nadir, earth_rad, -nadir)
    rng = np.random.default_rng(3)
    pixels = np.stack(
        [rng.integers(0, profile.camera.columns, 3000), rng.integers(0, profile.camera.rows, 3000)], axis=1
    )
    inside_rad = earth_rad - np.arccos(profile.camera.unproject(pixels.astype(float)) @ nadir)
    away_from_limb = np.abs(inside_rad) > 1.0 * profile.camera.pixel_rad
    is_blocked = blocked[pixels[:, 1], pixels[:, 0]]
    assert np.array_equal(is_blocked[away_from_limb], inside_rad[away_from_limb] > 0)
    assert 0.05 < blocked.mean() < 0.95
    assert (light[~blocked] == 0).all()
    sunlit_e = light[blocked] * profile.sensor.exposure_s
    assert np.median(sunlit_e) > profile.sensor.full_well_e


def test_the_night_side_is_dark() -> None:
    """With the Sun behind the Earth, only the airglow remains."""
    profile = shipped_camera("cubestar")
    nadir = _direction(80.0)
    blocked, day = earth_disc(profile.camera, profile.sensor, nadir, np.radians(66.0), -nadir)
    _, night = earth_disc(profile.camera, profile.sensor, nadir, np.radians(66.0), nadir)
    assert 0 < night[blocked].max() < 5 * profile.sensor.background_e_s
    assert day[blocked].max() > 1e6 * night[blocked].max()


def test_the_halo_decreases_with_the_square_of_the_angle() -> None:
    """At twice the angle from the Moon, the glare is a quarter."""
    profile = shipped_camera("cubestar")
    glare = halo(profile.camera, profile.sensor, _direction(0.0), -12.0, 0.2)
    columns = [round(profile.camera.centre_col_px + o) for o in (100, 200)]
    row = round(profile.camera.centre_row_px)
    angles = np.arccos(profile.camera.unproject(np.array([[c, row] for c in columns], float))[:, 2])
    assert glare[row, columns[0]] / glare[row, columns[1]] == pytest.approx((angles[1] / angles[0]) ** 2, rel=0.03)


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_the_coarse_grid_interpolates_linear_functions_exactly(name: str) -> None:
    """A linear function on the coarse grid is interpolated exactly at every pixel."""
    camera = shipped_camera(name).camera
    grid = grid_of(camera)
    r, c = grid.unit_cam.shape[:2]
    plane = np.linspace(0, camera.rows - 1, r)[:, None] + 2 * np.linspace(0, camera.columns - 1, c)[None, :]
    expected = np.arange(camera.rows)[:, None] + 2 * np.arange(camera.columns)[None, :]
    assert np.abs(grid.spread(plane) - expected).max() < 0.01
