"""Transfers with a faulty line or device, with simulated time."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.device.protocol.codec import encode as encode_payload
from gss.device.protocol.packet import PacketType
from gss.device.protocol.transfer import Compatibility
from gss.device.session import HostSession
from gss.device.session_events import DeviceEvent, Stage, TransferDone
from gss.device.session_transfer import HeldPart
from gss.device.simulator.faults import FaultRates
from gss.device.simulator.memory import FlashError
from gss.skytables.pairs import distance_table

if TYPE_CHECKING:
    from conftest import Bench

B, C = 1, 2
CHUNK_S = 1064 / 11_520
CHUNK_1024_BYTES = 1024


def catalogue(faint_mag: float = 3.4, profile: str = "cubestar") -> bytes:
    stars = load_stars(faint_mag)
    return encode(stars, distance_table(stars, 0.01, np.radians(40)), "cubestar", profile)


def upload(bench: Bench, bank: int, data: bytes, profile: str = "cubestar") -> int:
    compatibility = Compatibility(bench.dictionary.device_model, profile, bench.dictionary.hash, 1, 1991.25)
    return bench.host.transfers.start_upload("catalogue", bank, data, compatibility)


def after_hello(bench: Bench) -> Bench:
    bench.until(lambda: bench.host.hello is not None, 60)
    return bench


def take_image(bench: Bench) -> bytes:
    """Take an image in slot 0. Return its bytes as downloaded."""
    while bench.do("TAKE_IMAGE").stage is not Stage.COMPLETED:
        pass
    return bench.tracker.slots[0].pixels.tobytes()


def done(bench: Bench, transfer_id: int) -> TransferDone:
    (end,) = [e for e in bench.events if isinstance(e, TransferDone) and e.transfer_id == transfer_id]
    return end


# --- a line that becomes noisy -------------------------------------------------------------------------------------


def test_a_download_continues_in_smaller_chunks_when_the_line_becomes_noisy(make_bench: Callable[..., Bench]) -> None:
    """When the line becomes noisy, a download keeps its received bytes and requests the others in smaller chunks. Large
    chunks would give a third of the throughput."""
    bench = after_hello(make_bench())
    pixels = take_image(bench)
    transfer_id = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(pixels) // 2)
    before = bench.host.transfer(transfer_id)
    for faults in (bench.up_faults, bench.down_faults):
        faults.rates = FaultRates(bit_error_rate=1e-4)
    received, start_s = bench.host.counters.received.bytes, bench.now_s
    update = bench.transfer_ends(transfer_id, "verified", 120)
    assert before.chunk_size == CHUNK_1024_BYTES
    assert update.chunk_size < CHUNK_1024_BYTES
    assert any("noisy" in u.reason for u in bench.updates(transfer_id))
    stored = [u.stored_bytes for u in bench.updates(transfer_id)]
    # At each edge of a held range, at most one chunk of the previous size is lost by the new division.
    assert all(b > a - 16 * CHUNK_1024_BYTES for a, b in itertools.pairwise(stored))
    remaining_bytes = len(pixels) - before.stored_bytes
    assert bench.host.counters.received.bytes - received < 2.2 * remaining_bytes
    assert remaining_bytes / (bench.now_s - start_s) / 92_160 > 0.4
    assert done(bench, transfer_id).data == pixels


@pytest.mark.parametrize("baud", [115_200, 921_600])
def test_a_noisy_line_has_more_than_half_its_rate_from_the_first_transfer_on(
    make_bench: Callable[..., Bench], baud: int
) -> None:
    """At a bit error rate of 1e-4 the first transfer uses more than 55 % of the line's rate. Chunks of 1024 bytes used a
    third."""
    bench = after_hello(make_bench(baud=baud, faults=FaultRates(bit_error_rate=1e-4)))
    take_image(bench)
    start_s = bench.now_s
    transfer_id = bench.host.transfers.start_download("frame", 0)
    update = bench.transfer_ends(transfer_id, "verified", 300)
    assert update.size / (bench.now_s - start_s) / (baud / 10) > 0.55


def test_an_upload_completes_on_a_noisy_line_with_either_grid(make_bench: Callable[..., Bench]) -> None:
    """The upload is committed with the correct content, and it is opened at most four times."""
    bench = after_hello(make_bench(faults=FaultRates(bit_error_rate=1e-4)))
    data = catalogue()
    transfer_id = upload(bench, B, data)
    bench.transfer_ends(transfer_id, "committed", 300)
    assert bench.memory.content("B") == data
    assert [u.state for u in bench.updates(transfer_id)].count("opening") <= 4


def test_a_requested_chunk_size_is_kept(make_bench: Callable[..., Bench]) -> None:
    """A chunk size in the request is used even on a noisy line."""
    bench = after_hello(make_bench(faults=FaultRates(bit_error_rate=1e-4)))
    take_image(bench)
    transfer_id = bench.host.transfers.start_download("thumbnail", 0, chunk_bytes=512)
    assert bench.transfer_ends(transfer_id, "verified", 120).chunk_size == 512


def test_the_next_transfer_after_noise_starts_with_small_chunks(make_bench: Callable[..., Bench]) -> None:
    """The recent error rate determines the chunk size of a new transfer. After a minute without errors it is large again."""
    bench = after_hello(make_bench(faults=FaultRates(bit_error_rate=1e-4)))
    take_image(bench)
    bench.transfer_ends(bench.host.transfers.start_download("frame", 0), "verified", 120)
    second = bench.host.transfers.start_download("thumbnail", 0)
    assert bench.host.transfer(second).chunk_size < CHUNK_1024_BYTES
    bench.transfer_ends(second, "verified", 60)
    for faults in (bench.up_faults, bench.down_faults):
        faults.rates = FaultRates()
    bench.run(65.0)
    later = bench.host.transfers.start_download("thumbnail", 0)
    assert bench.host.transfer(later).chunk_size == CHUNK_1024_BYTES


# --- window and commands ------------------------------------------------------------------------------------------


def test_a_command_overtakes_a_transfer_within_a_few_chunk_times(make_bench: Callable[..., Bench]) -> None:
    """At 115 200 Bd, during an upload or a download, a command completes within the time of five chunks of 1024 bytes."""
    bench = after_hello(make_bench(baud=115_200))
    take_image(bench)
    for start in (
        lambda: bench.host.transfers.start_download("frame", 0),
        lambda: upload(bench, B, catalogue(3.8)),
    ):
        transfer_id = start()
        bench.until(lambda i=transfer_id: bench.host.transfer(i).stored_bytes > 20_000)
        for _ in range(4):
            start_s = bench.now_s
            assert bench.do("GET_STATUS").stage is Stage.COMPLETED
            assert (bench.now_s - start_s) / CHUNK_S < 5
            bench.run(0.37)
        bench.host.transfers.abort(transfer_id)
        bench.run(0.5)


def test_unacknowledged_chunks_never_exceed_the_device_s_window(make_bench: Callable[..., Bench]) -> None:
    """The number of chunks sent since the last acknowledged one never exceeds the device's window of 16."""
    bench = after_hello(make_bench(faults=FaultRates(bit_error_rate=2e-5)))
    transfer_id = upload(bench, C, catalogue(3.8))
    most = 0
    while bench.host.transfer(transfer_id).state != "committed":
        bench.step()
        most = max(most, bench.host.transfer(transfer_id).in_flight)
    assert 4 <= most <= 16


