"""Power of the unit: switching, latch-ups with their protection, and overheating."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage

if TYPE_CHECKING:
    from conftest import Bench

RAILS = ("imager", "fpga", "sram")


@pytest.mark.parametrize("rail", RAILS)
def test_without_power_no_image_is_taken(bench: Bench, rail: str) -> None:
    """TAKE_IMAGE, RUN_ITERATION and START_CYCLE are rejected while a rail is off. TAKE_IMAGE works after it is on again."""
    assert bench.do("POWER", rail=rail, state="off").stage is Stage.COMPLETED
    assert bench.status()[f"{rail}_on"] is False
    for name in ("TAKE_IMAGE", "RUN_ITERATION", "START_CYCLE"):
        update = bench.do(name)
        assert (update.stage, update.reason) == (Stage.REJECTED, "powered_off")
        assert rail in update.detail
    bench.do("POWER", rail=rail, state="on")
    assert bench.do("TAKE_IMAGE").stage is Stage.COMPLETED
    assert len(bench.device_events("POWER_CHANGED")) == 2


def test_image_memory_is_cleared_without_power(bench: Bench) -> None:
    """If the SRAM is switched off, frames are lost, commands that need it are rejected, and a running download ends with
    the reason."""
    bench.do("TAKE_IMAGE", slot=0)
    transfer_id = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(transfer_id).state == "transferring")
    bench.do("POWER", rail="sram", state="off")
    bench.until(lambda: bench.host.transfer(transfer_id).state in ("failed", "aborted"))
    assert "powered_off" in bench.host.transfer(transfer_id).reason
    assert bench.do("LIST_FRAMES").values == {"count": 0}
    assert bench.do("FIND_CENTROIDS").reason == "powered_off"
    assert bench.do("READ_MEMORY", area="sram").reason == "powered_off"
    bench.do("POWER", rail="sram", state="on")
    assert bench.do("FIND_CENTROIDS").reason == "no_image"


@pytest.mark.parametrize("rail", RAILS)
def test_a_latch_up_draws_current_until_the_protection_trips(bench: Bench, rail: str) -> None:
    """A latch-up raises the current above the critical limit until the protection switches the rail off, counts and
    reports it. Only CLEAR_LATCHUP restores the rail; POWER and a reset do not."""
    bench.do("START_CYCLE")
    bench.do("SIM_INJECT", fault=f"latchup_{rail}")
    current_field = next(f for f in bench.dictionary.packet("housekeeping").values if f.name == f"current_{rail}_ma")
    assert float(bench.status()[f"current_{rail}_ma"]) > float(current_field.limits.critical[1] or 0)
    bench.until(lambda: bool(bench.device_events("LATCHUP")), 5.0)
    tripped = bench.status()
    assert (tripped[f"{rail}_on"], tripped["latched_rails"], tripped["latchups"]) == (False, 1, 1)
    assert float(tripped[f"current_{rail}_ma"]) < 1.0
    assert tripped["cycle_running"] is False
    assert bench.do("POWER", rail=rail, state="on").reason == "wrong_state"
    bench.do("RESET")
    bench.run(1.0)
    assert bench.status()["latched_rails"] == 1
    assert bench.do("CLEAR_LATCHUP", rail=rail).stage is Stage.COMPLETED
    cleared = bench.status()
    assert (cleared[f"{rail}_on"], cleared["latched_rails"], cleared["latchups"]) == (True, 0, 1)
    assert [e.text for e in bench.device_events("LATCHUP_CLEARED")] == [rail]
    assert bench.do("TAKE_IMAGE").stage is Stage.COMPLETED


def test_a_rail_that_latches_while_it_is_switched_on_stays_off(bench: Bench) -> None:
    """If the protection trips while POWER is executed, POWER fails and the rail stays off until CLEAR_LATCHUP."""
    bench.do("SIM_INJECT", fault="latchup_imager")
    rail = bench.device.power.rails["imager"]
    trip_s = float(rail.short_since_s or 0.0) + bench.device.power._row.trip_s
    bench.until(lambda: bench.device.sky_s > trip_s - 0.08)
    update = bench.do("POWER", rail="imager", state="on")
    assert (update.stage, update.reason) == (Stage.FAILED, "wrong_state")
    assert (rail.on, rail.latched) == (False, True)


def test_clear_latchup_does_not_switch_on_a_rail_without_a_latch_up(bench: Bench) -> None:
    """A rail that POWER has switched off stays off after CLEAR_LATCHUP."""
    bench.do("POWER", rail="imager", state="off")
    assert bench.do("CLEAR_LATCHUP", rail="imager").stage is Stage.COMPLETED
    assert bench.status()["imager_on"] is False
    assert bench.device_events("LATCHUP_CLEARED") == []


def test_an_image_upload_ends_when_the_image_memory_loses_power(make_bench: Callable[..., Bench]) -> None:
    """An upload of an image ends with the reason when SRAM is switched off, also if no image is stored."""
    bench = make_bench(baud=115_200)
    bench.until(lambda: bench.host.hello is not None)
    image = bytes(bench.tracker.imager.upload_size)
    facts = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1)
    transfer_id = bench.host.transfers.start_upload("image", 1, image, facts)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 0)
    bench.do("POWER", rail="sram", state="off")
    assert "powered_off" in bench.transfer_ends(transfer_id, "failed").reason
    assert bench.tracker.slots == {}


def test_switching_off_in_time_ends_a_latch_up(bench: Bench) -> None:
    """Switching the rail off before the protection trips ends the latch-up, and none is counted."""
    bench.do("SIM_INJECT", fault="latchup_fpga")
    bench.do("POWER", rail="fpga", state="off")
    bench.run(3.0)
    assert bench.status()["latchups"] == 0
    assert bench.do("POWER", rail="fpga", state="on").stage is Stage.COMPLETED


def test_overheating_is_reported_once_until_it_has_cooled(bench: Bench) -> None:
    """Sensor and processor temperatures rise by the injected amount, and OVERHEAT is sent once. After cooling, the next
    overheating is reported again."""
    cold = bench.status()
    for round_ in (1, 2):
        bench.do("SIM_INJECT", fault="overheat", value=60.0)
        bench.run(3.0)
        hot = bench.status()
        for name in ("sensor_temperature_c", "processor_temperature_c"):
            assert float(hot[name]) - float(cold[name]) == pytest.approx(60.0, abs=12.0)
        assert len(bench.device_events("OVERHEAT")) == round_
        bench.do("SIM_INJECT", fault="none")
        bench.run(2.0)
        assert float(bench.status()["sensor_temperature_c"]) == pytest.approx(
            float(cold["sensor_temperature_c"]), abs=1
        )
