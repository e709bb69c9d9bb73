"""Training faults: each has its stated effect and end, and a real unit has no training commands."""

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
    """A real unit rejects all training commands as ``unknown_command``."""
    bench = make_bench(identity=Identity(simulated=False, line_baud=921_600))
    bench.until(lambda: bench.host.hello is not None)
    for command in bench.dictionary.commands:
        if command.simulator_only:
            update = bench.do(command.name)
            assert (update.stage, update.reason) == (Stage.REJECTED, "unknown_command")
    assert bench.status()["training_faults"] == 0


def test_a_stuck_sensor_repeats_its_image_and_is_detected(bench: Bench) -> None:
    """A stuck sensor returns the same pixels with a new frame number, which the unit reports as IMAGE_REPEATED. After the
    fault, images differ again."""
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
    """After the fault the golden bank fails verification. For an empty bank the fault is rejected."""
    done = bench.do("SIM_INJECT", fault="bank_corruption", value=bank)
    if bank == 3:
        assert bench.do("VERIFY_BANK", bank="golden").reason == "bank_corrupt"
        assert bench.do("RUN_ITERATION").values["outcome"] == "none"
        assert bench.device_events("BANK_CORRUPT")
    else:
        assert (done.stage, done.reason) == (Stage.FAILED, "bank_empty")


def test_a_second_bank_corruption_does_not_repair_the_first(bench: Bench) -> None:
    """Two corruptions without a frame between them flip different bits."""
    intact = bench.memory.content("golden")
    for _ in range(2):
        bench.do("SIM_INJECT", fault="bank_corruption", value=3)
    assert bench.memory.content("golden") != intact
    assert bench.do("VERIFY_BANK", bank="golden").reason == "bank_corrupt"


def test_a_flash_failure_ends_the_upload_with_its_reason(bench: Bench) -> None:
    """An upload with a flash failure ends with ``flash_error`` and an event, and nothing is committed. A second upload
    succeeds."""
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
    """During the fault, iterations continue while the attitude does not change and its age increases. Afterwards it is
    updated again."""
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
    """A fault without a size, which the form sends as 0, has the default size."""
    before = float(bench.status()["sensor_temperature_c"])
    bench.do("SIM_INJECT", fault="overheat")
    bench.run(2.0)
    assert float(bench.status()["sensor_temperature_c"]) == pytest.approx(before + 30.0, abs=2.0)


def test_the_clock_drifts_and_jumps(bench: Bench) -> None:
    """A clock drift of 10 000 ppm adds 0.2 s in 20 s. A jump is reported, and time does not become negative."""

    def error_s() -> float:
        return bench.device.time_s - bench.device.sky_s

    bench.do("SIM_INJECT", fault="clock_drift", value=10_000.0)
    bench.run(20.0)
    assert error_s() == pytest.approx(0.2, abs=0.01)
    bench.do("SIM_INJECT", fault="none")
    drift_s = error_s()
    bench.run(5.0)
    assert error_s() == pytest.approx(drift_s, abs=1e-9)
    bench.do("SIM_INJECT", fault="clock_jump", value=500.0)
    assert error_s() == pytest.approx(drift_s + 500.0, abs=1e-6)
    assert bench.device_events("CLOCK_JUMP")[-1].text == "+500.0 s"
    bench.do("SIM_INJECT", fault="clock_jump", value=-100_000.0)
    assert 0 <= bench.device.time_s < 5.0
    assert bench.do("RUN_ITERATION").values["outcome"] == "solved"


def test_the_sky_does_not_follow_a_wrong_clock(bench: Bench) -> None:
    """A clock jump does not change the imaged part of the sky."""
    bench.do("SIM_SET_SKY", motion="slew", ra_deg=84.0, dec_deg=5.0, rate_deg_s=0.1)
    bench.do("SIM_INJECT", fault="clock_jump", value=1000.0)
    bench.do("TAKE_IMAGE")
    truth = bench.telemetry("frame_truth")[-1].values
    ra = np.radians([float(truth["ra_deg"]), 84.0])
    dec = np.radians([float(truth["dec_deg"]), 5.0])
    separation_rad = np.arccos(np.sin(dec).prod() + np.cos(dec).prod() * np.cos(ra[0] - ra[1]))
    assert np.degrees(separation_rad) < 1.0


