"""Transfers against a line and a device that misbehave, in simulated time."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.catalogue_tools.onboard import encode
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.tables.distances import distance_table
from gss.device.protocol.codec import encode as encode_payload
from gss.device.protocol.packet import PacketType
from gss.device.protocol.transfer import Compatibility
from gss.device.session import HeldPart, HostSession
from gss.device.session_events import DeviceEvent, Stage, TransferDone
from gss.device.simulator.faults import FaultRates
from gss.device.simulator.memory import FlashError

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
    return bench.host.start_upload("catalogue", bank, data, compatibility, bench.now_s)


def greeted(bench: Bench) -> Bench:
    bench.until(lambda: bench.host.hello is not None, 60)
    return bench


def pictured(bench: Bench) -> bytes:
    """The wire bytes of a frame in slot 0."""
    while bench.do("TAKE_IMAGE").stage is not Stage.COMPLETED:
        pass
    return bench.tracker.slots[0].pixels.tobytes()


def done(bench: Bench, transfer_id: int) -> TransferDone:
    (end,) = [e for e in bench.events if isinstance(e, TransferDone) and e.transfer_id == transfer_id]
    return end


# --- a line that turns noisy --------------------------------------------------------------------------------------


def test_a_download_goes_on_in_smaller_chunks_when_the_line_turns_noisy(make_bench: Callable[..., Bench]) -> None:
    """What was held stays held: the new grid asks only for the rest; in large chunks the line would carry a third."""
    bench = greeted(make_bench())
    pixels = pictured(bench)
    transfer_id = bench.host.start_download("frame", 0, bench.now_s)
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
    # At most one chunk of the old grid is cut by the new one at each edge of a held range.
    assert all(b > a - 16 * CHUNK_1024_BYTES for a, b in itertools.pairwise(stored))
    rest = len(pixels) - before.stored_bytes
    assert bench.host.counters.received.bytes - received < 2.2 * rest
    assert rest / (bench.now_s - start_s) / 92_160 > 0.4
    assert done(bench, transfer_id).data == pixels


@pytest.mark.parametrize("baud", [115_200, 921_600])
def test_a_noisy_line_carries_more_than_half_of_its_rate_from_the_first_transfer_on(
    make_bench: Callable[..., Bench], baud: int
) -> None:
    """At one bit in ten thousand; chunks of 1024 bytes carried a third."""
    bench = greeted(make_bench(baud=baud, faults=FaultRates(bit_error_rate=1e-4)))
    pictured(bench)
    start_s = bench.now_s
    transfer_id = bench.host.start_download("frame", 0, bench.now_s)
    update = bench.transfer_ends(transfer_id, "verified", 300)
    assert update.size / (bench.now_s - start_s) / (baud / 10) > 0.55


def test_an_upload_ends_on_a_noisy_line_whichever_grid_the_device_takes(make_bench: Callable[..., Bench]) -> None:
    """The content is right and committed; a device that keeps its own grid is not asked again and again."""
    bench = greeted(make_bench(faults=FaultRates(bit_error_rate=1e-4)))
    data = catalogue()
    transfer_id = upload(bench, B, data)
    bench.transfer_ends(transfer_id, "committed", 300)
    assert bench.memory.content("B") == data
    assert [u.state for u in bench.updates(transfer_id)].count("opening") <= 4


def test_a_size_that_was_asked_for_is_kept(make_bench: Callable[..., Bench]) -> None:
    """Who names the size of chunks gets it, whatever the line does."""
    bench = greeted(make_bench(faults=FaultRates(bit_error_rate=1e-4)))
    pictured(bench)
    transfer_id = bench.host.start_download("thumbnail", 0, bench.now_s, chunk_bytes=512)
    assert bench.transfer_ends(transfer_id, "verified", 120).chunk_size == 512


def test_the_next_transfer_of_a_noisy_minute_begins_with_small_chunks(make_bench: Callable[..., Bench]) -> None:
    """What the line did lately decides; after a quiet minute large ones are back."""
    bench = greeted(make_bench(faults=FaultRates(bit_error_rate=1e-4)))
    pictured(bench)
    bench.transfer_ends(bench.host.start_download("frame", 0, bench.now_s), "verified", 120)
    again = bench.host.start_download("thumbnail", 0, bench.now_s)
    assert bench.host.transfer(again).chunk_size < CHUNK_1024_BYTES
    bench.transfer_ends(again, "verified", 60)
    for faults in (bench.up_faults, bench.down_faults):
        faults.rates = FaultRates()
    bench.run(65.0)
    later = bench.host.start_download("thumbnail", 0, bench.now_s)
    assert bench.host.transfer(later).chunk_size == CHUNK_1024_BYTES


# --- window and commands ------------------------------------------------------------------------------------------


def test_a_command_overtakes_a_transfer_within_a_few_chunk_times(make_bench: Callable[..., Bench]) -> None:
    """At 115 200 Bd, up and down: from submitting to the report of completion never more than five chunks of 1024 bytes."""
    bench = greeted(make_bench(baud=115_200))
    pictured(bench)
    for start in (
        lambda: bench.host.start_download("frame", 0, bench.now_s),
        lambda: upload(bench, B, catalogue(3.8)),
    ):
        transfer_id = start()
        bench.until(lambda i=transfer_id: bench.host.transfer(i).stored_bytes > 20_000)
        for _ in range(4):
            start_s = bench.now_s
            assert bench.do("GET_STATUS").stage is Stage.COMPLETED
            assert (bench.now_s - start_s) / CHUNK_S < 5
            bench.run(0.37)
        bench.host.abort_transfer(transfer_id, bench.now_s)
        bench.run(0.5)


def test_never_more_chunks_are_under_way_than_the_device_s_window(make_bench: Callable[..., Bench]) -> None:
    """Counted at the device's ear: chunks sent since the last one whose fate is known."""
    bench = greeted(make_bench(faults=FaultRates(bit_error_rate=2e-5)))
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
    """An index that does not exist, a chunk too long, one too short: not stored, and the transfer ends whole."""
    data = catalogue()
    neighbour = bench.memory.flash.read(bench.memory.offset("C"), 4096)
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 10_000)
    session = bench.host._desk.get(transfer_id).session
    assert session is not None
    chunks = bench.host.transfer(transfer_id).chunks
    for index, length in ((chunks, 1024), (2**32 - 1, 1024), (chunks - 1, 1500), (chunks - 1, 3)):
        inject_chunk(bench, session, index, b"\x55" * length)
    bench.transfer_ends(transfer_id, "committed")
    assert bench.memory.content("B") == data
    assert bench.memory.flash.read(bench.memory.offset("C"), 4096) == neighbour


