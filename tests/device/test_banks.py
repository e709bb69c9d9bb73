"""Catalogue banks on board: verification, trial activation, confirmation, fallback, erasure and corruption."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import DeviceEvent, Stage, Telemetry
from gss.device.session_transfer import Part
from gss.skytables.pairs import distance_table

if TYPE_CHECKING:
    from conftest import Bench

BANKS = {"A": 0, "B": 1, "C": 2, "golden": 3}


def load(bench: Bench, bank: str = "B", faint_mag: float = 3.6) -> bytes:
    """Upload a catalogue that is smaller than the factory catalogue. Return its image."""
    stars = load_stars(faint_mag)
    image = encode(stars, distance_table(stars, 0.0044, 1.0), "cubestar", "cubestar")
    facts = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1, 1991.25)
    transfer_id = bench.host.transfers.start_upload("catalogue", BANKS[bank], image, facts)
    bench.transfer_ends(transfer_id, "committed")
    return image


def events(bench: Bench) -> list[str]:
    return [e.name for e in bench.events if isinstance(e, DeviceEvent)]


def bank_info(bench: Bench, bank: str) -> Telemetry:
    return [t for t in bench.telemetry("bank_info") if t.values["bank"] == bank][-1]


def test_banks_are_listed_with_their_content(bench: Bench) -> None:
    """The device lists four banks with their content. The factory bank is active and write-protected."""
    assert bench.do("LIST_BANKS").values == {"count": 4}
    golden, empty = bank_info(bench, "golden").values, bank_info(bench, "A").values
    assert (golden["state"], golden["active"], golden["write_protected"]) == ("committed", True, True)
    assert (golden["stars"], golden["profile"], golden["format_version"]) == (411, "cubestar", 1)
    assert golden["sha256"] == bytes.fromhex(bench.memory.hash_of("golden"))
    assert (empty["state"], empty["size_bytes"], empty["sha256"]) == ("empty", 0, bytes(32))


def test_a_new_catalogue_changes_what_is_matched(bench: Bench) -> None:
    """After a smaller catalogue is uploaded, verified, activated and confirmed, fewer stars of the same frame are matched
    and the frame is still solved."""
    bench.do("TAKE_IMAGE")
    bench.do("FIND_CENTROIDS")
    bench.do("MATCH_STARS")
    before = bench.telemetry("matches")[-1].lists["items"]
    image = load(bench, faint_mag=3.0)
    verified = bench.do("VERIFY_BANK", bank="B")
    assert verified.values["sha256"] == bytes.fromhex(bench.memory.hash_of("B"))
    assert bench.do("ACTIVATE_BANK", bank="B").stage is Stage.COMPLETED
    assert bench.do("CONFIRM_BANK", bank="B").stage is Stage.COMPLETED
    bench.do("SET_MODE", mode="lost_in_space")
    bench.do("FIND_CENTROIDS")
    bench.do("MATCH_STARS")
    after = bench.telemetry("matches")[-1].lists["items"]
    assert len(after) < len(before)
    assert bench.do("CALCULATE_ATTITUDE").values["outcome"] == "solved"
    bench.do("GET_STATUS")
    assert bench.host.housekeeping is not None
    assert bench.host.housekeeping["active_bank"] == "B"
    assert bench.host.housekeeping["catalogue_stars"] == len(load_stars(3.0))
    assert bench.memory.content("B") == image
    assert bench.host.transfer(1).state == "active"


def test_without_confirmation_the_old_bank_is_active_again(bench: Bench) -> None:
    """If a bank is not confirmed within the trial time, the device returns to the previous bank and sends an event."""
    load(bench)
    bench.do("ACTIVATE_BANK", bank="B", confirm_within_s=10)
    assert bench.memory.record.active == "B"
    bench.run(5.0)
    assert bench.host.housekeeping is not None
    assert 3 <= int(bench.host.housekeeping["confirm_left_s"]) <= 6
    bench.run(6.0)
    assert bench.memory.record.active == "golden"
    assert "BANK_FELL_BACK" in events(bench)
    assert len(bench.tracker.catalogue or ()) == 411
    assert bench.do("CONFIRM_BANK", bank="B").reason == "wrong_state"


def test_a_reset_during_the_trial_falls_back(bench: Bench) -> None:
    """A reset during the trial reactivates the previous bank, because the new catalogue may have caused it."""
    load(bench)
    bench.do("ACTIVATE_BANK", bank="B", confirm_within_s=600)
    bench.device.reset("watchdog", bench.now_s)
    bench.run(1.0)
    assert bench.memory.record.active == "golden"
    assert "BANK_FELL_BACK" in events(bench)


def test_a_confirmed_bank_survives_a_reset_and_can_be_rolled_back(bench: Bench) -> None:
    """A confirmed bank is still active after a reset. ROLLBACK_BANK returns to the previous bank."""
    load(bench)
    bench.do("ACTIVATE_BANK", bank="B")
    bench.do("CONFIRM_BANK", bank="B")
    bench.device.reset("watchdog", bench.now_s)
    bench.run(1.0)
    assert bench.memory.record.active == "B"
    assert bench.do("ROLLBACK_BANK").stage is Stage.COMPLETED
    assert bench.memory.record.active == "golden"


def test_a_corrupt_bank_is_detected_reported_and_not_used(bench: Bench) -> None:
    """After one bit flip, VERIFY_BANK and ACTIVATE_BANK fail with ``bank_corrupt``, and the device sends an event."""
    load(bench)
    bench.memory.flash.flip(bench.memory.offset("B") + 5000, 3)
    end = bench.do("VERIFY_BANK", bank="B")
    assert (end.stage, end.reason) == (Stage.FAILED, "bank_corrupt")
    assert bank_info(bench, "B").values["state"] == "corrupt"
    assert "BANK_CORRUPT" in events(bench)
    assert bench.do("ACTIVATE_BANK", bank="B").reason == "bank_corrupt"
    assert bench.memory.record.active == "golden"


def test_a_corrupt_active_bank_makes_matching_fail_with_the_reason(bench: Bench) -> None:
    """If the active bank is corrupt, matching fails and no attitude is reported until a rollback."""
    load(bench)
    bench.do("ACTIVATE_BANK", bank="B")
    bench.do("CONFIRM_BANK", bank="B")
    bench.do("TAKE_IMAGE")
    bench.do("FIND_CENTROIDS")
    bench.events.clear()
    bench.memory.flash.flip(bench.memory.offset("B") + 5000, 3)
    end = bench.do("MATCH_STARS")
    assert (end.stage, end.reason) == (Stage.FAILED, "bank_corrupt")
    assert "BANK_CORRUPT" in events(bench)
    iteration = bench.do("RUN_ITERATION")
    assert iteration.values["outcome"] == "none"
    assert "damaged" in str(bench.telemetry("attitude")[-1].values["reason"])
    bench.do("GET_STATUS")
    assert bench.host.housekeeping is not None
    assert bench.host.housekeeping["active_valid"] is False
    assert bench.do("ROLLBACK_BANK").stage is Stage.COMPLETED
    assert bench.do("MATCH_STARS").stage is Stage.COMPLETED


def test_a_failed_detection_has_no_centroids_of_another_frame(make_bench: Callable[..., Bench]) -> None:
    """If the detection of a frame fails, its attitude has no centroids, GET_CENTROIDS fails, and star windows are not cut at
    the stars of the previous frame."""
    bench = make_bench(camera="oersted")
    bench.until(lambda: bench.host.hello is not None)
    assert bench.do("RUN_ITERATION", slot=0).values["outcome"] == "solved"
    bench.do("SIM_INJECT", fault="bank_corruption", value=BANKS["golden"])
    number = bench.do("RUN_ITERATION", slot=0).values["frame_number"]
    attitude = bench.telemetry("attitude")[-1].values
    assert (attitude["frame_number"], attitude["centroids"]) == (number, 0)
    assert bench.do("GET_CENTROIDS").reason == "no_image"
    transfer_id = bench.host.transfers.start_download("star_windows", 0, part=Part(columns=9))
    assert "bank_corrupt" in bench.transfer_ends(transfer_id, "failed").reason


def test_the_active_and_the_fallback_bank_cannot_be_written_or_erased(bench: Bench) -> None:
    """The active bank, the golden bank and the fallback bank of a trial cannot be erased or written."""
    load(bench, "A")
    load(bench, "B")
    bench.do("ACTIVATE_BANK", bank="A")
    bench.do("CONFIRM_BANK", bank="A")
    bench.do("ACTIVATE_BANK", bank="B")
    for bank, reason in (("B", "bank_active"), ("A", "bank_active"), ("golden", "write_protected")):
        assert bench.do("ERASE_BANK", bank=bank).reason == reason
        transfer_id = bench.host.transfers.start_upload(
            "catalogue", BANKS[bank], b"x" * 100, Compatibility("", "", bytes(32))
        )
        assert bench.transfer_ends(transfer_id, "failed").reason.startswith(reason)
    assert bench.do("ACTIVATE_BANK", bank="golden").reason == "wrong_state"


def test_erase_empties_an_inactive_bank(bench: Bench) -> None:
    """After an erase, every byte is 0xFF, and the bank cannot be verified or activated."""
    load(bench, "C")
    assert bench.do("ERASE_BANK", bank="C").stage is Stage.COMPLETED
    assert (
        bench.memory.flash.read(bench.memory.offset("C"), bench.memory.bank_bytes) == b"\xff" * bench.memory.bank_bytes
    )
    assert bench.do("VERIFY_BANK", bank="C").reason == "bank_empty"
    assert bench.do("ACTIVATE_BANK", bank="C").reason == "bank_empty"


def test_a_bank_is_not_uploaded_while_it_is_activated(bench: Bench) -> None:
    """An upload that is opened while the same bank is read back does not change it, and the bank becomes active."""
    load(bench, "A")
    request_id = bench.host.submit(bench.host.encode("ACTIVATE_BANK", {"bank": "A", "confirm_within_s": 60}))
    bench.until(lambda: bench.stage(request_id) is Stage.STARTED)
    facts = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1)
    transfer_id = bench.host.transfers.start_upload("catalogue", 0, bench.memory.content("golden"), facts)
    bench.until(lambda: bench.stage(request_id) is Stage.COMPLETED)
    bench.transfer_ends(transfer_id, "failed")
    assert (bench.memory.record.active, bench.memory.record.banks["A"].state) == ("A", "committed")


def test_activation_needs_a_stopped_cycle(bench: Bench) -> None:
    """The device rejects ACTIVATE_BANK while the cycle runs."""
    load(bench)
    bench.do("START_CYCLE")
    assert bench.do("ACTIVATE_BANK", bank="B").reason == "wrong_state"


@pytest.mark.parametrize("offset", [0, 60, 64, 9000])
def test_any_flipped_bit_of_the_factory_bank_is_detected_at_boot(bench: Bench, offset: int) -> None:
    """After a bit flip in header or body, the device reports BANK_CORRUPT at boot and does not use the catalogue."""
    rng = np.random.default_rng(offset)
    bench.memory.flash.flip(bench.memory.offset("golden") + offset, int(rng.integers(8)))
    bench.device.reset("watchdog", bench.now_s)
    bench.run(1.0)
    assert "BANK_CORRUPT" in events(bench)
    assert bench.do("RUN_ITERATION").values["outcome"] == "none"
