"""The chain of rotations from inertial to sensor axes of Moniteq 1983 §6.2 equals the chain of the envelope."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gss.catalogue_tools.envelope.attitude import AttitudeLimits, euler_123, orbit_axes
from gss.domain.angles import Array

ANGLE = st.floats(-3.1, 3.1)


def t_oi(node: float, inclination: float) -> Array:
    """Eq. 6.1. The print has −cos i cos Ω as first element, which is not orthogonal; the product of its two factors is used."""
    c, s = np.cos(inclination), np.sin(inclination)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array(
        [[-np.sin(node), np.cos(node), 0], [0, 0, -1], [-np.cos(node), -np.sin(node), 0]]
    )


def t_bo(pitch: float, roll: float, yaw: float) -> Array:
    """Eq. 6.2: pitch, then roll, then yaw."""
    (ct, cf, cp), (st_, sf, sp) = np.cos([pitch, roll, yaw]), np.sin([pitch, roll, yaw])
    return np.array(
        [
            [cp * ct + sp * sf * st_, sp * cf, -cp * st_ + sp * sf * ct],
            [-sp * ct + cp * sf * st_, cp * cf, sp * st_ + cp * sf * ct],
            [cf * st_, -sf, cf * ct],
        ]
    )


def t_sb(azimuth: float, elevation: float) -> Array:
    """Eq. 6.3. The print lacks cos β in the last row, without which the row is not a unit vector."""
    (ca, cb), (sa, sb) = np.cos([azimuth, elevation]), np.sin([azimuth, elevation])
    return np.array([[-sa, ca, 0], [-ca * sb, -sa * sb, cb], [ca * cb, sa * cb, sb]])


@given(ANGLE, st.floats(0, 3.1), ANGLE, ANGLE, ANGLE, ANGLE, ANGLE, st.floats(-1.5, 1.5))
def test_the_chain_of_rotations_is_that_of_the_envelope(
    node: float,
    inclination: float,
    azimuth: float,
    pitch: float,
    roll: float,
    yaw: float,
    sensor_azimuth: float,
    sensor_elevation: float,
) -> None:
    """Eq. 6.4a with the nominal attitude θ = −H, changed by pitch, roll and yaw, equals mounting, Euler angles and orbit axes
    of the envelope. A pitch about the orbit normal is a smaller argument of latitude."""
    mounting = t_sb(sensor_azimuth, sensor_elevation)
    document = mounting @ t_bo(pitch - azimuth, roll, yaw) @ t_oi(node, inclination)
    limits = AttitudeLimits("nadir", body_from_cam=tuple(mounting.T.ravel()))
    latitude = azimuth - pitch
    axes = orbit_axes(np.array([node]), np.array([inclination]), np.array([latitude]))[0]
    ours = limits.cam_from_body @ euler_123(np.array([roll, 0.0, yaw])) @ axes
    assert ours == pytest.approx(document, abs=1e-12)
    assert document @ document.T == pytest.approx(np.eye(3), abs=1e-12)


def test_nominal_body_axes_are_nadir_and_velocity() -> None:
    """At the node with θ = −H = 0, body z points to the Earth's centre and body y against the orbit normal."""
    node, inclination = 0.7, 1.2
    body = t_bo(0.0, 0.0, 0.0) @ t_oi(node, inclination)
    assert body[2] == pytest.approx([-np.cos(node), -np.sin(node), 0.0], abs=1e-12)
    normal = [np.sin(node) * np.sin(inclination), -np.cos(node) * np.sin(inclination), np.cos(inclination)]
    assert body[1] == pytest.approx(-np.array(normal), abs=1e-12)
