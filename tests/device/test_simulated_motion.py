"""Position and attitude of the simulated camera: rates compared with derivatives of the attitude, orbits with references."""

from __future__ import annotations

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, TEME, CartesianDifferential, CartesianRepresentation
from astropy.time import Time
from astropy.utils import iers
from scipy.spatial.transform import Rotation
from sgp4.api import Satrec

from gss.device.simulator.environment import Environment, on_the_ground
from gss.device.simulator.motion import EarthFixed, EarthPointing, SlewTo, Tumble
from gss.device.simulator.orbit import CircularOrbit, GroundSite, Inertial, Motion, Sgp4Orbit, Zenith
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs, pointing_difference_rad, ra_dec_roll_rad
from gss.instruments.registry import shipped_camera

START = cam_from_icrs(1.2, -0.4, 2.0)
# The example element set of the sgp4 package (International Space Station, December 2019).
TLE = """ISS
1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""
MOTIONS: dict[str, Motion] = {
    "tumble": Tumble.of_rate(START, 0.02, 5.0),
    "slew to": SlewTo(START, cam_from_icrs(4.0, 1.0, 0.3), 8.0, 40.0),
    "ground": EarthFixed(START, np.array([0.0, 0.0, 1.0])),
    "earth pointing": EarthPointing(CircularOrbit(), None, (0.1, -0.2, 0.3)),
    "tle": EarthPointing(Sgp4Orbit(TLE)),
    "slew": Inertial(START, np.array([0.0, 0.01, 0.0]), 3.0),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_rates_are_derivatives_of_the_attitude(name: str) -> None:
    """In every mode, the rate passed to the renderer equals the numerical derivative of the attitude, calculated with
    scipy."""
    motion = MOTIONS[name]
    for time_s in (9.0, 20.0, 300.0):
        before, now, after = (motion.at(time_s + d) for d in (-0.01, 0.0, 0.01))
        rotation_rad_s = Rotation.from_matrix(after.cam_from_icrs @ before.cam_from_icrs.T).as_rotvec() / 0.02
        assert -rotation_rad_s == pytest.approx(now.rate_rad_s, abs=2e-6)
        assert now.cam_from_icrs @ now.cam_from_icrs.T == pytest.approx(np.eye(3), abs=1e-12)


def test_a_tumble_keeps_its_angular_speed_and_momentum() -> None:
    """A tumble is torque-free: its angular speed and momentum are constant, and the direction of its rate changes."""
    motion = Tumble.of_rate(START, 0.05)
    poses = [motion.at(t) for t in np.linspace(0, 500, 60)]
    rates = np.stack([p.rate_rad_s for p in poses])
    assert np.linalg.norm(rates, axis=1) == pytest.approx(0.05, rel=1e-9)
    assert np.linalg.norm(rates - rates[0], axis=1).max() > 0.01
    # Momentum of a body of revolution: moments I and kI about the cross axes and the axis of symmetry.
    s, h = motion.spin_axis_cam, START @ motion.momentum_icrs
    k = 1 - motion.spin_rad_s / (motion.spin_rad_s + motion.precession_rad_s * float(s @ h))
    momenta = [p.cam_from_icrs.T @ (p.rate_rad_s + (k - 1) * (p.rate_rad_s @ s) * s) for p in poses]
    assert np.abs(np.stack(momenta) - momenta[0]).max() < 1e-12


def test_a_slew_ends_on_its_target_at_rest() -> None:
    """A slew starts at the current attitude, is fastest in the middle, and ends on its target at rest."""
    target = cam_from_icrs(4.0, 1.0, 0.3)
    motion = SlewTo(START, target, 8.0, 40.0)
    assert motion.at(0.0).cam_from_icrs == pytest.approx(START)
    for time_s in (48.0, 1000.0):
        assert motion.at(time_s).cam_from_icrs == pytest.approx(target, abs=1e-12)
        assert np.linalg.norm(motion.at(time_s).rate_rad_s) == pytest.approx(0.0, abs=1e-12)
    slew_angle_rad = float(np.linalg.norm(Rotation.from_matrix(target @ START.T).as_rotvec()))
    assert np.linalg.norm(motion.at(28.0).rate_rad_s) == pytest.approx(2 * slew_angle_rad / 40.0)
    with pytest.raises(BadInput, match="duration of a slew"):
        SlewTo(START, target, 0.0, 0.0)


def test_the_earth_rotates_the_camera_once_in_a_sidereal_day() -> None:
    """After 86 164.1 s the attitude is the same. The declination of the zenith is constant."""
    motion, site = on_the_ground(cam_from_icrs(1.0, np.radians(-33.9), 0.0), 2000.0)
    cross, about = pointing_difference_rad(motion.at(86_164.1).cam_from_icrs, motion.at(0.0).cam_from_icrs)
    assert max(cross, abs(about)) < 1e-5
    declinations = [ra_dec_roll_rad(motion.at(t).cam_from_icrs)[1] for t in np.linspace(0, 86_000, 9)]
    assert np.degrees(declinations) == pytest.approx(-33.9, abs=0.01)
    ra_hour = (ra_dec_roll_rad(motion.at(3600.0).cam_from_icrs)[0] - 1.0) / 3600.0
    assert ra_hour == pytest.approx(7.2921e-5, rel=1e-3)
    place_km, velocity_km_s = site.state(5000.0)
    assert place_km / 6378.137 == pytest.approx(motion.at(5000.0).cam_from_icrs[2], abs=1e-12)
    assert np.linalg.norm(velocity_km_s) == pytest.approx(0.4651 * np.cos(np.radians(33.9)), rel=1e-3)


def test_earth_pointing_on_a_circular_orbit_equals_the_zenith_camera() -> None:
    """Both motions give the same attitude and rate, and the position is in the zenith's direction."""
    zenith, general = Zenith(raan_rad=0.7, start_rad=1.0), EarthPointing(CircularOrbit(raan_rad=0.7, start_rad=1.0))
    for time_s in (0.0, 777.0):
        a, b = zenith.at(time_s), general.at(time_s)
        assert a.cam_from_icrs == pytest.approx(b.cam_from_icrs, abs=1e-12)
        assert a.rate_rad_s == pytest.approx(b.rate_rad_s, abs=1e-12)
        place_km, velocity_km_s = zenith.orbit.state(time_s)
        assert place_km / 6978.137 == pytest.approx(a.cam_from_icrs[2], abs=1e-12)
        step = (zenith.orbit.state(time_s + 0.5)[0] - zenith.orbit.state(time_s - 0.5)[0]) / 1.0
        assert step == pytest.approx(velocity_km_s, abs=1e-5)


