"""Simulated exposures: their content, the positions in them, and their reproducibility."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric_posvel
from astropy.time import Time

from gss.catalogue_tools.corrections.corrections import aberrate
from gss.catalogue_tools.corrections.ephemeris import PLANETS
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.device.simulator.environment import Environment
from gss.device.simulator.orbit import Inertial, Zenith
from gss.device.simulator.sky import SimulatedSky
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.results import Centroids
from gss.domain.rotation import matrix_from_quaternion
from gss.domain.sensor import NO_DEFECTS
from gss.instruments.registry import shipped_camera, shipped_registry
from gss.pipeline.detect import find_stars

EPOCH_JYEAR = 2026.0
NAMES = sorted(i.name for i in shipped_registry().all() if i.profile.chain)


def _sky(name: str, ra_deg: float = 84.0, dec_deg: float = 5.0, roll_deg: float = 10.0, seed: int = 1) -> SimulatedSky:
    p = shipped_camera(name)
    pointing = np.radians([ra_deg, dec_deg, roll_deg])
    environment = Environment(p, Inertial.pointing(*(float(a) for a in pointing)), EPOCH_JYEAR, seed)
    return SimulatedSky(p, environment.motion, EPOCH_JYEAR, seed, environment)


def _towards(sky: SimulatedSky, icrs: Array, off_deg: float) -> None:
    """Point the camera ``off_deg`` from a direction, on the side away from the Earth."""
    nadir, _ = sky.environment.earth_disc(0.0)
    away = np.cross(np.cross(icrs, nadir), icrs)
    away = -away / np.linalg.norm(away)
    boresight = np.cos(np.radians(off_deg)) * icrs + np.sin(np.radians(off_deg)) * away
    ra, dec = np.arctan2(boresight[1], boresight[0]), np.arcsin(boresight[2])
    sky.environment.motion = Inertial.pointing(float(ra), float(dec), 0.3)


def _centroids_of(sky: SimulatedSky, pixels: np.ndarray) -> Centroids:
    sensor = sky.environment.profile.sensor
    return find_stars(pixels, psf_sigma_px=sensor.psf_sigma_px, saturation_dn=sensor.saturation_dn).centroids


def _miss_px(centroids: Centroids, places: Array) -> Array:
    """Return the distance from each of (n, 2) positions to the nearest centroid."""
    return np.linalg.norm(places[:, None] - centroids.pixels[None], axis=2).min(axis=1, initial=np.inf)


@pytest.mark.parametrize("name", NAMES)
def test_stars_of_the_limiting_magnitude_are_found(name: str) -> None:
    """In every camera, with defects and all sky sources, at least 90 % of stars within 0.5 magnitudes of the limit are
    detected, with at most 5 % false detections."""
    sky = _sky(name)
    sky.environment.make_real()
    sky.environment.moon = False
    p, missed, false_count, count = sky.environment.profile, [], 0, 0
    for number, (ra_deg, dec_deg) in enumerate([(84, 5), (52, 49), (150, 10), (110, -25)]):
        sky.environment.motion = Inertial.pointing(float(np.radians(ra_deg)), float(np.radians(dec_deg)), 0.3)
        assert not sky.environment.blinded(0.0)
        shot = sky.expose(0.0, p.sensor.exposure_s, number)
        centroids, truth = _centroids_of(sky, shot.pixels), shot.truth
        faint = (np.abs(truth.v_mag - p.sensor.faint_limit_mag + 0.25) <= 0.25) & p.camera.contains(truth.pixels, 4)
        missed += (_miss_px(centroids, truth.pixels[faint]) > 1.5).tolist()
        false_detection = np.linalg.norm(centroids.pixels[:, None] - truth.pixels[None], axis=2).min(axis=1) > 2
        false_count, count = false_count + int(false_detection.sum()), count + len(centroids)
    assert len(missed) >= 3
    assert np.mean(missed) <= 0.1
    assert false_count <= 0.05 * count


@pytest.mark.parametrize("name", NAMES)
def test_the_exposure_range_is_usable(name: str) -> None:
    """The shortest and the longest exposure are rendered, and the longer one is brighter."""
    sky = _sky(name)
    sky.environment.make_real()
    sensor = sky.environment.profile.sensor
    short, long = (sky.expose(0.0, t, 1).pixels for t in (sensor.exposure_min_s, sensor.exposure_max_s))
    assert long.mean() > short.mean()
    assert long.dtype == (np.uint8 if sensor.bits <= 8 else np.uint16)
    assert long.max() <= sensor.saturation_dn


def test_the_same_settings_give_the_same_image_bit_for_bit() -> None:
    """The same seed, frame number, time and settings give the same image, with everything enabled."""
    shots = []
    for _ in range(2):
        sky = _sky("cubestar", seed=9)
        sky.environment.make_real()
        sky.environment.aberration = True
        sky.environment.set_motion("tumble", 3.0, rate_rad_s=0.01)
        shots.append([sky.expose(t, 0.25, n).pixels for n, t in enumerate((4.0, 700.0))])
    assert all(np.array_equal(a, b) for a, b in zip(*shots, strict=True))


def test_hot_pixels_depend_on_the_seed_only() -> None:
    """Frames with different numbers have the same hot pixels. Another seed gives other hot pixels."""
    hot = []
    for seed, number in ((1, 1), (1, 2), (2, 1)):
        sky = _sky("cubestar", 200.0, 80.0, seed=seed)
        sky.environment.set_defects(True)
        pixels = sky.expose(0.0, 1.0, number).pixels.ravel()
        chip = sky.environment.chip
        assert chip is not None
        hottest = chip.hot[chip.dark_e_s.ravel()[chip.hot] > 2000]
        assert len(hottest) > 5
        assert np.median(pixels[hottest]) > np.median(pixels) + 100
        hot.append(chip.hot)
    assert np.array_equal(hot[0], hot[1])
    assert not np.array_equal(hot[0], hot[2])


def test_disabled_options_give_the_plain_sky() -> None:
    """After the real sky was enabled and disabled again, frames equal those of the plain sky."""
    plain = _sky("cubestar").expose(0.0, 0.25, 5).pixels
    sky = _sky("cubestar")
    sky.environment.make_real()
    assert not np.array_equal(sky.expose(0.0, 0.25, 5).pixels, plain)
    sky.environment.make_real(False)
    assert sky.environment.defects == NO_DEFECTS
    assert np.array_equal(sky.expose(0.0, 0.25, 5).pixels, plain)


def test_aberration_moves_stars_by_the_closed_formula_and_not_the_attitude() -> None:
    """Aberration does not change the true attitude. The true star positions are apparent ones and equal Jacobs' correction,
    including the orbit, within 0.05″."""
    sky = _sky("far_mst", 280.0, 60.0)
    before = sky.expose(0.0, 0.1, 1).truth
    sky.environment.aberration = True
    shot = sky.expose(0.0, 0.1, 1)
    assert shot.truth.quaternion == pytest.approx(before.quaternion)
    stars = propagate(load_stars(7.0), EPOCH_JYEAR)
    row = {int(hip): k for k, hip in enumerate(stars.hip)}
    unit = stars.icrs[[row[int(hip)] for hip in shot.truth.hip]]
    camera = sky.environment.profile.camera
    _, earth = get_body_barycentric_posvel("earth", Time(EPOCH_JYEAR, format="jyear"), ephemeris="builtin")
    earth_c = earth.xyz.to_value("km/s") / 299_792.458
    orbit_c = Zenith().orbit.state(0.0)[1] / 299_792.458
    apparent = aberrate(unit, earth_c + orbit_c)
    expected = camera.project(apparent @ matrix_from_quaternion(shot.truth.quaternion).T)
    assert np.abs(expected - shot.truth.pixels).max() * camera.pixel_rad < 0.05 * ARCSEC_RAD
    shift_rad = np.linalg.norm(camera.project(unit @ matrix_from_quaternion(before.quaternion).T) - expected, axis=1)
    assert 5 * ARCSEC_RAD < shift_rad.max() * camera.pixel_rad < 30 * ARCSEC_RAD


def test_planets_are_rendered_at_their_positions() -> None:
    """Jupiter in January 2026 is the brightest spot of its field and not in the truth. It is absent if planets are
    disabled."""
    sky = _sky("far_mst")
    bodies = sky.environment.bodies(0.0)
    jupiter = bodies.planets_icrs[PLANETS.index("Jupiter")]
    _towards(sky, jupiter, 3.0)
    sky.environment.planets = True
    shot = sky.expose(0.0, 0.02, 1)
    camera = sky.environment.profile.camera
    place = camera.project((matrix_from_quaternion(shot.truth.quaternion) @ jupiter)[None])
    assert camera.contains(place).all()
    centroids = _centroids_of(sky, shot.pixels)
    brightest = centroids.pixels[int(np.argmax(centroids.flux_dn))]
    assert np.linalg.norm(brightest - place[0]) < 0.5
    assert np.linalg.norm(shot.truth.pixels - place, axis=1).min() > 3
    sky.environment.planets = False
    assert _miss_px(_centroids_of(sky, sky.expose(0.0, 0.02, 1).pixels), place)[0] > 3


@pytest.mark.parametrize("name", NAMES)
def test_the_moon_is_a_saturated_disc_with_glare(name: str) -> None:
    """The Moon is a saturated disc of its size at its position. With stray light there is glare around it."""
    sky = _sky(name)
    p, bodies = sky.environment.profile, sky.environment.bodies(0.0)
    _towards(sky, bodies.moon.icrs, 0.4 * np.degrees(p.camera.half_diagonal_rad))
    sky.environment.moon = True
    shot = sky.expose(0.0, 0.02, 1)
    place = p.camera.project((sky.environment.motion.at(0.0).cam_from_icrs @ bodies.moon.icrs)[None])[0]
    clipped = np.argwhere(
        shot.pixels >= min(p.sensor.saturation_dn, p.sensor.full_well_e / p.sensor.gain_e_per_dn * 0.99)
    )
    assert np.linalg.norm(clipped.mean(axis=0)[::-1] - place) < 2
    area_px = np.pi * bodies.moon.radius_rad**2 * p.camera.focal_col_px * p.camera.focal_row_px
    spread = (1 + 4.5 * p.sensor.psf_sigma_px / np.sqrt(area_px / np.pi)) ** 2
    assert 0.6 * area_px < len(clipped) < spread * area_px
    sky.environment.stray = True
    glaring = sky.expose(0.0, 0.02, 1).pixels.astype(float) - shot.pixels
    assert glaring.mean() * p.sensor.gain_e_per_dn > 1.0
    assert len(np.argwhere(glaring > min(3.0, 100.0 / p.sensor.gain_e_per_dn))) > 2 * area_px


def test_a_half_moon_is_lit_on_the_side_of_the_sun() -> None:
    """At the last quarter of 10 January 2026, the centroid of light is displaced from the disc's centre towards the Sun."""
    sky = _sky("aim")
    environment = sky.environment
    time_s = 9.1 * 86_400.0
    bodies = environment.bodies(time_s)
    environment.moon = True
    ra, dec = np.arctan2(bodies.moon.icrs[1], bodies.moon.icrs[0]), np.arcsin(bodies.moon.icrs[2])
    environment.motion = Inertial.pointing(float(ra), float(dec), 0.0)
    pixels = sky.expose(time_s, 0.02, 1).pixels
    row, col = np.argwhere(pixels > 2000).mean(axis=0)
    camera = environment.profile.camera
    light = np.array([col - camera.centre_col_px, row - camera.centre_row_px])
    sun = (environment.motion.at(time_s).cam_from_icrs @ bodies.sun.icrs)[:2]
    assert light @ sun / np.linalg.norm(light) / np.linalg.norm(sun) > 0.95
    radius_px = bodies.moon.radius_rad / camera.pixel_rad
    assert 0.25 * radius_px < np.linalg.norm(light) < 0.6 * radius_px


