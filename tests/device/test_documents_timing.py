"""Times and currents of the simulated units agree with their documents."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.simulator.power import Activity, Power
from gss.instruments.package_files import SimulatorFile
from gss.instruments.registry import shipped_registry

if TYPE_CHECKING:
    from conftest import Bench


def _unit(name: str) -> SimulatorFile:
    return shipped_registry().get(name).simulator or SimulatorFile()


def test_cubestar_draws_the_currents_of_table_6_2() -> None:
    """CubeStar draws 71.2 mA idle, 121.2 mA starting the imager, 177.3 mA exposing and processing, and 81.8 mA copying.
    The average power of a one-second cycle is 396 mW (eq. 6.3.1)."""
    power, total_ma = Power(_unit("cubestar").power), {}
    for activity in Activity:
        values = power.values(0.0, activity, 12.0)
        total_ma[activity] = sum(float(str(v)) for k, v in values.items() if k.startswith("current_")) / 10
    assert total_ma[Activity.IDLE] == pytest.approx(71.2)
    assert total_ma[Activity.STARTING] == pytest.approx(121.2)
    assert total_ma[Activity.BUSY] == pytest.approx(177.3)
    assert total_ma[Activity.COPYING] == pytest.approx(81.8)
    times_s = {Activity.IDLE: 0.14, Activity.STARTING: 0.068, Activity.BUSY: 0.388, Activity.COPYING: 0.404}
    assert 3.3 * sum(total_ma[a] * t for a, t in times_s.items()) == pytest.approx(396.2, rel=0.01)


def _bench(make_bench: Callable[..., Bench], name: str) -> Bench:
    bench = make_bench(camera=name, timing=_unit(name).timing)
    bench.until(lambda: bench.host.hello is not None)
    return bench


def test_cubestar_captures_in_one_frame_period(make_bench: Callable[..., Bench]) -> None:
    """An exposure takes the next longer frame period of the rolling-shutter imager, and the readout 67.7 ms (app. D)."""
    imager = make_bench(timing=_unit("cubestar").timing).tracker.imager
    captured_ms = [imager.capture_ms(ms) - imager.readout_ms for ms in (50, 90, 250, 386, 387, 450)]
    assert captured_ms == pytest.approx([90, 90, 300, 386, 450, 450])
    assert imager.readout_ms == pytest.approx(67.69, abs=0.01)
    assert imager.longest_ms(1000) == 386
    assert imager.middle_s(0.0, 386) == pytest.approx(0.193 + 0.0338, abs=1e-4)


def test_a_continuously_integrating_detector_can_expose_the_whole_period(make_bench: Callable[..., Bench]) -> None:
    """Sunsat reads an image out during the next exposure, so it can expose one second per second (Jacobs 1995 §4.2)."""
    bench = _bench(make_bench, "sunsat")
    imager = bench.tracker.imager
    assert imager.longest_ms(1000) == 1000
    assert imager.capture_ms(1000) == pytest.approx(1080, abs=0.1)
    bench.do("START_CYCLE")
    bench.run(5.0)
    frames = bench.telemetry("frame_info")
    assert {frame.values["exposure_ms"] for frame in frames} == {500}
    assert frames


def test_aim_updates_every_four_seconds(make_bench: Callable[..., Bench]) -> None:
    """AIM takes a frame every 4 s with an exposure of 2 s, the values at power-on (Moniteq 1983 Table 7.3)."""
    bench = _bench(make_bench, "aim")
    assert bench.status()["period_ms"] == 4000
    bench.do("START_CYCLE")
    bench.run(13.0)
    times_s = [float(t.values["frame_time_s"]) for t in bench.telemetry("frame_info")]
    assert np.diff(times_s) == pytest.approx(4.0, abs=0.02)
    assert {t.values["exposure_ms"] for t in bench.telemetry("frame_info")} == {2000}
