"""The attitude control emulator turns the simulated body by the matched vectors that the unit sends (Jacobs 1995 §3.4)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gss.catalogue_tools.envelope.attitude import BODY_FROM_CAM
from gss.device.simulator.attitude_control import ControlledBody
from gss.device.simulator.motion import EarthPointing
from gss.device.simulator.orbit import CircularOrbit
from gss.device.simulator.reports import Report, Row
from gss.instruments.dictionary.definitions import Value

if TYPE_CHECKING:
    from conftest import Bench

TARGET_RAD = np.radians([0.0, 0.0, 135.0])
START_RAD = np.radians([2.0, 0.0, 135.0])


def controlled(start_rad: NDArray[np.float64] = START_RAD, drift_rad_s: float = 0.0) -> ControlledBody:
    return ControlledBody(CircularOrbit(), BODY_FROM_CAM["sunsat"].T, TARGET_RAD, start_rad, drift_rad_s)


def vectors_of(body: ControlledBody) -> Report:
    """Return matched vectors along the three orbit axes, at the attitude of the start."""
    body_from_icrs = BODY_FROM_CAM["sunsat"] @ body.at(0.0).cam_from_icrs
    body_from_orbit = body_from_icrs @ EarthPointing(CircularOrbit(), np.eye(3)).at(0.0).cam_from_icrs.T
    items: list[Row] = [
        {f"body_{axis}": float(body_from_orbit[k, i]) for k, axis in enumerate("xyz")}
        | {f"orbit_{axis}": float(k == i) for k, axis in enumerate("xyz")}
        for i in range(3)
    ]
    return "matched_vectors", {"frame_number": 1, "frame_time_s": 0.0}, {"items": items}


def test_the_unit_closes_the_loop_with_its_vectors(make_bench: Callable[..., Bench]) -> None:
    """A body that is 0.9° from its target and drifts about each axis drifts until the unit has its first attitude. The
    matched vectors then reduce the error to less than a fifth in 25 s."""
    bench = make_bench(camera="sunsat")
    bench.until(lambda: bench.host.hello is not None)
    body = controlled(np.radians([0.5, -0.5, 135.5]), float(np.radians(0.01)))
    bench.tracker.sky.environment.motion = body
    bench.do("SET_TIME", utc_s=1.8e9)
    bench.do("SET_ORBIT", raan_deg=84.0, inclination_deg=97.8, latitude_deg=0.0, altitude_km=600.0, epoch_s=0.0)
    at_start_rad = body.error_rad(0.0)
    bench.do("RUN_ITERATION", seconds=70)
    first = bench.telemetry("matched_vectors")[-1]
    drifted_rad = body.error_rad(bench.device.sky_s)
    assert len(first.lists["items"]) >= 3
    assert abs(drifted_rad - at_start_rad) > np.radians(0.02)
    bench.do("SET_MODE", mode="tracking")
    bench.do("START_CYCLE")
    bench.run(25.0)
    assert body.error_rad(bench.device.sky_s) < drifted_rad / 5


def test_without_vectors_the_body_keeps_drifting() -> None:
    """Packets without vectors, with an old frame or of another kind give no command."""
    body = controlled(TARGET_RAD, 1e-4)
    values: dict[str, Value] = {"frame_number": 1, "frame_time_s": 5.0}
    body.receive(("matched_vectors", values, {"items": []}), 6.0)
    body.receive(("attitude", values, {}), 6.0)
    assert body.error_rad(40.0) == pytest.approx(np.sqrt(3) * 40e-4, rel=1e-9)


def test_a_command_begins_after_one_period_is_limited_and_expires() -> None:
    """The rate begins one second after the vectors are received, is at most 0.1°/s about each axis, is the derivative of
    the attitude, and ends three seconds later. The vectors of the same frame give one command."""
    body = controlled()
    body.receive(vectors_of(body), 10.0)
    errors_deg = np.degrees([body.error_rad(t) for t in (9.0, 10.9, 12.0, 13.0, 14.0, 30.0)])
    # With a yaw of 135°, a roll of 2° is an error about the body axes x and y, which both turn at the limit.
    turned_deg = 0.1 * np.sqrt(2) * np.array([0, 0, 1, 2, 3, 3])
    assert errors_deg == pytest.approx(2.0 - turned_deg, abs=1e-9)
    before, now, after = (body.at(12.0 + d) for d in (-0.01, 0.0, 0.01))
    derivative = Rotation.from_matrix(after.cam_from_icrs @ before.cam_from_icrs.T).as_rotvec() / 0.02
    assert -derivative == pytest.approx(now.rate_rad_s, abs=1e-7)
    body.receive(vectors_of(body), 40.0)
    assert np.degrees(body.error_rad(42.0)) == pytest.approx(errors_deg[-1])
