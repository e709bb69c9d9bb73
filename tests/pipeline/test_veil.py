"""Stray light: its sources, its decrease with angle, and occultation by the Earth."""

from __future__ import annotations

import numpy as np
import pytest

from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.veil import BLIND_E_S, earth_disc, earth_stray, grid_of, halo, sun_stray


def _at(angle_deg: float, side_deg: float = 0.0) -> np.ndarray:
    """Unit vector at ``angle_deg`` from the boresight, in the direction of +x rotated by ``side_deg`` towards +y."""
    angle, side = np.radians([angle_deg, side_deg])
    return np.array([np.sin(angle) * np.cos(side), np.sin(angle) * np.sin(side), np.cos(angle)])


def test_sun_stray_light_follows_the_angle() -> None:
    """It equals the reference at the limit, falls as in Moniteq's table outside, and rises e-fold every 3° inside."""
    p = shipped_camera("aim")
    middle = (p.camera.rows // 2, p.camera.columns // 2)

    def seen(angle_deg: float) -> float:
        return float(sun_stray(p.camera, p.baffle, _at(angle_deg))[middle])

    assert seen(20.0) == pytest.approx(154.0, rel=0.02)
    # Moniteq 1983 Table 5.3, electrons per second at 27°, 37° and 58°.
    for angle_deg, electrons in ((27, 104.0), (37, 71.2), (58, 39.7)):
        assert seen(angle_deg) == pytest.approx(electrons, rel=0.1)
    assert seen(14.0) == pytest.approx(154 * np.exp(2), rel=0.05)
    assert seen(5.0) == BLIND_E_S


def test_the_side_towards_the_sun_is_brighter() -> None:
    """Stray light has a slope over a wide field."""
    p = shipped_camera("cubestar")
    field = sun_stray(p.camera, p.baffle, _at(40.0))
    assert 10 * field[256, 20] < field[256, 1000] < 40 * field[256, 20]
    lower = earth_stray(p.camera, p.baffle, _at(110.0, 90.0), np.radians(66.0), 1.0)
    assert lower[500, 512] > lower[10, 512] > 0


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_the_earth_hides_pixels_behind_its_limb(name: str) -> None:
    """A pixel is blocked when its own direction is within the Earth's radius of the centre, to a pixel, distortion included."""
    p = shipped_camera(name)
    earth_rad = np.radians(66.0)
    nadir = _at(66.0 + np.degrees(p.camera.half_diagonal_rad) * 0.2, 30.0)
    blocked, light = earth_disc(p.camera, p.sensor, nadir, earth_rad, -nadir)
    rng = np.random.default_rng(3)
    pixels = np.stack([rng.integers(0, p.camera.columns, 3000), rng.integers(0, p.camera.rows, 3000)], axis=1)
    inside_rad = earth_rad - np.arccos(p.camera.unproject(pixels.astype(float)) @ nadir)
    sure = np.abs(inside_rad) > 1.0 * p.camera.pixel_rad
    found = blocked[pixels[:, 1], pixels[:, 0]]
    assert np.array_equal(found[sure], inside_rad[sure] > 0)
    assert 0.05 < blocked.mean() < 0.95
    assert (light[~blocked] == 0).all()
    sunlit_e = light[blocked] * p.sensor.exposure_s
    assert np.median(sunlit_e) > p.sensor.full_well_e


def test_the_night_side_is_dark_and_still_hides_the_sky() -> None:
    """With the Sun behind the Earth only the glow is left."""
    p = shipped_camera("cubestar")
    nadir = _at(80.0)
    blocked, day = earth_disc(p.camera, p.sensor, nadir, np.radians(66.0), -nadir)
    _, night = earth_disc(p.camera, p.sensor, nadir, np.radians(66.0), nadir)
    assert 0 < night[blocked].max() < 5 * p.sensor.background_e_s
    assert day[blocked].max() > 1e6 * night[blocked].max()


def test_the_halo_falls_with_the_square_of_the_angle() -> None:
    """Twice as far from the Moon there is a quarter of its glare."""
    p = shipped_camera("cubestar")
    glare = halo(p.camera, p.sensor, _at(0.0), -12.0, 0.2)
    columns = [round(p.camera.centre_col_px + o) for o in (100, 200)]
    row = round(p.camera.centre_row_px)
    angles = np.arccos(p.camera.unproject(np.array([[c, row] for c in columns], float))[:, 2])
    assert glare[row, columns[0]] / glare[row, columns[1]] == pytest.approx((angles[1] / angles[0]) ** 2, rel=0.03)


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_the_coarse_grid_interpolates_linear_functions_exactly(name: str) -> None:
    """Spreading a plane over the detector is exact at every pixel."""
    camera = shipped_camera(name).camera
    grid = grid_of(camera)
    r, c = grid.unit_cam.shape[:2]
    plane = np.linspace(0, camera.rows - 1, r)[:, None] + 2 * np.linspace(0, camera.columns - 1, c)[None, :]
    want = np.arange(camera.rows)[:, None] + 2 * np.arange(camera.columns)[None, :]
    assert np.abs(grid.spread(plane) - want).max() < 0.01
