"""Commands from queue to end, over a line, with simulated time."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.dictionary_file import load_dictionary, parse_dictionary
from gss.device.session import HostSession
from gss.device.session_events import DeviceEvent, HelloReceived, LinkCounters, Stage
from gss.device.simulator.faults import FaultRates
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.domain.rotation import matrix_from_quaternion, rotation_angle_rad

if TYPE_CHECKING:
    from conftest import Bench
ARCSEC = np.pi / 648_000


def quaternion_of(values: object) -> np.ndarray:
    return np.array([values[f"quaternion_{axis}"] for axis in "xyzw"], float)  # type: ignore[index]


def test_device_introduces_itself(bench: Bench) -> None:
    """HELLO goes out by itself when the line opens and says who is there."""
    hello = bench.host.hello
    assert hello is not None
    assert (hello.profile, hello.columns, hello.rows, hello.bits) == ("cubestar", 1024, 512, 8)
    assert hello.simulated
    assert hello.dictionary_match
    assert hello.dictionary_hash == load_dictionary().hash_hex


def test_a_command_passes_every_stage_in_order(bench: Bench) -> None:
    """queued, released, sent, accepted, started, progress, completed, with the device's clock."""
    end = bench.do("RUN_ITERATION")
    stages = [s.stage.value for s in bench.stages(end.request_id)]
    assert stages == ["queued", "released", "sent", "accepted", "started", "progress", "completed"]
    assert end.values == {"frame_number": 1, "outcome": "solved"}
    times = [s.device_time_s for s in bench.stages(end.request_id)[3:]]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(0.9 + 0.2, abs=0.15)


def test_an_iteration_reports_everything_and_is_right(bench: Bench) -> None:
    """Centroids, matches, attitude, timing and truth of one frame; the attitude is the one the frame was drawn with."""
    end = bench.do("RUN_ITERATION")
    for packet in ("frame_info", "centroids", "matches", "attitude", "timing", "frame_truth"):
        (report,) = bench.telemetry(packet)
        assert report.values["frame_number"] == 1
        assert report.request_id == end.request_id
    attitude, truth = bench.telemetry("attitude")[0], bench.telemetry("frame_truth")[0]
    assert truth.simulator_only
    error_rad = rotation_angle_rad(
        matrix_from_quaternion(quaternion_of(attitude.values)), matrix_from_quaternion(quaternion_of(truth.values))
    )
    assert error_rad < 200 * ARCSEC
    assert len(bench.telemetry("centroids")[0].lists["items"]) == attitude.values["centroids"]
    assert len(bench.telemetry("matches")[0].lists["items"]) == attitude.values["matched"]


def test_single_steps_give_what_one_iteration_gives(bench: Bench) -> None:
    """TAKE_IMAGE, FIND_CENTROIDS, MATCH_STARS, CALCULATE_ATTITUDE one by one."""
    taken = bench.do("TAKE_IMAGE", slot=1, exposure_ms=200)
    assert taken.values == {"frame_number": 1, "slot": 1}
    found = bench.do("FIND_CENTROIDS", slot=1)
    matched = bench.do("MATCH_STARS")
    solved = bench.do("CALCULATE_ATTITUDE")
    assert 10 <= int(found.values["centroids"]) <= 20
    assert int(matched.values["matched"]) >= 4
    assert solved.values == {"frame_number": 1, "outcome": "solved"}
    info = bench.telemetry("frame_info")[0].values
    assert (info["slot"], info["exposure_ms"], info["source"]) == (1, 200, "captured")


def test_matches_name_rows_of_the_active_catalogue(bench: Bench, golden_catalogue: object) -> None:
    """The star numbers of the telemetry are rows of the bank; with its manifest they are the stars that were drawn."""
    bench.do("RUN_ITERATION")
    truth = bench.tracker.slots[0].truth
    assert truth is not None
    place = dict(zip(truth.hip.tolist(), truth.pixels.tolist(), strict=True))
    centroids = bench.telemetry("centroids")[0].lists["items"]
    for match in bench.telemetry("matches")[0].lists["items"]:
        col, row = place[int(golden_catalogue.hip[int(match["star"])])]  # type: ignore[attr-defined]
        spot = centroids[int(match["centroid"])]
        assert np.hypot(float(spot["col_px"]) - col, float(spot["row_px"]) - row) < 2.0


