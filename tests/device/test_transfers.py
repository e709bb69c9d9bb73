"""Transfers in both directions, with errors, interruptions and resets, with simulated time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import DeviceEvent, Stage, TransferDone
from gss.device.session_transfer import HeldPart
from gss.device.simulator.faults import FaultRates
from gss.device.simulator.images import thumbnail
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.skytables.pairs import distance_table

if TYPE_CHECKING:
    from conftest import Bench

B, C, GOLDEN = 1, 2, 3


def small_catalogue() -> bytes:
    stars = load_stars(3.4)
    return encode(stars, distance_table(stars, 0.01, np.radians(40)), "cubestar", "cubestar")


def compatible(bench: Bench, **changes: object) -> Compatibility:
    facts: dict[str, object] = {
        "device_model": bench.dictionary.device_model,
        "profile": "cubestar",
        "dictionary_hash": bench.dictionary.hash,
        "format_version": 1,
        "epoch_jyear": 1991.25,
    }
    return Compatibility(**(facts | changes))  # type: ignore[arg-type]


def upload(bench: Bench, bank: int, data: bytes) -> int:
    return bench.host.transfers.start_upload("catalogue", bank, data, compatible(bench))


def done(bench: Bench, transfer_id: int) -> TransferDone:
    (end,) = [e for e in bench.events if isinstance(e, TransferDone) and e.transfer_id == transfer_id]
    return end


@pytest.mark.parametrize("baud", [115_200, 921_600])
def test_a_frame_is_downloaded_at_nearly_the_line_s_rate(make_bench: Callable[..., Bench], baud: int) -> None:
    """A frame is downloaded without error at 92 % of the line's rate or more, with its number and hash."""
    bench = make_bench(baud=baud)
    bench.until(lambda: bench.host.hello is not None)
    number = bench.do("TAKE_IMAGE").values["frame_number"]
    start_s = bench.now_s
    transfer_id = bench.host.transfers.start_download("frame", 0)
    update = bench.transfer_ends(transfer_id, "verified")
    share = update.size / (bench.now_s - start_s) / (baud / 10)
    assert share >= 0.92
    assert update.resent == 0
    end = done(bench, transfer_id)
    assert end.frame_number == number
    assert end.data == bench.tracker.slots[0].pixels.tobytes()
    assert hashlib.sha256(end.data).digest() == bench.telemetry("frame_info")[-1].values["sha256"]


def test_an_upload_is_not_delayed_by_the_silence_before(make_bench: Callable[..., Bench]) -> None:
    """HELLOs that were sent while the rate of the line was unknown do not reduce the rate of a later upload."""
    bench = make_bench(baud=19_200)
    bench.connected = False
    for silent_s in range(0, 3600, 3):
        bench.host.poll(bench.now_s + silent_s)
    bench.now_s += silent_s
    bench.connected = True
    bench.until(lambda: bench.host.hello is not None)
    transfer_id = upload(bench, B, small_catalogue())
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 0, 5.0)


def test_a_thumbnail_is_the_frame_in_blocks_of_four(bench: Bench) -> None:
    """A thumbnail has the averages of 4x4 pixels, row by row from the top."""
    bench.do("TAKE_IMAGE")
    transfer_id = bench.host.transfers.start_download("thumbnail", 0)
    bench.transfer_ends(transfer_id, "verified")
    pixels = bench.tracker.slots[0].pixels
    expected = np.rint(pixels[:4, :4].mean()), np.rint(pixels[508:, 1020:].mean())
    small = np.frombuffer(done(bench, transfer_id).data, np.uint8).reshape(128, 256)
    assert (small[0, 0], small[-1, -1]) == expected
    assert np.array_equal(small, thumbnail(pixels))


