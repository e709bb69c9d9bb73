"""What becomes of commands when something goes wrong: silence, resets, lost lines, other dictionaries, noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from gss.device.dictionary_file import parse_dictionary
from gss.device.session import HostSession
from gss.device.session_events import DeviceEvent, HelloReceived, LinkCounters, Stage
from gss.device.simulator.faults import FaultRates
from gss.domain.errors import Conflict, NotFound

if TYPE_CHECKING:
    from conftest import Bench


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