def test_housekeeping_comes_once_a_second(bench: Bench) -> None:
    """1 Hz, unasked, with values inside their limits on a healthy unit."""
    bench.events.clear()
    bench.run(10.0)
    reports = bench.telemetry("housekeeping")
    assert len(reports) == 10
    assert all(r.request_id == 0 for r in reports)
    assert np.diff([r.device_time_s for r in reports]) == pytest.approx(np.ones(9), abs=0.02)
    for field in bench.dictionary.packet("housekeeping").values:
        if field.page == "power":
            assert field.limits.state(float(reports[0].values[field.name])).value == "ok", field.name


def test_the_cycle_gives_an_attitude_every_second_half_a_second_old(bench: Bench) -> None:
    """The document's pipelining: while an image is taken the one before is solved, so results are up to 1.5 s old."""
    bench.do("START_CYCLE")
    bench.events.clear()
    bench.run(6.0)
    reports = bench.telemetry("attitude")
    assert 5 <= len(reports) <= 6
    assert [r.values["outcome"] for r in reports] == ["solved"] * len(reports)
    ages = [r.device_time_s - float(r.values["frame_time_s"]) for r in reports]
    assert all(0.5 < age < 1.5 for age in ages)
    assert bench.do("TAKE_IMAGE").reason == "wrong_state"
    assert bench.do("STOP_CYCLE").stage is Stage.COMPLETED
    bench.events.clear()
    bench.run(3.0)
    assert not bench.telemetry("attitude")


def test_mode_follows_the_result(bench: Bench) -> None:
    """A solution leads to tracking; housekeeping and an event say so."""
    bench.do("RUN_ITERATION")
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED
    assert bench.host.housekeeping is not None
    assert bench.host.housekeeping["mode"] == "tracking"
    assert any(isinstance(e, DeviceEvent) and e.name == "MODE_CHANGED" for e in bench.events)
    bench.do("RUN_ITERATION")
    assert bench.telemetry("attitude")[-1].values["mode"] == "tracking"


def test_a_command_in_the_wrong_mode_is_rejected(bench: Bench) -> None:
    """Preconditions are the device's to enforce; the reason and the condition come back."""
    bench.do("SET_MODE", mode="standby")
    end = bench.do("START_CYCLE")
    assert (end.stage, end.reason) == (Stage.REJECTED, "wrong_state")
    assert "Mode is not standby" in end.detail
    assert bench.do("SET_MODE", mode="tracking").reason == "wrong_state"
    bench.do("SET_ATTITUDE_HINT", ra_deg=84.0, dec_deg=5.0, roll_deg=17.2, uncertainty_deg=5.0)
    assert bench.do("SET_MODE", mode="assisted").stage is Stage.COMPLETED
    bench.do("RUN_ITERATION")
    assert bench.telemetry("attitude")[-1].values["mode"] == "assisted"
    assert bench.telemetry("attitude")[-1].values["outcome"] == "solved"


def test_steps_without_their_input_fail_and_say_what_is_missing(bench: Bench) -> None:
    """No image, no centroids, no matches."""
    assert bench.do("FIND_CENTROIDS", slot=3).reason == "no_image"
    assert "FIND_CENTROIDS" in bench.do("MATCH_STARS").detail
    assert "MATCH_STARS" in bench.do("CALCULATE_ATTITUDE").detail


def test_detection_settings_reach_the_chain(bench: Bench) -> None:
    """A higher threshold finds fewer stars; impossible sizes are refused on board."""
    bench.do("TAKE_IMAGE")
    many = int(bench.do("FIND_CENTROIDS").values["centroids"])
    bench.do("SET_DETECTION", threshold_dn=100)
    few = int(bench.do("FIND_CENTROIDS").values["centroids"])
    assert few < many
    assert bench.do("SET_DETECTION", min_pixels=30, max_pixels=20).reason == "out_of_range"


