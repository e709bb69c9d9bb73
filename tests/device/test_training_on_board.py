"""Injected training faults: each has its stated effect and end, and a real unit has none of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.device.simulator.machine import Identity
from gss.device.simulator.training import LASTING, PlannedFault

if TYPE_CHECKING:
    from conftest import Bench


def test_a_real_unit_has_no_training_commands(make_bench: Callable[..., Bench]) -> None:
    """unknown_command for all of them."""
    bench = make_bench(identity=Identity(simulated=False, line_baud=921_600))
    bench.until(lambda: bench.host.hello is not None)
    for command in bench.dictionary.commands:
        if command.simulator_only:
            refused = bench.do(command.name)
            assert (refused.stage, refused.reason) == (Stage.REJECTED, "unknown_command")
    assert bench.status()["training_faults"] == 0


def test_a_stuck_sensor_repeats_its_image_and_is_detected(bench: Bench) -> None:
    """The same pixels with another number; IMAGE_REPEATED; after the fault images differ again."""
    bench.do("TAKE_IMAGE", slot=0)
    assert bench.device_events("IMAGE_REPEATED") == []
    bench.do("SIM_INJECT", fault="stuck_sensor", duration_s=10.0)
    assert bench.status()["training_faults"] == 1
    bench.do("TAKE_IMAGE", slot=1)
    first, second = bench.tracker.slots[0], bench.tracker.slots[1]
    assert (first.pixels == second.pixels).all()
    assert second.number == first.number + 1
    assert len(bench.device_events("IMAGE_REPEATED")) == 1
    bench.run(10.0)
    assert bench.status()["training_faults"] == 0
    bench.do("TAKE_IMAGE", slot=2)
    assert not (first.pixels == bench.tracker.slots[2].pixels).all()
    assert [e.text for e in bench.device_events("TRAINING")][-1] == "stuck_sensor ended"


@pytest.mark.parametrize("bank", [3, 0])
def test_bank_corruption_flips_bits_of_stored_data(bench: Bench, bank: int) -> None:
    """The golden bank fails verification; an empty one has no data to change."""
    done = bench.do("SIM_INJECT", fault="bank_corruption", value=bank)
    if bank == 3:
        assert bench.do("VERIFY_BANK", bank="golden").reason == "bank_corrupt"
        assert bench.do("RUN_ITERATION").values["outcome"] == "none"
        assert bench.device_events("BANK_CORRUPT")
    else:
        assert (done.stage, done.reason) == (Stage.FAILED, "bank_empty")


def test_a_flash_failure_ends_the_upload_with_its_reason(bench: Bench) -> None:
    """flash_error, FLASH_ERROR, nothing committed; a second upload works."""
    image = bench.memory.content("golden")
    facts = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1, 2025.0)
    bench.do("SIM_INJECT", fault="flash_failure")
    first = bench.host.transfers.start_upload("catalogue", 0, image, facts)
    bench.until(lambda: bench.host.transfer(first).state in ("failed", "aborted"))
    assert "flash_error" in bench.host.transfer(first).reason
    assert len(bench.device_events("FLASH_ERROR")) == 1
    assert bench.memory.record.banks["A"].state == "empty"
    second = bench.host.transfers.start_upload("catalogue", 0, image, facts)
    assert bench.transfer_ends(second, "committed").state == "committed"


def test_a_stale_attitude_ages_while_iterations_continue(bench: Bench) -> None:
    """Iterations count, the attitude does not change, its age increases; after the fault it is updated."""
    bench.do("START_CYCLE")
    bench.run(4.0)
    bench.do("SIM_INJECT", fault="stale_attitude")
    last = bench.tracker.quaternion
    before = bench.status()
    bench.run(5.0)
    after = bench.status()
    assert int(after["iteration"]) >= int(before["iteration"]) + 4
    assert float(after["attitude_age_s"]) >= float(before["attitude_age_s"]) + 4
    assert bench.tracker.quaternion is last
    assert bench.telemetry("attitude")[-1].values["reason"] == "the attitude is not updated"
    bench.do("SIM_INJECT", fault="none")
    bench.run(4.0)
    assert float(bench.status()["attitude_age_s"]) < 3.0


def test_a_fault_without_a_size_has_the_default_one(bench: Bench) -> None:
    """The form offers 0: it must have an effect and report its size."""
    before = float(bench.status()["sensor_temperature_c"])
    bench.do("SIM_INJECT", fault="overheat")
    bench.run(2.0)
    assert float(bench.status()["sensor_temperature_c"]) == pytest.approx(before + 30.0, abs=2.0)


def test_the_clock_drifts_and_jumps(bench: Bench) -> None:
    """A thousand parts per million are a millisecond per second; a jump is reported, and time does not become negative."""

    def error_s() -> float:
        return bench.device.time_s - bench.device.sky_s

    bench.do("SIM_INJECT", fault="clock_drift", value=10_000.0)
    bench.run(20.0)
    assert error_s() == pytest.approx(0.2, abs=0.01)
    bench.do("SIM_INJECT", fault="none")
    kept = error_s()
    bench.run(5.0)
    assert error_s() == pytest.approx(kept, abs=1e-9)
    bench.do("SIM_INJECT", fault="clock_jump", value=500.0)
    assert error_s() == pytest.approx(kept + 500.0, abs=1e-6)
    assert bench.device_events("CLOCK_JUMP")[-1].text == "+500.0 s"
    bench.do("SIM_INJECT", fault="clock_jump", value=-100_000.0)
    assert 0 <= bench.device.time_s < 5.0
    assert bench.do("RUN_ITERATION").values["outcome"] == "solved"


def test_the_sky_does_not_follow_a_wrong_clock(bench: Bench) -> None:
    """A jump changes the frame's time, not the imaged sky."""
    bench.do("SIM_SET_SKY", motion="slew", ra_deg=84.0, dec_deg=5.0, rate_deg_s=0.1)
    bench.do("SIM_INJECT", fault="clock_jump", value=1000.0)
    bench.do("TAKE_IMAGE")
    truth = bench.telemetry("frame_truth")[-1].values
    ra = np.radians([float(truth["ra_deg"]), 84.0])
    dec = np.radians([float(truth["dec_deg"]), 5.0])
    away = np.arccos(np.sin(dec).prod() + np.cos(dec).prod() * np.cos(ra[0] - ra[1]))
    assert np.degrees(away) < 1.0