@pytest.mark.parametrize("fault", ["blinded", "false_stars"])
def test_disturbed_images_give_no_false_attitude(bench: Bench, fault: str) -> None:
    """A blinded frame gives no attitude. With false stars there is a correct attitude or none."""
    bench.do("SIM_INJECT", fault=fault, value=40.0 if fault == "false_stars" else 0.0)
    for _ in range(5):
        solved = bench.do("RUN_ITERATION").values["outcome"] == "solved"
        assert not (solved and fault == "blinded")
        if solved:
            attitude, truth = bench.telemetry("attitude")[-1].values, bench.telemetry("frame_truth")[-1].values
            errors_deg = [abs(float(attitude[n]) - float(truth[n])) for n in ("ra_deg", "dec_deg")]
            assert max(errors_deg) < 0.1


def test_a_watchdog_reset_happens_immediately(bench: Bench) -> None:
    """The unit reports the command as completed, then restarts and reports the reset cause."""
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
    """A fault with an invalid size is rejected as ``out_of_range``, and no fault is active."""
    update = bench.do("SIM_INJECT", fault=fault, value=value)
    assert (update.stage, update.reason) == (Stage.FAILED, "out_of_range")
    assert bench.status()["training_faults"] == 0


def test_the_line_is_disturbed_and_disconnected_through_its_control(bench: Bench) -> None:
    """SIM_SET_LINE and SIM_DISCONNECT change the faults of the simulated line. The command's delay is in milliseconds."""
    line = bench.tracker.sky.environment.line
    done = bench.do("SIM_SET_LINE", direction="down", bit_error_rate=1e-5, drop_rate=0.25, delay_ms=250)
    assert done.stage is Stage.COMPLETED
    assert (line.down.rates.bit_error_rate, line.down.rates.drop_rate, line.down.rates.delay_s) == (1e-5, 0.25, 0.25)
    assert line.up.rates.bit_error_rate == 0.0
    assert bench.do("SIM_DISCONNECT", duration_s=3.0).stage is Stage.COMPLETED
    start_s = bench.now_s
    assert [line.connected(start_s + dt) for dt in (0.0, 0.1, 0.3, 3.1, 3.3)] == [True, True, False, False, True]
    assert line.disconnects == 1


@pytest.mark.parametrize("motion", ["orbit", "inertial", "slew", "tumble", "earth_fixed"])
def test_the_sky_points_where_the_instructor_commands(bench: Bench, motion: str) -> None:
    """The next image has the commanded direction, or the zenith in orbit, and the commanded rate."""
    bench.do("SIM_SET_SKY", motion=motion, ra_deg=200.0, dec_deg=-30.0, roll_deg=45.0, rate_deg_s=0.2)
    start, later = (bench.tracker.sky.environment.motion.at(t).cam_from_icrs for t in (bench.now_s, bench.now_s + 1.0))
    rate = np.degrees(np.linalg.norm(start - later) / np.sqrt(2))  # small angle, |A - B| of two rotations
    expected = {"orbit": 0.062, "inertial": 0.0, "slew": 0.2, "tumble": 0.2, "earth_fixed": 0.00418}[motion]
    assert rate == pytest.approx(expected, rel=0.05, abs=1e-6)
    bench.do("TAKE_IMAGE")
    truth = bench.telemetry("frame_truth")[-1].values
    if motion != "orbit":
        assert float(truth["ra_deg"]) == pytest.approx(200.0, abs=1.0)
        assert float(truth["dec_deg"]) == pytest.approx(-30.0, abs=1.0)


def test_a_plan_runs_automatically(bench: Bench) -> None:
    """Planned faults start at their times and end automatically, with an event each."""
    start = bench.device.sky_s
    lasting = tuple(PlannedFault(start + 8.0 * k, fault, 20.0, 10.0) for k, fault in enumerate(LASTING, 1))
    plan = (*lasting, PlannedFault(start + 60.0, "clock_jump", 10.0))
    bench.device.training.plan(plan)
    bench.run(100.0)
    texts = [e.text for e in bench.device_events("TRAINING")]
    assert sum(not t.endswith("ended") for t in texts) == len(plan)
    assert bench.status()["training_faults"] == 0