def test_bad_arguments_never_leave_the_ground(bench: Bench) -> None:
    """Range and type are checked before anything is queued; ids are not used up."""
    before = bench.host.next_request_id
    for name, arguments in (
        ("SET_EXPOSURE", {"exposure_ms": 1001}),
        ("SET_MODE", {"mode": "sleep"}),
        ("HELLO", {"x": 1}),
    ):
        with pytest.raises(BadInput):
            bench.host.submit(name, arguments, bench.now_s)
    with pytest.raises(NotFound):
        bench.host.submit("SELF_DESTRUCT", {}, bench.now_s)
    assert bench.host.next_request_id == before


def test_the_device_checks_ranges_itself(bench: Bench) -> None:
    """A ground that does not check is answered out_of_range; too few or too many bytes are bad_length."""
    lane = bench.host._lane
    for request_id, payload, reason in (
        (900, b"\xff\xff", "out_of_range"),
        (901, b"\1", "bad_length"),
        (902, bytes(3), "bad_length"),
    ):
        lane.add(request_id, "SET_EXPOSURE", {"exposure_ms": 5})
        record = lane.record(request_id)
        assert record is not None
        record.payload = payload
        bench.until(lambda i=request_id: bench.stage(i) is Stage.REJECTED)
        assert bench.stages(request_id)[-1].reason == reason


def test_preview_shows_the_bytes_that_go_out(bench: Bench) -> None:
    """The dry run is the packet of the next submit, group by group."""
    groups = bench.host.preview("TAKE_IMAGE", {"slot": 2, "exposure_ms": 300})
    assert [label for label, _ in groups][8:] == ["slot", "exposure_ms", "CRC-32"]
    assert dict(groups)["slot"] == b"\x02"
    assert dict(groups)["exposure_ms"] == b"\x01\x2c"
    bench.host.submit("TAKE_IMAGE", {"slot": 2, "exposure_ms": 300}, bench.now_s)
    out, _ = bench.host.poll(bench.now_s)
    from cobs import cobs

    assert cobs.decode(out.strip(b"\0")) == b"".join(data for _, data in groups)


def test_a_ground_without_memory_goes_on_above_the_ids_of_the_device(bench: Bench) -> None:
    """HELLO tells the highest id; a wiped server never gets an old report for a new command."""
    for _ in range(4):
        bench.do("TAKE_IMAGE")
    bench.host, bench.events = HostSession(bench.dictionary), []
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.host.hello is not None)
    end = bench.do("TAKE_IMAGE")
    assert not end.replayed
    assert end.values["frame_number"] == 5


def test_silence_makes_a_command_unknown_and_a_retry_brings_the_stored_answer(bench: Bench) -> None:
    """A lost answer is neither success nor failure; the same id again is answered and not carried out twice."""
    request_id = bench.host.submit("TAKE_IMAGE", {}, bench.now_s)
    bench.until(lambda: bench.stage(request_id) is Stage.STARTED)
    bench.connected = False
    bench.until(lambda: bench.stage(request_id) is Stage.UNKNOWN)
    assert "completion" in bench.stages(request_id)[-1].detail
    frames = bench.memory.record.frames
    bench.connected = True
    bench.host.retry(request_id, bench.now_s)
    bench.until(lambda: bench.stage(request_id) is Stage.COMPLETED)
    end = bench.stages(request_id)[-1]
    assert end.replayed
    assert end.attempt == 2
    assert end.values == {"frame_number": 1, "slot": 0}
    assert bench.memory.record.frames == frames == 1


def test_retry_is_only_for_the_unknown(bench: Bench) -> None:
    """A finished command cannot be sent again under its id."""
    end = bench.do("GET_STATUS")
    with pytest.raises(Conflict, match="completed"):
        bench.host.retry(end.request_id, bench.now_s)
    with pytest.raises(NotFound):
        bench.host.retry(4711, bench.now_s)