def _level_e_s(sky: SimulatedSky) -> float:
    p = sky.environment.profile
    dn = float(np.median(sky.expose(0.0, p.sensor.exposure_s, 1).pixels))
    return (dn - p.sensor.bias_dn) * p.sensor.gain_e_per_dn / p.sensor.exposure_s


@pytest.mark.parametrize("name", NAMES)
def test_stray_light_rises_towards_the_sun_until_saturation(name: str) -> None:
    """The background increases as the Sun approaches, until the frame is saturated within the baffle's blind angle. In
    eclipse, or if disabled, the Sun has no effect."""
    sky = _sky(name)
    environment, baffle = sky.environment, sky.environment.profile.baffle
    environment.orbit = Zenith(raan_rad=float(np.arctan2(*environment.bodies(0.0).sun.icrs[[1, 0]]))).orbit
    sun = environment.bodies(0.0).sun.icrs
    assert not environment.in_eclipse(0.0)
    environment.sun = environment.stray = True
    limit_deg, blind_deg = np.degrees([baffle.sun_limit_rad, baffle.blind_rad])
    levels = []
    for angle_deg in (limit_deg + 40, max(limit_deg - 12, blind_deg + 1), blind_deg - 2):
        _towards(sky, sun, angle_deg)
        assert np.degrees(environment.sun_angle_rad(0.0)) == pytest.approx(angle_deg)
        levels.append(_level_e_s(sky))
    assert environment.blinded(0.0)
    assert levels[0] < levels[1] < levels[2]
    p = environment.profile
    white = sky.expose(0.0, p.sensor.exposure_s, 1).pixels
    full_dn = min(p.sensor.saturation_dn, p.sensor.bias_dn + p.sensor.full_well_e / p.sensor.gain_e_per_dn)
    assert white.min() >= 0.99 * full_dn
    half_period_s = np.pi / Zenith().mean_motion_rad_s
    assert environment.in_eclipse(half_period_s)
    assert not environment.blinded(half_period_s)
    environment.sun = False
    assert _level_e_s(sky) < levels[1]


