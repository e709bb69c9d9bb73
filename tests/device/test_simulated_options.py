"""The simulator's options: each gives the simulation it names, or an error with the expected values."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from gss.device.simulator.environment import Environment
from gss.device.simulator.faults import FaultRates
from gss.device.simulator.motion import EarthFixed, EarthPointing, Tumble
from gss.device.simulator.options import add_arguments, instrument_of, make_environment
from gss.device.simulator.orbit import GroundSite, Inertial, Sgp4Orbit, Zenith
from gss.domain.errors import GssError
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.sensor import NO_DEFECTS
from gss.instruments.registry import shipped_camera

TLE = """1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""


def _world(*options: str) -> Environment:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    named = () if "--instrument" in options else ("--instrument", "cubestar")
    arguments = parser.parse_args([*named, *options])
    instrument = instrument_of(arguments)
    return make_environment(arguments, instrument.profile, instrument)


def test_the_default_is_the_plain_sky_on_the_standard_orbit() -> None:
    """Stars only, a perfect detector, a perfect line: the reference for replay and the chains."""
    world = _world()
    assert world.motion == Zenith()
    assert world.epoch_jyear == 2026.0
    switches = (world.aberration, world.planets, world.moon, world.sun, world.earth, world.stray)
    assert switches == (False,) * 6
    assert world.defects == NO_DEFECTS
    assert world.line.up.rates == world.line.down.rates == FaultRates()


def test_the_real_sky_excludes_aberration() -> None:
    """--sky real enables everything except aberration."""
    world = _world("--sky", "real", "--instrument", "sunsat")
    assert all((world.planets, world.moon, world.sun, world.earth, world.stray))
    assert world.defects == shipped_camera("sunsat").defects
    assert not world.aberration
    assert _world("--aberration").aberration


def test_motions_start_at_the_given_attitude() -> None:
    """Right ascension, declination and roll in degrees; zenith with an attitude stays there."""
    for kind, expected in (("zenith", Inertial), ("slew", Inertial), ("tumble", Tumble), ("ground", EarthFixed)):
        world = _world("--motion", kind, "--attitude", "200,-33.9,15", "--rate-deg-s", "0.5")
        assert isinstance(world.motion, expected)
        assert np.degrees(ra_dec_roll_rad(world.motion.at(0.0).cam_from_icrs)) == pytest.approx((200, -33.9, 15))
    assert isinstance(world.orbit, GroundSite)
    for kind, rate_deg_s in (("inertial", 0.0), ("slew", 0.5), ("tumble", 0.5)):
        world = _world("--motion", kind, "--attitude", "200,-33.9,15", "--rate-deg-s", "0.5")
        assert np.degrees(world.rate_rad_s(7.0)) == pytest.approx(rate_deg_s)


def test_orbits_come_from_elements_or_a_file(tmp_path: Path) -> None:
    """A TLE has its own epoch; a mounting and body angles rotate the camera."""
    file = tmp_path / "station.tle"
    file.write_text(TLE)
    flown = _world("--tle", str(file))
    assert isinstance(flown.orbit, Sgp4Orbit)
    assert isinstance(flown.motion, EarthPointing)
    assert flown.epoch_jyear == pytest.approx(2019.94, abs=0.01)
    place_km, _ = flown.orbit.state(100.0)
    assert flown.motion.at(100.0).cam_from_icrs[2] == pytest.approx(place_km / np.linalg.norm(place_km), abs=1e-12)
    higher = _world("--altitude-km", "800", "--inclination-deg", "51.6", "--raan-deg", "10")
    assert higher.motion == Zenith(800.0, float(np.radians(51.6)), float(np.radians(10)))
    down = _world("--mounting", "nadir")
    assert down.earth_angle_rad(0.0) < -1.0
    tilted = _world("--roll-pitch-yaw", "5,0,0")
    cosine = tilted.motion.at(0.0).cam_from_icrs[2] @ Zenith().at(0.0).cam_from_icrs[2]
    assert np.degrees(np.arccos(cosine)) == pytest.approx(5.0)


def test_every_fault_has_its_option() -> None:
    """Rates of both directions, the delay in milliseconds."""
    options = (
        "--bit-error-rate 1e-5 --burst-rate 0.1 --drop-rate 0.2 --duplicate-rate 0.3 --stall-rate 0.4 --delay-ms 250"
    )
    want = FaultRates(1e-5, 0.2, 0.3, 0.4, burst_rate=0.1, delay_s=0.25)
    world = _world(*options.split())
    assert world.line.up.rates == world.line.down.rates == want


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--attitude 1,2", "the angles cannot be read"),
        ("--attitude 1,95,3", "declination is out of range"),
        ("--altitude-km 3", "altitude is out of range"),
        ("--tle nowhere.tle", "cannot be read"),
        ("--drop-rate 1.5", "drop_rate is out of range"),
        ("--roll-pitch-yaw x", "the angles cannot be read"),
        ("--instrument hubble", "unknown instrument"),
    ],
)
def test_invalid_options_are_rejected_with_the_expected_values(options: str, said: str) -> None:
    """No traceback: a message with the expected and the received value."""
    with pytest.raises(GssError, match=said) as caught:
        _world(*options.split())
    assert caught.value.expected
    assert caught.value.got