def test_a_late_report_counts_and_says_so(bench: Bench) -> None:
    """What comes after the window still settles the command, marked late."""
    request_id = bench.host.submit("TAKE_IMAGE", {}, bench.now_s)
    bench.until(lambda: bench.stage(request_id) is Stage.STARTED)
    held: list[bytes] = []
    feed, bench.host.feed = bench.host.feed, lambda data, now_s: held.append(data) or []  # type: ignore[method-assign]
    bench.until(lambda: bench.stage(request_id) is Stage.UNKNOWN)
    bench.host.feed = feed  # type: ignore[method-assign]
    bench.events += bench.host.feed(b"".join(held), bench.now_s)
    end = bench.stages(request_id)[-1]
    assert (end.stage, end.late) == (Stage.COMPLETED, True)


def test_the_same_id_with_other_content_is_rejected(bench: Bench) -> None:
    """Ids are never re-used for something else."""
    done = bench.do("SET_EXPOSURE", exposure_ms=100)
    bench.host._ids.following = done.request_id
    bench.events.clear()
    again = bench.do("SET_EXPOSURE", exposure_ms=101)
    assert again.request_id == done.request_id
    assert (again.stage, again.reason) == (Stage.REJECTED, "id_reused")
    assert bench.tracker.exposure_ms == 100


def test_device_remembers_the_last_64_commands_over_a_restart(bench: Bench) -> None:
    """The ring of ids is part of the non-volatile record."""
    first = bench.do("GET_STATUS").request_id
    for _ in range(63):
        bench.do("GET_STATUS")
    assert bench.memory.request(first) is not None
    bench.do("GET_STATUS")
    assert bench.memory.request(first) is None
    assert len(bench.memory.record.requests) == 64


def test_another_dictionary_blocks_commanding_until_acknowledged(make_bench: Callable[..., Bench]) -> None:
    """HELLO still works, everything else waits for the operator; unacknowledged packets are refused on board."""
    from importlib import resources

    text = resources.files("gss.device").joinpath("dictionary.yaml").read_text("utf-8")
    other = parse_dictionary(text.replace("purpose: Send housekeeping now", "purpose: Housekeeping"))
    bench = make_bench(dictionary=other)
    bench.until(lambda: bench.host.hello is not None)
    hello = next(e for e in bench.events if isinstance(e, HelloReceived))
    assert not hello.dictionary_match
    with pytest.raises(Conflict, match="another dictionary"):
        bench.host.submit("GET_STATUS", {}, bench.now_s)
    assert bench.do("HELLO").stage is Stage.COMPLETED
    assert not bench.telemetry("housekeeping")
    bench.host._lane.add(800, "GET_STATUS", {})
    bench.until(lambda: bench.stage(800) is Stage.REJECTED)
    assert bench.stages(800)[-1].reason == "wrong_dictionary"
    bench.host.acknowledge_mismatch()
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED


def test_abort_overtakes_the_queue_and_stops_what_runs(bench: Bench) -> None:
    """ABORT has its own lane, here and on board."""
    running = bench.host.submit("RUN_ITERATION", {}, bench.now_s)
    waiting = bench.host.submit("GET_STATUS", {}, bench.now_s)
    bench.until(lambda: bench.stage(running) is Stage.STARTED)
    abort = bench.host.abort(bench.now_s)
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED, 0.2)
    assert bench.stage(running) is Stage.FAILED
    assert bench.stages(running)[-1].reason == "aborted"
    bench.until(lambda: bench.stage(waiting) is Stage.COMPLETED)


def test_a_reset_in_the_middle_fails_the_running_command_and_says_so(bench: Bench) -> None:
    """After the reset the device reports what was cut off; nothing stays open for ever."""
    running = bench.host.submit("TAKE_IMAGE", {}, bench.now_s)
    bench.until(lambda: bench.stage(running) is Stage.STARTED)
    bench.device.reset("watchdog", bench.now_s)
    bench.until(lambda: bench.stage(running) is Stage.FAILED)
    assert bench.stages(running)[-1].reason == "reset"
    boots = [e.text for e in bench.events if isinstance(e, DeviceEvent) and e.name == "BOOT"]
    assert boots[-1] == "watchdog, boot 2"
    bench.until(lambda: bench.host.hello is not None and bench.host.hello.boot_count == 2)