def test_the_earth_in_the_field_hides_stars() -> None:
    """Bright stars below the limb are not detected, and those above it are. The truth contains both."""
    sky = _sky("cubestar")
    environment = sky.environment
    nadir, earth_rad = environment.earth_disc(0.0)
    environment.orbit = Zenith().orbit
    environment.earth = True
    _towards(sky, nadir + np.array([0.0, 0.0, 1e-9]), float(np.degrees(earth_rad)) + 3.0)
    shot = sky.expose(0.0, 0.25, 1)
    unit = environment.profile.camera.unproject(shot.truth.pixels) @ environment.motion.at(0.0).cam_from_icrs
    behind = np.arccos(np.clip(unit @ nadir, -1, 1)) < earth_rad - 0.02
    bright = shot.truth.v_mag < 4.0
    miss_px = _miss_px(_centroids_of(sky, shot.pixels), shot.truth.pixels)
    assert (behind & bright).sum() >= 3
    assert (~behind & bright).sum() >= 3
    assert (miss_px[behind & bright] < 1.5).mean() < 0.2
    assert (miss_px[~behind & bright] < 1.5).mean() > 0.8


def test_heat_increases_the_dark_current() -> None:
    """A temperature increase of 16 °C gives four times the dark current."""
    sky = _sky("far_mst")
    sensor = sky.environment.profile.sensor
    level: Callable[[], float] = lambda: float(sky.expose(0.0, 1.0, 1).pixels.mean())  # noqa: E731
    cool = level()
    sky.environment.temperature_offset_c = 16.0
    assert (level() - cool) * sensor.gain_e_per_dn == pytest.approx(3 * sensor.dark_current_e_s, rel=0.05)


