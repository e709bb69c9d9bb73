"""Simulated heads of one body derive their attitudes from the body's motion, their mountings and a common time zero."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.envelope.attitude import euler_123
from gss.device.simulator.environment import Environment
from gss.device.simulator.options import add_arguments, instrument_of, make_environment
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput, GssError, NotFound
from gss.domain.rotation import rotation_from_vector, vector_from_rotation

BODY = """time_zero: 2026-11-25T12:00:00Z
motion: {motion}
rate_deg_s: 0.1
heads:
  A: {{mounting_deg: [0, 0, 0]}}
  B: {{mounting_deg: [80, 0, 10], misalignment_arcsec: [60, 0, -20], drift_arcsec_h: [0, 36, 0]}}
"""
ZERO_UTC_S = 1_795_608_000.0  # 2026-11-25T12:00:00Z


def head(file: Path, name: str, utc_at_zero_s: float, *more: str) -> Environment:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    arguments = parser.parse_args(["--instrument", "cubestar", "--body", str(file), "--head", name, *more])
    instrument = instrument_of(arguments)
    return make_environment(arguments, instrument.profile, instrument, utc_at_zero_s)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "body.yaml"
    path.write_text(BODY.format(motion="tumble"))
    return path


@pytest.mark.parametrize("motion", ["inertial", "slew", "tumble", "orbit"])
def test_two_heads_share_attitude_and_time(file: Path, motion: str) -> None:
    """Simulators started at different times follow the same body. Their attitudes differ by the mounting and the
    misalignment at that time, and their rates are those of the body."""
    file.write_text(BODY.format(motion=motion))
    first, second = head(file, "A", ZERO_UTC_S), head(file, "B", ZERO_UTC_S + 1000.0)
    for utc_s in (3600.0, 7200.0):
        a, b = first.motion.at(utc_s), second.motion.at(utc_s - 1000.0)
        nominal = euler_123(np.radians([80, 0, 10]))
        misalignment = (b.cam_from_icrs @ a.cam_from_icrs.T).T @ nominal
        expected = np.array([60, 36 * utc_s / 3600, -20])
        assert vector_from_rotation(misalignment) / ARCSEC_RAD == pytest.approx(expected, abs=1e-6)
        assert b.rate_rad_s == pytest.approx(b.cam_from_icrs @ a.cam_from_icrs.T @ a.rate_rad_s, abs=1e-7)
        assert first.orbit.state(utc_s)[0] == pytest.approx(second.orbit.state(utc_s - 1000.0)[0])


def test_rate_of_a_head_is_that_of_its_attitude(file: Path) -> None:
    """The reported rate agrees with the change of the attitude."""
    motion = head(file, "B", ZERO_UTC_S).motion
    before, after = motion.at(100.0), motion.at(100.01)
    rotation = vector_from_rotation(after.cam_from_icrs @ before.cam_from_icrs.T)
    assert -rotation / 0.01 == pytest.approx(motion.at(100.005).rate_rad_s, abs=1e-8)
    assert rotation_from_vector(rotation) @ before.cam_from_icrs == pytest.approx(after.cam_from_icrs)


def test_training_returns_to_the_body(file: Path) -> None:
    """After an exercise changed the motion of one head, the motion "zenith" returns it to that of the body."""
    environment = head(file, "B", ZERO_UTC_S)
    expected = environment.motion.at(50.0).cam_from_icrs
    environment.set_motion("tumble", 10.0, rate_rad_s=0.1)
    environment.set_motion("zenith", 20.0)
    assert environment.motion.at(50.0).cam_from_icrs == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "more", "text", "error"),
    [
        ("C", (), None, "no such head"),
        ("A", ("--motion", "slew"), None, "the file of the body already states motion"),
        ("A", ("--speed", "2"), None, "need real time"),
        ("A", (), "time_zero: yesterday\nheads: {}\n", "body.yaml, line 1: time_zero"),
        ("A", (), "time_zero: 2026-11-25T12:00:00Z\nheads:\n  A: {mounting_deg: [0, 0]}\n", "line 3: heads.A"),
        ("A", (), "- 1\n", "body.yaml, line 1"),
    ],
)
def test_an_invalid_body_is_rejected(
    file: Path, name: str, more: tuple[str, ...], text: str | None, error: str
) -> None:
    """An invalid body file or option is rejected with place and reason."""
    if text is not None:
        file.write_text(text)
    with pytest.raises(GssError, match=error) as raised:
        head(file, name, ZERO_UTC_S, *more)
    assert isinstance(raised.value, BadInput | NotFound)


def test_a_missing_body_is_named(tmp_path: Path) -> None:
    """The error for a missing body file contains its name."""
    with pytest.raises(NotFound, match=r"none\.yaml"):
        head(tmp_path / "none.yaml", "A", ZERO_UTC_S)