def test_reset_command_completes_and_restarts(bench: Bench) -> None:
    """RESET answers before it acts; image memory is empty afterwards, the clock goes on."""
    bench.do("TAKE_IMAGE")
    before_s = bench.device.time_s
    assert bench.do("RESET").stage is Stage.COMPLETED
    bench.run(1.0)
    assert bench.do("FIND_CENTROIDS").reason == "no_image"
    assert bench.device.time_s > before_s
    bench.do("GET_STATUS")
    assert bench.host.housekeeping is not None
    assert (bench.host.housekeeping["resets"], bench.host.housekeeping["reset_cause"]) == (1, "command")


def test_losing_the_line_makes_what_was_sent_unknown_and_keeps_the_queue(bench: Bench) -> None:
    """Nothing is re-sent by itself; what was never sent goes out when the line is back."""
    sent = bench.host.submit("TAKE_IMAGE", {}, bench.now_s)
    queued = bench.host.submit("GET_STATUS", {}, bench.now_s)
    bench.step()
    bench.events += bench.host.link_lost(bench.now_s)
    assert bench.stage(sent) is Stage.UNKNOWN
    assert bench.stage(queued) is Stage.QUEUED
    bench.run(3.0)
    assert bench.stage(queued) is Stage.QUEUED
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.stage(queued) is Stage.COMPLETED)


def test_after_a_restart_of_the_server_commands_come_back_as_unknown(bench: Bench) -> None:
    """Ids go on from where they were; only the operator sends an old command again."""
    done = bench.do("TAKE_IMAGE")
    host = HostSession(bench.dictionary)
    host.restore(done.request_id + 1, [(done.request_id, "TAKE_IMAGE", {"slot": 0, "exposure_ms": 0})])
    bench.host, bench.events = host, []
    host.link_up(bench.now_s)
    bench.run(1.0)
    assert bench.stage(done.request_id) is Stage.UNKNOWN
    host.retry(done.request_id, bench.now_s)
    bench.until(lambda: bench.stage(done.request_id) is Stage.COMPLETED)
    assert bench.stages(done.request_id)[-1].replayed
    assert bench.memory.record.frames == 1


@pytest.mark.parametrize("seed_share", [1e-4])
def test_commands_get_through_a_noisy_line_with_retries(make_bench: Callable[..., Bench], seed_share: float) -> None:
    """At a bit error rate of 1e-4 every command ends, and none is carried out twice."""
    bench = make_bench(faults=FaultRates(bit_error_rate=seed_share))
    bench.until(lambda: bench.host.hello is not None, 60.0)
    bench.memory.record.frames = 0
    for count in range(1, 13):
        end = bench.do("TAKE_IMAGE")
        while end.stage is Stage.UNKNOWN:
            bench.host.retry(end.request_id, bench.now_s)
            bench.run(0.05)
            bench.until(lambda e=end: bench.stage(e.request_id) in (Stage.COMPLETED, Stage.UNKNOWN))  # type: ignore[misc]
            end = bench.stages(end.request_id)[-1]
        assert end.values["frame_number"] == count
    assert bench.memory.record.frames == 12


def test_counters_tell_both_directions(bench: Bench) -> None:
    """Bytes and packets each way, and when something good last came."""
    before, heard = bench.host.counters, bench.device._receiver.good
    for _ in range(3):
        bench.do("GET_STATUS")
    counters = bench.host.counters
    assert counters.sent.good - before.sent.good == bench.device._receiver.good - heard == 3
    assert counters.received.good - before.received.good == 3 * 4
    assert counters.received.bytes > before.received.bytes
    assert counters.received.bad == 0
    assert counters.last_good_s == pytest.approx(bench.now_s, abs=0.1)
    assert any(isinstance(e, LinkCounters) for e in bench.events)