# --- content ------------------------------------------------------------------------------------------------------


def inject_chunk(bench: Bench, session: int, index: int, data: bytes) -> None:
    service = bench.dictionary.service("CHUNK")
    payload = encode_payload(service.fields, {"session": session, "index": index, "serial": 9_999_999, "data": data})
    _, frame = bench.host.craft(PacketType.TRANSFER, service.code, payload)
    bench.device.feed(frame, bench.now_s)


def test_a_chunk_beyond_the_size_changes_nothing(bench: Bench) -> None:
    """Chunks with an index out of range, too long or too short are not stored, and the transfer completes."""
    data = catalogue()
    neighbour = bench.memory.flash.read(bench.memory.offset("C"), 4096)
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 10_000)
    session = bench.host.transfers.get(transfer_id).session
    assert session is not None
    chunks = bench.host.transfer(transfer_id).chunks
    for index, length in ((chunks, 1024), (2**32 - 1, 1024), (chunks - 1, 1500), (chunks - 1, 3)):
        inject_chunk(bench, session, index, b"\x55" * length)
    bench.transfer_ends(transfer_id, "committed")
    assert bench.memory.content("B") == data
    assert bench.memory.flash.read(bench.memory.offset("C"), 4096) == neighbour


def test_a_wrong_hash_is_detected_by_reading_back_and_nothing_is_committed(bench: Bench) -> None:
    """If the announced hash differs from the content, the upload fails when it is read back and is not committed."""
    data = catalogue()
    transfer_id = upload(bench, B, data)
    bench.host.transfers.get(transfer_id).sha256 = hashlib.sha256(b"something else").digest()
    update = bench.transfer_ends(transfer_id, "failed")
    assert "read back" in update.reason
    assert bench.memory.record.banks["B"].state != "committed"


