"""The simulator's options: each has its stated effect, and invalid ones are rejected with the expected values."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from gss.device.simulator.attitude_control import ControlledBody
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


def _environment(*options: str) -> Environment:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    instrument_option = () if "--instrument" in options else ("--instrument", "cubestar")
    arguments = parser.parse_args([*instrument_option, *options])
    instrument = instrument_of(arguments)
    return make_environment(arguments, instrument.profile, instrument)


def test_the_default_is_the_plain_sky_on_the_standard_orbit() -> None:
    """By default the simulation has stars only, a perfect detector and a perfect line, as replay and the chains expect."""
    world = _environment()
    assert world.motion == Zenith()
    assert world.epoch_jyear == 2026.0
    switches = (world.aberration, world.planets, world.moon, world.sun, world.earth, world.stray)
    assert switches == (False,) * 6
    assert world.defects == NO_DEFECTS
    assert world.line.up.rates == world.line.down.rates == FaultRates()


def test_the_real_sky_excludes_aberration() -> None:
    """The option ``--sky real`` enables everything except aberration."""
    world = _environment("--sky", "real", "--instrument", "sunsat")
    assert all((world.planets, world.moon, world.sun, world.earth, world.stray))
    assert world.defects == shipped_camera("sunsat").defects
    assert not world.aberration
    assert _environment("--aberration").aberration


def test_motions_start_at_the_given_attitude() -> None:
    """A motion starts at the given right ascension, declination and roll in degrees. With an attitude, "zenith" is
    inertial."""
    for kind, expected in (("zenith", Inertial), ("slew", Inertial), ("tumble", Tumble), ("ground", EarthFixed)):
        world = _environment("--motion", kind, "--attitude", "200,-33.9,15", "--rate-deg-s", "0.5")
        assert isinstance(world.motion, expected)
        assert np.degrees(ra_dec_roll_rad(world.motion.at(0.0).cam_from_icrs)) == pytest.approx((200, -33.9, 15))
    assert isinstance(world.orbit, GroundSite)
    for kind, rate_deg_s in (("inertial", 0.0), ("slew", 0.5), ("tumble", 0.5)):
        world = _environment("--motion", kind, "--attitude", "200,-33.9,15", "--rate-deg-s", "0.5")
        assert np.degrees(world.rate_rad_s(7.0)) == pytest.approx(rate_deg_s)


def test_an_attitude_control_needs_sunsats_mounting() -> None:
    """Motion "controlled" starts at --roll-pitch-yaw on the orbit. Other mountings are rejected, because the matched vectors
    are in Sunsat's body axes."""
    world = _environment(
        "--instrument", "sunsat", "--motion", "controlled", "--roll-pitch-yaw", "1,0,135", "--altitude-km", "800"
    )
    assert isinstance(world.motion, ControlledBody)
    assert world.motion.orbit == world.orbit
    assert np.degrees(world.motion.error_rad(0.0)) == pytest.approx(1.0)
    with pytest.raises(GssError, match="Sunsat's body axes"):
        _environment("--instrument", "cubestar", "--motion", "controlled")


def test_orbits_come_from_elements_or_a_file(tmp_path: Path) -> None:
    """The orbit is that of a TLE file, with its epoch, or of the given elements. Mounting and body angles rotate the
    camera."""
    file = tmp_path / "station.tle"
    file.write_text(TLE)
    from_file = _environment("--tle", str(file))
    assert isinstance(from_file.orbit, Sgp4Orbit)
    assert isinstance(from_file.motion, EarthPointing)
    assert from_file.epoch_jyear == pytest.approx(2019.94, abs=0.01)
    place_km, _ = from_file.orbit.state(100.0)
    assert from_file.motion.at(100.0).cam_from_icrs[2] == pytest.approx(place_km / np.linalg.norm(place_km), abs=1e-12)
    higher = _environment("--altitude-km", "800", "--inclination-deg", "51.6", "--raan-deg", "10")
    assert higher.motion == Zenith(800.0, float(np.radians(51.6)), float(np.radians(10)))
    down = _environment("--mounting", "nadir")
    assert down.earth_angle_rad(0.0) < -1.0
    tilted = _environment("--roll-pitch-yaw", "5,0,0")
    cosine = tilted.motion.at(0.0).cam_from_icrs[2] @ Zenith().at(0.0).cam_from_icrs[2]
    assert np.degrees(np.arccos(cosine)) == pytest.approx(5.0)


def test_every_fault_has_its_option() -> None:
    """Each fault option sets the rate of both directions. The delay is in milliseconds."""
    options = (
        "--bit-error-rate 1e-5 --burst-rate 0.1 --drop-rate 0.2 --duplicate-rate 0.3 --stall-rate 0.4 --delay-ms 250"
    )
    expected = FaultRates(1e-5, 0.2, 0.3, 0.4, burst_rate=0.1, delay_s=0.25)
    world = _environment(*options.split())
    assert world.line.up.rates == world.line.down.rates == expected


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
    """An invalid option is rejected with the expected and the received value."""
    with pytest.raises(GssError, match=said) as caught:
        _environment(*options.split())
    assert caught.value.expected
    assert caught.value.got