@pytest.mark.parametrize("fault", ["blinded", "false_stars"])
def test_disturbed_images_give_no_false_attitude(bench: Bench, fault: str) -> None:
    """Saturated: none. False stars: right or none."""
    bench.do("SIM_INJECT", fault=fault, value=40.0 if fault == "false_stars" else 0.0)
    for _ in range(5):
        solved = bench.do("RUN_ITERATION").values["outcome"] == "solved"
        assert not (solved and fault == "blinded")
        if solved:
            attitude, truth = bench.telemetry("attitude")[-1].values, bench.telemetry("frame_truth")[-1].values
            off = [abs(float(attitude[n]) - float(truth[n])) for n in ("ra_deg", "dec_deg")]
            assert max(off) < 0.1


def test_a_watchdog_reset_happens_at_once(bench: Bench) -> None:
    """The report is still sent; then the unit restarts and reports the reason."""
    assert bench.do("SIM_INJECT", fault="reset").stage is Stage.COMPLETED
    bench.run(1.0)
    status = bench.status()
    assert (status["reset_cause"], status["resets"]) == ("watchdog", 1)


@pytest.mark.parametrize(
    ("fault", "value"),
    [
        ("bank_corruption", 4),
        ("bank_corruption", -1),
        ("overheat", 151),
        ("clock_drift", 2e5),
        ("false_stars", -1),
        ("false_stars", 501),
    ],
)
def test_faults_of_impossible_size_are_rejected(bench: Bench, fault: str, value: float) -> None:
    """out_of_range, and no fault is active."""
    refused = bench.do("SIM_INJECT", fault=fault, value=value)
    assert (refused.stage, refused.reason) == (Stage.FAILED, "out_of_range")
    assert bench.status()["training_faults"] == 0


def test_the_line_is_disturbed_and_disconnected_through_its_control(bench: Bench) -> None:
    """SIM_SET_LINE and SIM_DISCONNECT reach the line's own faults; delay is in milliseconds on the wire."""
    line = bench.tracker.sky.environment.line
    done = bench.do("SIM_SET_LINE", direction="down", bit_error_rate=1e-5, drop_rate=0.25, delay_ms=250)
    assert done.stage is Stage.COMPLETED
    assert (line.down.rates.bit_error_rate, line.down.rates.drop_rate, line.down.rates.delay_s) == (1e-5, 0.25, 0.25)
    assert line.up.rates.bit_error_rate == 0.0
    assert bench.do("SIM_DISCONNECT", duration_s=3.0).stage is Stage.COMPLETED
    at_s = bench.now_s
    assert [line.connected(at_s + dt) for dt in (0.0, 0.1, 0.3, 3.1, 3.3)] == [True, True, False, False, True]
    assert line.disconnects == 1


@pytest.mark.parametrize("motion", ["orbit", "inertial", "slew", "tumble", "earth_fixed"])
def test_the_sky_points_where_the_instructor_commands(bench: Bench, motion: str) -> None:
    """The next image shows the commanded direction (in orbit: the zenith) and rotation."""
    bench.do("SIM_SET_SKY", motion=motion, ra_deg=200.0, dec_deg=-30.0, roll_deg=45.0, rate_deg_s=0.2)
    then, later = (bench.tracker.sky.environment.motion.at(t).cam_from_icrs for t in (bench.now_s, bench.now_s + 1.0))
    rate = np.degrees(np.linalg.norm(then - later) / np.sqrt(2))  # small angle, |A - B| of two rotations
    expected = {"orbit": 0.062, "inertial": 0.0, "slew": 0.2, "tumble": 0.2, "earth_fixed": 0.00418}[motion]
    assert rate == pytest.approx(expected, rel=0.05, abs=1e-6)
    bench.do("TAKE_IMAGE")
    truth = bench.telemetry("frame_truth")[-1].values
    if motion != "orbit":
        assert float(truth["ra_deg"]) == pytest.approx(200.0, abs=1.0)
        assert float(truth["dec_deg"]) == pytest.approx(-30.0, abs=1.0)


def test_a_plan_runs_automatically(bench: Bench) -> None:
    """Planned faults start at their times and end automatically."""
    start = bench.device.sky_s
    lasting = tuple(PlannedFault(start + 8.0 * k, fault, 20.0, 10.0) for k, fault in enumerate(LASTING, 1))
    plan = (*lasting, PlannedFault(start + 60.0, "clock_jump", 10.0))
    bench.device.training.plan(plan)
    bench.run(100.0)
    texts = [e.text for e in bench.device_events("TRAINING")]
    assert sum(not t.endswith("ended") for t in texts) == len(plan)
    assert bench.status()["training_faults"] == 0
