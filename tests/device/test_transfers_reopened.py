"""Transfers that are opened again: with another chunk size, after a reset, and after they were committed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.device.table_use import calibration_values
from gss.device.tables import encode_table

if TYPE_CHECKING:
    from conftest import Bench


def facts(bench: Bench) -> Compatibility:
    return Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1, 2025.0)


def stored(bench: Bench, transfer_id: int) -> int:
    return bench.host.transfer(transfer_id).stored_bytes


@pytest.mark.parametrize("reset", [True, False])
def test_an_upload_continues_in_smaller_chunks(bench: Bench, reset: bool) -> None:
    """An upload opened again with smaller chunks keeps the stored ones, also after a reset, and sends only the others."""
    image = bench.memory.content("golden")
    first = bench.host.transfers.start_upload("catalogue", 1, image, facts(bench), chunk_bytes=1024)
    bench.until(lambda: stored(bench, first) > len(image) // 2)
    bench.host.transfers.pause(first)
    bench.run(0.5)
    if reset:
        bench.device.reset("watchdog", bench.now_s)
        bench.run(1.0)
    before = bench.host.counters.sent.bytes
    second = bench.host.transfers.start_upload("catalogue", 1, image, facts(bench), chunk_bytes=128)
    bench.transfer_ends(second, "committed")
    end = bench.host.transfer(second)
    assert end.resumed is True
    assert bench.memory.content("B") == image
    assert bench.host.counters.sent.bytes - before < 0.75 * len(image)


def test_a_table_upload_survives_a_reset(bench: Bench) -> None:
    """After a reset a table upload continues with the chunks in flash. The incomplete table cannot be activated."""
    table = encode_table("calibration", "cubestar", calibration_values(bench.tracker.profile))
    first = bench.host.transfers.start_upload("calibration", 0, table, facts(bench), chunk_bytes=16)
    bench.until(lambda: stored(bench, first) > 100)
    bench.host.transfers.pause(first)
    bench.run(0.2)
    bench.device.reset("watchdog", bench.now_s)
    bench.run(1.0)
    assert bench.memory.record.banks["calibration.A"].state == "loading"
    assert bench.do("ACTIVATE_TABLE", table="calibration", bank="A").reason == "bank_empty"
    bench.host.transfers.resume(first)
    bench.transfer_ends(first, "committed")
    assert bench.host.transfer(first).resumed is True
    assert bench.memory.content("calibration.A") == table
    assert bench.do("VERIFY_TABLE", table="calibration", bank="A").stage is Stage.COMPLETED


def test_a_committed_image_is_not_stored_twice(bench: Bench) -> None:
    """A second upload of the same pixels to the same slot completes without a new frame and keeps the frame number."""
    bench.do("TAKE_IMAGE", slot=0)
    pixels = bench.tracker.slots[0].data
    first = bench.host.transfers.start_upload("image", 1, pixels, facts(bench))
    bench.transfer_ends(first, "committed")
    frames, number = bench.memory.record.frames, bench.tracker.slots[1].number
    second = bench.host.transfers.start_upload("image", 1, pixels, facts(bench))
    bench.transfer_ends(second, "committed")
    assert bench.memory.record.frames == frames
    assert bench.tracker.slots[1].number == number
    assert bench.do("FIND_CENTROIDS", slot=1).values["frame_number"] == number


def test_an_uploaded_image_is_solved_like_one_that_was_taken(bench: Bench) -> None:
    """The pixels of a captured image give the same attitude when they are uploaded to another slot."""
    bench.do("RUN_ITERATION", slot=0)
    captured = bench.telemetry("attitude")[-1].values
    transfer_id = bench.host.transfers.start_upload("image", 2, bench.tracker.slots[0].data, facts(bench))
    bench.transfer_ends(transfer_id, "committed")
    bench.do("SET_MODE", mode="lost_in_space")
    for name in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
        assert bench.do(name, **({"slot": 2} if name == "FIND_CENTROIDS" else {})).stage is Stage.COMPLETED
    uploaded = bench.telemetry("attitude")[-1].values
    assert [uploaded[f"quaternion_{a}"] for a in "xyzw"] == [captured[f"quaternion_{a}"] for a in "xyzw"]
    assert uploaded["frame_number"] != captured["frame_number"]