def test_a_wrong_hash_is_found_by_reading_back_and_nothing_is_committed(bench: Bench) -> None:
    """The ground announces another content than it sends."""
    data = catalogue()
    transfer_id = upload(bench, B, data)
    bench.host._desk.get(transfer_id).sha256 = hashlib.sha256(b"something else").digest()
    update = bench.transfer_ends(transfer_id, "failed")
    assert "read back" in update.reason
    assert bench.memory.record.banks["B"].state != "committed"


def test_another_camera_s_catalogue_is_refused_by_word_and_by_content(bench: Bench) -> None:
    """The compatibility block is checked first; a block that lies is found in the header of the content."""
    honest = upload(bench, B, catalogue(3.4, "sunsat"), "sunsat")
    assert bench.transfer_ends(honest, "failed").reason.startswith("incompatible")
    lying = upload(bench, B, catalogue(3.4, "sunsat"), "cubestar")
    update = bench.transfer_ends(lying, "failed")
    assert update.reason.startswith("incompatible")
    assert "sunsat" in update.reason
    assert bench.memory.record.banks["B"].state != "committed"


def test_a_full_bank_is_said_before_anything_is_sent(bench: Bench) -> None:
    """One byte more than the bank has."""
    sent = bench.host.counters.sent.bytes
    transfer_id = upload(bench, B, bytes(bench.memory.bank_bytes + 1))
    assert bench.transfer_ends(transfer_id, "failed").reason.startswith("too_large")
    assert bench.host.counters.sent.bytes - sent < 500