def test_another_camera_s_catalogue_is_rejected_by_block_and_by_content(bench: Bench) -> None:
    """A catalogue of another camera is rejected by its compatibility block, or by its header if the block is wrong."""
    declared_sunsat = upload(bench, B, catalogue(3.4, "sunsat"), "sunsat")
    assert bench.transfer_ends(declared_sunsat, "failed").reason.startswith("incompatible")
    declared_cubestar = upload(bench, B, catalogue(3.4, "sunsat"), "cubestar")
    update = bench.transfer_ends(declared_cubestar, "failed")
    assert update.reason.startswith("incompatible")
    assert "sunsat" in update.reason
    assert bench.memory.record.banks["B"].state != "committed"


def test_a_catalogue_too_large_is_rejected_before_it_is_sent(bench: Bench) -> None:
    """A catalogue with one byte more than the bank's capacity is rejected before any chunk is sent."""
    sent = bench.host.counters.sent.bytes
    transfer_id = upload(bench, B, bytes(bench.memory.bank_bytes + 1))
    assert bench.transfer_ends(transfer_id, "failed").reason.startswith("too_large")
    assert bench.host.counters.sent.bytes - sent < 500


def test_a_flash_failure_ends_the_upload_and_a_later_one_succeeds(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a flash failure the device ends the upload with ``flash_error`` and an event, and does not commit the bank. A
    later upload succeeds."""
    data, program = catalogue(), bench.memory.flash.program
    writes_left = [10]

    def failing(offset: int, piece: bytes) -> None:
        writes_left[0] -= 1
        if writes_left[0] < 0:
            raise FlashError("cell worn out")
        program(offset, piece)

    monkeypatch.setattr(bench.memory.flash, "program", failing)
    transfer_id = upload(bench, B, data)
    assert bench.transfer_ends(transfer_id, "failed").reason.startswith("flash_error")
    assert any(isinstance(e, DeviceEvent) and e.name == "FLASH_ERROR" for e in bench.events)
    assert bench.memory.record.banks["B"].state != "committed"
    monkeypatch.undo()
    bench.transfer_ends(upload(bench, B, data), "committed")
    assert bench.memory.content("B") == data


# --- time, ports, restarts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("jump_s", [3600.0, 20.0])
def test_a_clock_jump_delays_a_transfer_only_briefly(bench: Bench, jump_s: float) -> None:
    """After the computer was suspended all timeouts have expired. The transfer continues with the stored chunks."""
    data = catalogue()
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(data) // 2)
    bench.now_s += jump_s
    sent = bench.host.counters.sent.bytes
    bench.transfer_ends(transfer_id, "committed", 60)
    assert bench.memory.content("B") == data
    assert bench.host.counters.sent.bytes - sent < len(data)


def test_repeated_port_losses_only_delay_a_transfer(bench: Bench) -> None:
    """A frame is downloaded completely despite eight losses of the port, with less than 50 % more received bytes."""
    pixels = take_image(bench)
    transfer_id = bench.host.transfers.start_download("frame", 0)
    for share in range(1, 9):
        bench.until(lambda s=share: bench.host.transfer(transfer_id).stored_bytes > s * len(pixels) // 10)
        bench.events += bench.host.link_lost(bench.now_s)
        bench.connected = False
        bench.run(1.0)
        bench.connected = True
        bench.host.link_up(bench.now_s)
    bench.transfer_ends(transfer_id, "verified", 60)
    assert done(bench, transfer_id).data == pixels
    assert bench.host.counters.received.bytes < 1.5 * len(pixels)


def test_transfers_of_a_previous_server_wait_for_the_device_and_continue(bench: Bench) -> None:
    """A new session pauses the open transfers of a previous server until the device has identified itself, and then
    resumes them. A transfer paused by the user remains paused."""
    pixels, data = take_image(bench), catalogue()
    down = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(down).stored_bytes > len(pixels) // 2)
    update = bench.host.transfer(down)
    part = HeldPart(update.sha256, update.chunk_size, *bench.host.transfers.partial(down))
    restarted = HostSession(bench.dictionary)
    bench.host = restarted
    pause_reason = "the server restarted"
    resumed = restarted.transfers.start_download("frame", 0, partial=part, paused=pause_reason)
    compatibility = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1, 1991.25)
    up = restarted.transfers.start_upload("catalogue", B, data, compatibility, paused=pause_reason)
    paused_by_user = restarted.transfers.start_download("thumbnail", 0)
    restarted.transfers.pause(paused_by_user)
    assert [restarted.transfer(i).state for i in (resumed, up, paused_by_user)] == ["paused"] * 3
    assert restarted.transfer(resumed).reason == pause_reason
    bench.run(1.0)  # no port yet
    assert restarted.transfer(resumed).state == "paused"
    restarted.link_up(bench.now_s)
    received = restarted.counters.received.bytes
    bench.transfer_ends(resumed, "verified")
    assert restarted.counters.received.bytes - received < 0.6 * len(pixels)
    assert done(bench, resumed).data == pixels
    bench.transfer_ends(up, "committed")
    assert bench.memory.content("B") == data
    assert restarted.transfer(paused_by_user).state == "paused"
    restarted.transfers.resume(paused_by_user)
    bench.transfer_ends(paused_by_user, "verified")


def test_a_damaged_stored_part_is_discarded_and_downloaded_again(bench: Bench) -> None:
    """If the hash of the complete content is wrong, the stored part is discarded and the download starts again."""
    pixels = take_image(bench)
    first = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(first).stored_bytes > len(pixels) // 2)
    update = bench.host.transfer(first)
    data, ranges = bench.host.transfers.partial(first)
    bench.host.transfers.abort(first)
    damaged = bytearray(data)
    damaged[100] ^= 1
    second = bench.host.transfers.start_download(
        "frame", 0, partial=HeldPart(update.sha256, update.chunk_size, bytes(damaged), ranges)
    )
    bench.transfer_ends(second, "verified")
    assert done(bench, second).data == pixels
    assert any("started over" in u.reason for u in bench.updates(second))


def test_another_image_in_the_slot_is_reported_when_a_download_continues(bench: Bench) -> None:
    """If a new image was taken while a download was paused, the stored part is discarded and the transfer reports the
    change."""
    take_image(bench)
    transfer_id = bench.host.transfers.start_download("frame", 0)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 200_000)
    bench.host.transfers.pause(transfer_id)
    bench.run(0.5)
    newer = take_image(bench)
    bench.host.transfers.resume(transfer_id)
    bench.transfer_ends(transfer_id, "verified")
    assert done(bench, transfer_id).data == newer
    assert any("the content on board has changed" in u.reason for u in bench.updates(transfer_id))


def test_a_reset_clears_image_memory_and_the_transfer_restarts(bench: Bench) -> None:
    """After a reset, which clears image memory, an image upload restarts and is committed completely."""
    picture = take_image(bench)
    transfer_id = bench.host.transfers.start_upload("image", 1, picture, Compatibility())
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(picture) // 2)
    bench.device.reset("watchdog", bench.now_s)
    bench.transfer_ends(transfer_id, "committed")
    assert bench.tracker.slots[1].pixels.tobytes() == picture
    assert any("no longer has the stored chunks" in u.reason for u in bench.updates(transfer_id))