def test_a_tle_orbit_agrees_with_sgp4_and_astropy() -> None:
    """The orbit equals SGP4, transformed from TEME to GCRS by astropy, within 50 m and 5 cm/s. The epoch is that of the
    TLE."""
    orbit = Sgp4Orbit(TLE)
    assert orbit.epoch_jyear == pytest.approx(
        2000.0 + (2458826.5 - 2451545.0 + 0.69339541 + 69.184 / 86400) / 365.25, abs=1e-9
    )
    satellite = Satrec.twoline2rv(*TLE.strip().splitlines()[1:])
    for time_s in (0.0, 5000.0):
        error, place, velocity = satellite.sgp4(satellite.jdsatepoch, satellite.jdsatepochF + time_s / 86400)
        assert error == 0
        teme_state = CartesianRepresentation(place * u.km, differentials=CartesianDifferential(velocity * u.km / u.s))
        moment = Time(satellite.jdsatepoch, satellite.jdsatepochF + time_s / 86400, format="jd", scale="utc")
        with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            gcrs_state = TEME(teme_state, obstime=moment).transform_to(GCRS(obstime=moment)).cartesian
        place_km, velocity_km_s = orbit.state(time_s)
        assert place_km == pytest.approx(gcrs_state.xyz.to_value(u.km), abs=0.05)
        assert velocity_km_s == pytest.approx(gcrs_state.differentials["s"].d_xyz.to_value(u.km / u.s), abs=5e-5)


def test_a_tle_from_another_year_is_rejected() -> None:
    """A TLE is rejected for an epoch of another year, because elements are valid only for weeks."""
    with pytest.raises(BadInput, match="outside the TLE's validity"):
        Sgp4Orbit(TLE, 2026.0)