def test_flash_that_fails_ends_the_upload_and_a_later_one_succeeds(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device gives it up with flash_error and an event; the bank is not committed."""
    data, program = catalogue(), bench.memory.flash.program
    left = [10]

    def failing(offset: int, piece: bytes) -> None:
        left[0] -= 1
        if left[0] < 0:
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
def test_a_clock_that_jumps_costs_a_moment_only(bench: Bench, jump_s: float) -> None:
    """A computer that slept: all windows have passed at once, and the transfer still goes on with what is stored."""
    data = catalogue()
    transfer_id = upload(bench, B, data)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(data) // 2)
    bench.now_s += jump_s
    sent = bench.host.counters.sent.bytes
    bench.transfer_ends(transfer_id, "committed", 60)
    assert bench.memory.content("B") == data
    assert bench.host.counters.sent.bytes - sent < len(data)


def test_a_port_that_vanishes_again_and_again_only_delays(bench: Bench) -> None:
    """Eight losses of the port during one frame: it comes whole, and what had come is not sent twice."""
    pixels = pictured(bench)
    transfer_id = bench.host.start_download("frame", 0, bench.now_s)
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


def test_transfers_of_a_server_before_wait_for_the_device_and_go_on(bench: Bench) -> None:
    """A new session is given what the old one left: paused with its reason until the device has answered, then resumed."""
    pixels, data = pictured(bench), catalogue()
    down = bench.host.start_download("frame", 0, bench.now_s)
    bench.until(lambda: bench.host.transfer(down).stored_bytes > len(pixels) // 2)
    update = bench.host.transfer(down)
    part = HeldPart(update.sha256, update.chunk_size, *bench.host.partial(down))
    restarted = HostSession(bench.dictionary)
    bench.host = restarted
    why = "the server restarted"
    resumed = restarted.start_download("frame", 0, bench.now_s, held=part, paused=why)
    compatibility = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1, 1991.25)
    up = restarted.start_upload("catalogue", B, data, compatibility, bench.now_s, paused=why)
    by_hand = restarted.start_download("thumbnail", 0, bench.now_s)
    restarted.pause_transfer(by_hand, bench.now_s)
    assert [restarted.transfer(i).state for i in (resumed, up, by_hand)] == ["paused"] * 3
    assert restarted.transfer(resumed).reason == why
    bench.run(1.0)  # no port yet
    assert restarted.transfer(resumed).state == "paused"
    restarted.link_up(bench.now_s)
    received = restarted.counters.received.bytes
    bench.transfer_ends(resumed, "verified")
    assert restarted.counters.received.bytes - received < 0.6 * len(pixels)
    assert done(bench, resumed).data == pixels
    bench.transfer_ends(up, "committed")
    assert bench.memory.content("B") == data
    assert restarted.transfer(by_hand).state == "paused"
    restarted.resume_transfer(by_hand, bench.now_s)
    bench.transfer_ends(by_hand, "verified")


def test_a_kept_part_that_rotted_is_thrown_away_and_fetched_anew(bench: Bench) -> None:
    """The hash of the whole decides; the second attempt trusts nothing that was kept."""
    pixels = pictured(bench)
    first = bench.host.start_download("frame", 0, bench.now_s)
    bench.until(lambda: bench.host.transfer(first).stored_bytes > len(pixels) // 2)
    update = bench.host.transfer(first)
    data, ranges = bench.host.partial(first)
    bench.host.abort_transfer(first, bench.now_s)
    rotten = bytearray(data)
    rotten[100] ^= 1
    second = bench.host.start_download(
        "frame", 0, bench.now_s, held=HeldPart(update.sha256, update.chunk_size, bytes(rotten), ranges)
    )
    bench.transfer_ends(second, "verified")
    assert done(bench, second).data == pixels
    assert any("started over" in u.reason for u in bench.updates(second))


def test_another_image_in_the_slot_is_said_when_a_download_goes_on(bench: Bench) -> None:
    """While the line was away a new image was taken: the old part is void, and the transfer says that it started over."""
    pictured(bench)
    transfer_id = bench.host.start_download("frame", 0, bench.now_s)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > 200_000)
    bench.host.pause_transfer(transfer_id, bench.now_s)
    bench.run(0.5)
    newer = pictured(bench)
    bench.host.resume_transfer(transfer_id, bench.now_s)
    bench.transfer_ends(transfer_id, "verified")
    assert done(bench, transfer_id).data == newer
    assert any("the content on board has changed" in u.reason for u in bench.updates(transfer_id))


def test_a_reset_loses_image_memory_and_the_transfer_says_so(bench: Bench) -> None:
    """An image on its way up starts over after the reset and is committed whole."""
    picture = pictured(bench)
    transfer_id = bench.host.start_upload("image", 1, picture, Compatibility(), bench.now_s)
    bench.until(lambda: bench.host.transfer(transfer_id).stored_bytes > len(picture) // 2)
    bench.device.reset("watchdog", bench.now_s)
    bench.transfer_ends(transfer_id, "committed")
    assert bench.tracker.slots[1].pixels.tobytes() == picture
    assert any("no longer holds" in u.reason for u in bench.updates(transfer_id))