def test_a_catalogue_is_uploaded_verified_and_committed_at_nearly_the_line_s_rate(
    make_bench: Callable[..., Bench],
) -> None:
    """An upload at 92 % of the line's rate or more is committed. The bank contains exactly the sent bytes and is not
    activated."""
    bench = make_bench(baud=115_200)
    bench.until(lambda: bench.host.hello is not None)
    data, start_s = small_catalogue(), bench.now_s
    transfer_id = upload(bench, B, data)
    update = bench.transfer_ends(transfer_id, "committed")
    assert update.size / (bench.now_s - start_s) / 11_520 >= 0.92
    assert [u.state.value for u in bench.updates(transfer_id) if u.state.value != "transferring"] == [
        "opening",
        "verifying",
        "committed",
    ]
    assert bench.memory.content("B") == data
    assert bench.memory.record.banks["B"].state == "committed"
    assert bench.memory.record.active == "golden"
    stored = [u.stored_bytes for u in bench.updates(transfer_id)]
    assert stored == sorted(stored)
    assert stored[-1] == len(data)


@pytest.mark.parametrize("seed", range(2))
def test_both_directions_complete_at_a_bit_error_rate_of_1e_4(make_bench: Callable[..., Bench], seed: int) -> None:
    """At a bit error rate of 1e-4 a download and an upload complete with the correct content."""
    bench = make_bench(faults=FaultRates(bit_error_rate=1e-4))
    bench.until(lambda: bench.host.hello is not None, 60)
    while bench.do("TAKE_IMAGE", slot=seed).stage is not Stage.COMPLETED:
        pass
    down = bench.host.transfers.start_download("frame", seed, chunk_bytes=256)
    start_s = bench.now_s
    update = bench.transfer_ends(down, "verified", 300)
    assert done(bench, down).data == bench.tracker.slots[seed].pixels.tobytes()
    # 79 % of chunks of 2400 bits arrive undamaged, and few bytes are sent twice.
    assert update.size / (bench.now_s - start_s) / 92_160 > 0.6
    data = small_catalogue()
    up = upload(bench, B, data)
    bench.transfer_ends(up, "committed", 300)
    assert bench.memory.content("B") == data


@pytest.mark.parametrize("bit_error_rate", [0.0, 1e-4])
def test_a_download_counts_repeated_requests(make_bench: Callable[..., Bench], bit_error_rate: float) -> None:
    """The number of repeated requests equals the number of chunks sent again: 0 on a clean line, more on a noisy one."""
    bench = make_bench(faults=FaultRates(bit_error_rate=bit_error_rate))
    bench.until(lambda: bench.host.hello is not None, 60)
    while bench.do("TAKE_IMAGE").stage is not Stage.COMPLETED:
        pass
    chunks, next_chunk = [], bench.device._loader.next_chunk

    def counted(now_s: float) -> object:
        message = next_chunk(now_s)
        chunks.extend([message] if message else [])
        return message

    bench.device._loader.next_chunk = counted  # type: ignore[method-assign, assignment]
    down = bench.host.transfers.start_download("frame", 0, chunk_bytes=512)
    update = bench.transfer_ends(down, "verified", 300)
    assert update.resent == len(chunks) - update.chunks
    assert (update.resent > 0) == (bit_error_rate > 0)


def test_a_line_with_bursts_losses_and_duplicates_delivers(make_bench: Callable[..., Bench]) -> None:
    """An upload is committed with the correct content on a line that loses and repeats blocks of bytes."""
    bench = make_bench(faults=FaultRates(drop_rate=0.01, duplicate_rate=0.01))
    bench.until(lambda: bench.host.hello is not None, 60)
    data = small_catalogue()
    transfer_id = upload(bench, C, data)
    bench.transfer_ends(transfer_id, "committed", 300)
    assert bench.memory.content("C") == data
    assert bench.host.transfer(transfer_id).resent > 0


def test_commands_are_sent_before_chunks(make_bench: Callable[..., Bench]) -> None:
    """During an upload on a slow line, a command completes within half a second."""
    bench = make_bench(baud=57_600)
    bench.until(lambda: bench.host.hello is not None)
    upload(bench, B, small_catalogue())
    bench.run(2.0)
    start_s = bench.now_s
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED
    assert bench.now_s - start_s < 0.5