@pytest.mark.parametrize("name", ["aim", "cubestar"])
def test_the_fastest_tumble_can_be_rendered(name: str) -> None:
    """At 20°/s a frame with the Moon is rendered with its truth, and fewer stars are detected because they are smeared."""
    sky = _sky(name)
    sky.environment.make_real()
    _towards(sky, sky.environment.bodies(0.0).moon.icrs, 1.0)
    still = sky.expose(0.0, 0.25, 1)
    sky.environment.set_motion("tumble", 0.0, rate_rad_s=float(np.radians(20.0)))
    fast = sky.expose(0.0, 0.25, 1)
    assert np.array_equal(fast.truth.hip, still.truth.hip)
    assert fast.truth.v_mag == pytest.approx(still.truth.v_mag)
    assert len(_centroids_of(sky, fast.pixels)) < len(_centroids_of(sky, still.pixels)) or name == "aim"


def test_colours_change_the_brightness_of_stars_only_on_request() -> None:
    """With star colours a red star is brighter for Oersted's detector and a white one has its V (Liebe 1992); the default
    renders V."""
    profile = shipped_camera("oersted")
    motion = Inertial.pointing(*np.radians([84.0, 2.0, 0.0]))
    plain, coloured = (
        SimulatedSky(profile, motion, 2026.0, 1, star_colours=on).expose(0.0, 0.1, 1) for on in (False, True)
    )
    betelgeuse, rigel = 27989, 24436
    change = {
        hip: float(coloured.truth.v_mag[coloured.truth.hip == hip][0] - plain.truth.v_mag[plain.truth.hip == hip][0])
        for hip in (betelgeuse, rigel)
    }
    assert change[betelgeuse] < -0.5
    assert change[rigel] == pytest.approx(0.0, abs=0.1)
    col, row = np.rint(plain.truth.pixels[plain.truth.hip == betelgeuse][0]).astype(int)
    box = np.s_[row - 6 : row + 7, col - 6 : col + 7]
    assert coloured.pixels[box].astype(float).sum() > plain.pixels[box].astype(float).sum()