def test_motion_changes_at_run_time_from_the_current_attitude() -> None:
    """Each change of motion starts at the current attitude. The motion "ground" fixes the position, and "zenith" returns to
    the orbit."""
    environment = Environment(shipped_camera("cubestar"), Zenith())
    before = environment.motion.at(100.0).cam_from_icrs
    for kind in ("inertial", "slew", "tumble", "ground"):
        environment.set_motion("zenith", 100.0)
        environment.set_motion(kind, 100.0, rate_rad_s=0.01)
        assert environment.motion.at(100.0).cam_from_icrs == pytest.approx(before, abs=1e-12), kind
    assert isinstance(environment.orbit, GroundSite)
    assert environment.in_eclipse(0.0)
    assert environment.rate_rad_s(150.0) == pytest.approx(7.2921e-5, rel=1e-4)
    environment.set_motion("slew", 180.0, rate_rad_s=0.01, from_rad=(3.0, -0.5, 0.2))
    assert ra_dec_roll_rad(environment.motion.at(180.0).cam_from_icrs) == pytest.approx((3.0, -0.5, 0.2), abs=1e-9)
    environment.set_motion("point", 200.0, ra_rad=2.0, dec_rad=0.5, roll_rad=1.0, duration_s=10.0)
    assert ra_dec_roll_rad(environment.motion.at(210.0).cam_from_icrs) == pytest.approx((2.0, 0.5, 1.0), abs=1e-9)
    environment.set_motion("zenith", 300.0)
    assert environment.motion.at(100.0).cam_from_icrs == pytest.approx(before)
    assert not environment.orbit.grounded


def test_a_camera_with_an_inertial_start_can_change_to_the_orbit() -> None:
    """The motion "zenith" after an inertial start points to the zenith on the environment's orbit."""
    environment = Environment(shipped_camera("cubestar"), Inertial(START, np.zeros(3)), orbit=CircularOrbit(800.0))
    environment.set_motion("zenith", 10.0)
    assert environment.motion.at(10.0).cam_from_icrs == pytest.approx(Zenith(800.0).at(10.0).cam_from_icrs, abs=1e-12)


def test_invalid_input_changes_no_motion() -> None:
    """An unknown motion, rate or duration is rejected, and the motion does not change."""
    environment = Environment(shipped_camera("cubestar"), Zenith())
    before = environment.motion
    with pytest.raises(BadInput, match="unknown motion"):
        environment.set_motion("dance", 0.0)
    with pytest.raises(BadInput, match="out of range"):
        environment.set_motion("tumble", 0.0, rate_rad_s=1.0)
    with pytest.raises(BadInput, match="duration of a slew"):
        environment.set_motion("point", 0.0, duration_s=-1.0)
    assert environment.motion is before


def test_a_third_of_a_low_noon_orbit_is_in_the_earths_shadow() -> None:
    """On a noon orbit, 36.5 % of the time is eclipse. Angles to Sun and limb are correct, and the sensor is warmer on the
    day side."""
    sun_ra = np.radians(281.3)  # 1 January
    environment = Environment(
        shipped_camera("cubestar"), Zenith(inclination_rad=np.radians(97.8), raan_rad=float(sun_ra))
    )
    times_s = np.linspace(0, 5800, 117)
    dark = np.array([environment.in_eclipse(t) for t in times_s])
    assert dark.mean() == pytest.approx(0.365, abs=0.03)
    angles = np.array([environment.sun_angle_rad(t) for t in times_s])
    # Camera at the zenith: in the shadow the Sun is behind it.
    assert angles[dark].min() > np.radians(110)
    limb_rad = np.pi - np.arcsin(6378.137 / 6978.137)
    assert [environment.earth_angle_rad(t) for t in times_s[:3]] == pytest.approx([limb_rad] * 3)
    warm = np.array([environment.sensor_temperature_c(t) for t in times_s])
    assert warm.max() - warm.min() == pytest.approx(12.0, abs=1.0)
    environment.temperature_offset_c = 16.0
    assert environment.sensor_temperature_c(0.0) == pytest.approx(warm[0] + 16)
    assert environment.dark_factor == pytest.approx(4.0)