def test_a_lost_line_suspends_and_resumes_with_the_stored_chunks(bench: Bench) -> None:
    """After the line was lost, an upload resumes and sends only the remaining chunks."""
    data = small_catalogue()
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(data) // 2)
    bench.events += bench.host.link_lost(bench.now_s)
    assert bench.host.transfer(transfer_id).state == "link_lost"
    bench.connected = False
    bench.run(20.0)
    assert any(isinstance(e, DeviceEvent) and e.name == "TRANSFER_SUSPENDED" for e in bench.events) is False
    bench.connected = True
    bench.host.link_up(bench.now_s)
    sent_before = bench.host.counters.sent.bytes
    update = bench.transfer_ends(transfer_id, "committed")
    assert update.resumed
    assert bench.host.counters.sent.bytes - sent_before < 0.6 * len(data)
    assert bench.memory.content("B") == data


def test_a_silent_line_is_detected_and_the_transfer_resumes_automatically(bench: Bench) -> None:
    """A download on a line that loses all bytes is suspended. It continues automatically when bytes arrive again."""
    bench.do("TAKE_IMAGE")
    transfer_id = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 200_000)
    bench.connected = False
    bench.transfer_ends(transfer_id, "link_lost")
    bench.run(20.0)
    partial, ranges = bench.host.transfers.partial(transfer_id)
    held = sum(last - first + 1 for first, last in ranges) * 1024
    assert held == bench.host.transfer(transfer_id).stored_bytes > 200_000
    assert partial[:1024] == bench.tracker.slots[0].pixels.tobytes()[:1024]
    bench.connected = True
    received_before = bench.host.counters.received.bytes
    bench.transfer_ends(transfer_id, "verified")
    assert bench.host.counters.received.bytes - received_before < 0.75 * 524_288
    assert done(bench, transfer_id).data == bench.tracker.slots[0].pixels.tobytes()


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_an_upload_survives_a_reset(bench: Bench, share: float) -> None:
    """After a reset an upload continues with the chunks stored in flash and is committed."""
    data = small_catalogue()
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > share * len(data))
    bench.device.reset("watchdog", bench.now_s)
    bench.transfer_ends(transfer_id, "committed")
    assert bench.memory.content("B") == data
    assert bench.host.transfer(transfer_id).resumed


def test_a_reset_during_a_download_fails_it_with_the_reason(bench: Bench) -> None:
    """A reset clears image memory, so the download fails with the reason. The received part is kept."""
    bench.do("TAKE_IMAGE")
    transfer_id = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 200_000)
    bench.device.reset("watchdog", bench.now_s)
    update = bench.transfer_ends(transfer_id, "failed")
    assert "no_image" in update.reason
    assert bench.host.transfers.partial(transfer_id)[1]


def test_a_new_server_continues_an_interrupted_download(bench: Bench) -> None:
    """A new session uses the stored part of an earlier download if the content is the same, and discards it otherwise."""
    bench.do("TAKE_IMAGE")
    first = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(first).stored_bytes > 300_000)
    update = bench.host.transfer(first)
    bench.host.transfers.abort(first)
    held = HeldPart(update.sha256, update.chunk_size, *bench.host.transfers.partial(first))
    bench.run(0.5)
    second = bench.host.transfers.start_download("frame", 0, partial=held)
    before = bench.host.counters.received.bytes
    assert bench.transfer_ends(second, "verified").resumed
    assert bench.host.counters.received.bytes - before < 300_000
    assert done(bench, second).data == bench.tracker.slots[0].pixels.tobytes()
    bench.do("TAKE_IMAGE")
    third = bench.host.transfers.start_download("frame", 0, partial=held)
    assert not bench.transfer_ends(third, "verified").resumed
    assert done(bench, third).data == bench.tracker.slots[0].pixels.tobytes()


def test_pause_and_resume(bench: Bench) -> None:
    """A paused upload sends nothing while another transfer runs, and continues when it is resumed."""
    data = small_catalogue()
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 20_000)
    bench.host.transfers.pause(transfer_id)
    bench.run(1.0)
    stored = bench.memory.flash.read(bench.memory.offset("B"), len(data))
    bench.do("TAKE_IMAGE")
    other = bench.host.transfers.start_download("thumbnail", 0)
    bench.transfer_ends(other, "verified")
    assert bench.memory.flash.read(bench.memory.offset("B"), len(data)) == stored
    with pytest.raises(Conflict):
        bench.host.transfers.pause(transfer_id)
    bench.host.transfers.resume(transfer_id)
    assert bench.transfer_ends(transfer_id, "committed").resumed


def test_abort_from_the_ground_frees_the_bank(bench: Bench) -> None:
    """An upload aborted by the ground ends on both sides, and other content can be uploaded to the bank."""
    transfer_id = upload(bench, B, small_catalogue())
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 20_000)
    bench.host.transfers.abort(transfer_id)
    bench.run(0.5)
    assert bench.host.transfer(transfer_id).state == "aborted"
    assert any(isinstance(e, DeviceEvent) and e.name == "TRANSFER_ABORTED" for e in bench.events)
    bench.host.transfers.forget(transfer_id)
    with pytest.raises(NotFound):
        bench.host.transfer(transfer_id)
    stars = load_stars(3.0)
    other = encode(stars, distance_table(stars, 0.01, 0.5), "cubestar", "cubestar")
    second = upload(bench, B, other)
    bench.transfer_ends(second, "committed")
    assert bench.memory.content("B") == other


def test_abort_command_stops_transfers_from_the_device_s_side(bench: Bench) -> None:
    """The command ABORT ends a running transfer on board, and the ground reports it as aborted."""
    transfer_id = upload(bench, B, small_catalogue())
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 20_000)
    bench.host.abort(bench.now_s)
    bench.transfer_ends(transfer_id, "aborted")


@pytest.mark.parametrize(
    ("bank", "changes", "reason"),
    [
        (GOLDEN, {}, "write_protected"),
        (9, {}, "not_found"),
        (B, {"profile": "sunsat"}, "incompatible"),
        (B, {"format_version": 2}, "incompatible"),
        (B, {"dictionary_hash": bytes(32)}, "incompatible"),
        (B, {"device_model": "other"}, "incompatible"),
    ],
)
def test_incompatible_content_is_rejected_before_it_is_sent(
    bench: Bench, bank: int, changes: dict[str, object], reason: str
) -> None:
    """The device rejects an upload with an incompatible block when it is opened, before content is sent."""
    data = small_catalogue()
    sent = bench.host.counters.sent.bytes
    transfer_id = bench.host.transfers.start_upload("catalogue", bank, data, compatible(bench, **changes))
    update = bench.transfer_ends(transfer_id, "failed")
    assert update.reason.startswith(reason)
    assert bench.host.counters.sent.bytes - sent < 500


def test_too_large_empty_and_unknown_transfers_are_rejected(bench: Bench) -> None:
    """Uploads that are too large or empty, an unknown kind, and a download from an empty slot are rejected."""
    big = upload(bench, B, bytes(bench.memory.bank_bytes + 1))
    assert bench.transfer_ends(big, "failed").reason.startswith("too_large")
    with pytest.raises(BadInput):
        upload(bench, B, b"")
    with pytest.raises(BadInput):
        bench.host.transfers.start_download("video", 0)
    empty_slot = bench.host.transfers.start_download("frame", 2)
    assert bench.transfer_ends(empty_slot, "failed").reason.startswith("no_image")


def test_bytes_that_are_not_a_catalogue_are_not_committed(bench: Bench) -> None:
    """Content that is not a catalogue is rejected as incompatible, although its hash is correct."""
    transfer_id = upload(bench, B, bytes(range(256)) * 40)
    update = bench.transfer_ends(transfer_id, "failed")
    assert update.reason.startswith("incompatible")
    assert bench.memory.record.banks["B"].state != "committed"


def test_a_cell_that_flips_before_verification_is_detected(bench: Bench) -> None:
    """Verification reads the flash, so a flipped bit is detected. The upload then succeeds when it is resumed."""
    data = small_catalogue()
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(data) // 2)
    bench.memory.flash.flip(bench.memory.offset("B") + 100)
    assert "read back" in bench.transfer_ends(transfer_id, "failed").reason
    bench.host.transfers.resume(transfer_id)
    bench.transfer_ends(transfer_id, "committed")
    assert bench.memory.content("B") == data


def test_an_uploaded_image_is_solved_on_board(bench: Bench) -> None:
    """An image uploaded to image memory is solved on board. An image of the wrong length is rejected."""
    bench.do("TAKE_IMAGE", slot=0)
    picture = bench.tracker.slots[0].pixels.tobytes()
    bench.do("RESET")
    bench.run(1.0)
    transfer_id = bench.host.transfers.start_upload("image", 1, picture, Compatibility())
    bench.transfer_ends(transfer_id, "committed")
    assert bench.telemetry("frame_info")[-1].values["source"] == "uploaded"
    assert bench.do("FIND_CENTROIDS", slot=1).stage is Stage.COMPLETED
    assert bench.do("MATCH_STARS").stage is Stage.COMPLETED
    assert bench.do("CALCULATE_ATTITUDE").values["outcome"] == "solved"
    wrong = bench.host.transfers.start_upload("image", 1, picture[:-1], Compatibility())
    assert bench.transfer_ends(wrong, "failed").reason.startswith("bad_length")


def test_transfers_run_one_at_a_time(bench: Bench) -> None:
    """A second transfer is queued until the first one has ended."""
    bench.do("TAKE_IMAGE")
    first = bench.host.transfers.start_download("frame", 0)
    second = bench.host.transfers.start_download("thumbnail", 0)
    bench.run(1.0)
    assert bench.host.transfer(second).state == "queued"
    bench.transfer_ends(first, "verified")
    bench.transfer_ends(second, "verified")


@pytest.mark.parametrize("stated", [{"stars": 5}, {"pairs": 7}, {"epoch_jyear": 1900.0}])
def test_a_catalogue_other_than_announced_is_not_committed(bench: Bench, stated: dict[str, float]) -> None:
    """A catalogue whose stars, pairs or epoch differ from the announced values is not committed."""
    transfer_id = bench.host.transfers.start_upload("catalogue", 1, small_catalogue(), compatible(bench, **stated))
    end = bench.transfer_ends(transfer_id, "failed")
    assert "incompatible" in end.reason
    assert bench.memory.record.banks["B"].state != "committed"


@pytest.mark.parametrize("epoch", [float("nan"), float("inf"), -5.0, 1e9])
def test_an_impossible_epoch_is_rejected_immediately(bench: Bench, epoch: float) -> None:
    """An upload with an invalid epoch is rejected when it is opened, and nothing is erased for it."""
    before = bench.memory.record.banks["B"]
    transfer_id = bench.host.transfers.start_upload(
        "catalogue", 1, small_catalogue(), compatible(bench, epoch_jyear=epoch)
    )
    assert "out_of_range" in bench.transfer_ends(transfer_id, "failed").reason
    assert bench.memory.record.banks["B"] == before


def test_an_invalid_opening_is_rejected_with_a_reason(bench: Bench) -> None:
    """The device rejects an image of the wrong size and an opening that cannot be decoded, with the reason."""
    row = bench.dictionary.service("OPEN_DOWNLOAD")
    size = bench.tracker.imager.frame_size
    facts = {"kind": "image", "target": 0, "chunk_bytes": 256, "sha256": bytes(32), "device_model": "", "profile": ""}
    facts |= {"dictionary_hash": bytes(32), "format_version": 0, "epoch_jyear": 0.0, "stars": 0, "pairs": 0}
    assert bench.refusal("OPEN_UPLOAD", {**facts, "size_bytes": size + 1}) == "too_large"
    assert bench.refusal("OPEN_UPLOAD", {**facts, "size_bytes": size - 1}) == "bad_length"
    for payload, reason in ((b"", "bad_length"), (bytes([255]) + bytes(43), "out_of_range")):
        assert bench.refusal_of(row.code, payload) == reason
