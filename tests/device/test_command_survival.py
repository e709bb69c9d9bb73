"""Commands during failures: no response, resets, lost lines, other dictionaries, noise."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from gss.device.protocol.codec import decode, encode
from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.session import HostSession
from gss.device.session_events import DeviceEvent, HelloReceived, LinkCounters, Stage
from gss.device.simulator.faults import FaultRates
from gss.domain.errors import Conflict, NotFound
from gss.instruments.dictionary.definitions import Value
from gss.instruments.dictionary.read_dictionary import parse_dictionary

if TYPE_CHECKING:
    from conftest import Bench


def test_a_ground_without_stored_ids_continues_above_the_ids_of_the_device(bench: Bench) -> None:
    """The reply to HELLO has the highest used id, so a new server does not get the stored report of an old command."""
    for _ in range(4):
        bench.do("TAKE_IMAGE")
    bench.host, bench.events = HostSession(bench.dictionary), []
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.host.hello is not None)
    end = bench.do("TAKE_IMAGE")
    assert not end.replayed
    assert end.values["frame_number"] == 5


def test_a_missing_report_makes_a_command_unknown_and_a_retry_gets_the_stored_one(bench: Bench) -> None:
    """If a report is lost, the command is unknown. The device answers a retry with the same id from memory and does not
    execute it twice."""
    request_id = bench.host.submit(bench.host.encode("TAKE_IMAGE", {}))
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


def test_only_unknown_commands_can_be_retried(bench: Bench) -> None:
    """A retry of a completed command or of an unknown id is rejected."""
    end = bench.do("GET_STATUS")
    with pytest.raises(Conflict, match="completed"):
        bench.host.retry(end.request_id, bench.now_s)
    with pytest.raises(NotFound):
        bench.host.retry(4711, bench.now_s)


def test_a_late_report_is_used_and_marked(bench: Bench) -> None:
    """A report that arrives after the time limit determines the result and is marked as late."""
    request_id = bench.host.submit(bench.host.encode("TAKE_IMAGE", {}))
    bench.until(lambda: bench.stage(request_id) is Stage.STARTED)
    delayed: list[bytes] = []
    feed, bench.host.feed = bench.host.feed, lambda data, now_s: delayed.append(data) or []  # type: ignore[method-assign]
    bench.until(lambda: bench.stage(request_id) is Stage.UNKNOWN)
    bench.host.feed = feed  # type: ignore[method-assign]
    bench.events += bench.host.feed(b"".join(delayed), bench.now_s)
    end = bench.stages(request_id)[-1]
    assert (end.stage, end.late) == (Stage.COMPLETED, True)


def test_the_same_id_with_other_content_is_rejected_on_board(bench: Bench) -> None:
    """The device rejects a used id with other arguments and does not execute the command."""
    done = bench.do("SET_EXPOSURE", exposure_ms=100)
    bench.host._ids.following = done.request_id
    bench.events.clear()
    again = bench.do("SET_EXPOSURE", exposure_ms=101)
    assert again.request_id == done.request_id
    assert (again.stage, again.reason) == (Stage.REJECTED, "id_reused")
    assert bench.tracker.exposure_ms == 100


def test_the_device_stores_the_last_64_commands(bench: Bench) -> None:
    """The non-volatile record contains the last 64 request ids."""
    first = bench.do("GET_STATUS").request_id
    for _ in range(63):
        bench.do("GET_STATUS")
    assert bench.memory.request(first) is not None
    bench.do("GET_STATUS")
    assert bench.memory.request(first) is None
    assert len(bench.memory.record.requests) == 64


def test_another_dictionary_blocks_commanding_until_acknowledged(make_bench: Callable[..., Bench]) -> None:
    """With another dictionary only HELLO is sent until the operator acknowledges it. The device rejects other commands
    before."""
    from importlib import resources

    text = resources.files("gss.instruments.dictionary").joinpath("gss-common.yaml").read_text("utf-8")
    other = parse_dictionary(re.sub(r"^version: \d+$", "version: 999", text, count=1, flags=re.MULTILINE))
    bench = make_bench(dictionary=other)
    bench.until(lambda: bench.host.hello is not None)
    hello = next(e for e in bench.events if isinstance(e, HelloReceived))
    assert not hello.dictionary_match
    with pytest.raises(Conflict, match="another dictionary"):
        bench.host.submit(bench.host.encode("GET_STATUS", {}))
    assert bench.do("HELLO").stage is Stage.COMPLETED
    assert not bench.telemetry("housekeeping")
    bench.host._command_queue.add(800, bench.host.encode("GET_STATUS", {}))
    bench.until(lambda: bench.stage(800) is Stage.REJECTED)
    assert bench.stages(800)[-1].reason == "wrong_dictionary"
    bench.host.acknowledge_mismatch()
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED


def test_abort_overtakes_the_queue_and_stops_the_running_command(bench: Bench) -> None:
    """ABORT is sent before queued commands and stops the running one. The queued command is executed afterwards."""
    running = bench.host.submit(bench.host.encode("RUN_ITERATION", {}))
    waiting = bench.host.submit(bench.host.encode("GET_STATUS", {}))
    bench.until(lambda: bench.stage(running) is Stage.STARTED)
    abort = bench.host.abort(bench.now_s)
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED, 0.2)
    assert bench.stage(running) is Stage.FAILED
    assert bench.stages(running)[-1].reason == "aborted"
    bench.until(lambda: bench.stage(waiting) is Stage.COMPLETED)


def test_a_reset_during_a_command_reports_it_as_failed(bench: Bench) -> None:
    """After a reset the device reports the interrupted command as failed and sends its boot event."""
    running = bench.host.submit(bench.host.encode("TAKE_IMAGE", {}))
    bench.until(lambda: bench.stage(running) is Stage.STARTED)
    bench.device.reset("watchdog", bench.now_s)
    bench.until(lambda: bench.stage(running) is Stage.FAILED)
    assert bench.stages(running)[-1].reason == "reset"
    boots = [e.text for e in bench.events if isinstance(e, DeviceEvent) and e.name == "BOOT"]
    assert boots[-1] == "watchdog, boot 2"
    bench.until(lambda: bench.host.hello is not None and bench.host.hello.boot_count == 2)


def test_reset_command_completes_and_restarts(bench: Bench) -> None:
    """RESET is reported as completed before it is executed. Image memory is then empty, and the clock continues."""
    bench.do("TAKE_IMAGE")
    before_s = bench.device.time_s
    assert bench.do("RESET").stage is Stage.COMPLETED
    bench.run(1.0)
    assert bench.do("FIND_CENTROIDS").reason == "no_image"
    assert bench.device.time_s > before_s
    bench.do("GET_STATUS")
    assert bench.host.housekeeping is not None
    assert (bench.host.housekeeping["resets"], bench.host.housekeeping["reset_cause"]) == (1, "command")


def test_losing_the_line_makes_sent_commands_unknown_and_keeps_the_queue(bench: Bench) -> None:
    """After the line is lost, sent commands are unknown and are not repeated. Queued commands are sent when the line is
    open again."""
    sent = bench.host.submit(bench.host.encode("TAKE_IMAGE", {}))
    queued = bench.host.submit(bench.host.encode("GET_STATUS", {}))
    bench.step()
    bench.events += bench.host.link_lost(bench.now_s)
    assert bench.stage(sent) is Stage.UNKNOWN
    assert bench.stage(queued) is Stage.QUEUED
    bench.run(3.0)
    assert bench.stage(queued) is Stage.QUEUED
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.stage(queued) is Stage.COMPLETED)


def test_after_a_restart_of_the_server_commands_are_unknown(bench: Bench) -> None:
    """After a restart of the server, commands without a final report are unknown. A retry by the operator returns the
    stored report."""
    done = bench.do("TAKE_IMAGE")
    host = HostSession(bench.dictionary)
    host.restore(done.request_id + 1, [(done.request_id, host.encode("TAKE_IMAGE", {"slot": 0, "exposure_ms": 0}))])
    bench.host, bench.events = host, []
    host.link_up(bench.now_s)
    bench.run(1.0)
    assert bench.stage(done.request_id) is Stage.UNKNOWN
    host.retry(done.request_id, bench.now_s)
    bench.until(lambda: bench.stage(done.request_id) is Stage.COMPLETED)
    assert bench.stages(done.request_id)[-1].replayed
    assert bench.memory.record.frames == 1


@pytest.mark.parametrize("seed_share", [1e-4])
def test_commands_pass_a_noisy_line_with_retries(make_bench: Callable[..., Bench], seed_share: float) -> None:
    """At a bit error rate of 1e-4, every command completes after retries, and none is executed twice."""
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


def test_counters_cover_both_directions(bench: Bench) -> None:
    """The counters have the bytes and packets of each direction and the time of the last valid packet."""
    before, received = bench.host.counters, bench.device._receiver.good
    for _ in range(3):
        bench.do("GET_STATUS")
    counters = bench.host.counters
    assert counters.sent.good - before.sent.good == bench.device._receiver.good - received == 3
    assert counters.received.good - before.received.good == 3 * 4
    assert counters.received.bytes > before.received.bytes
    assert counters.received.bad == 0
    assert counters.last_good_s == pytest.approx(bench.now_s, abs=0.1)
    assert any(isinstance(e, LinkCounters) for e in bench.events)


def replay(bench: Bench, name: str, request_id: int, **arguments: Value) -> tuple[str, str]:
    """Send a command's frame directly to the device. Return stage and reason of its last report."""
    command = bench.dictionary.command(name)
    payload = encode(command.arguments, {a.name: a.default for a in command.arguments} | arguments)
    frame = bench.host.craft(PacketType.COMMAND, command.code, payload, request_id=request_id)[1]
    bench.device.feed(frame, bench.now_s)
    receiver, fields = LineReceiver(from_device=True), bench.dictionary.service("REPORT").fields
    frames = iter(lambda: bench.device.next_frame(bench.now_s), None)
    packets = [packet for sent in frames for packet in receiver.feed(sent)]
    reports = [p for p in packets if p.type is PacketType.REPORT and p.request_id == request_id]
    answer = decode(fields, reports[-1].payload).values
    return str(answer["stage"]), str(answer["reason"])


def test_a_command_no_longer_stored_is_never_executed_again(bench: Bench) -> None:
    """After more than 64 other commands, a replayed TAKE_IMAGE is rejected and no image is taken. An id of 0 is rejected
    too."""
    old = bench.do("TAKE_IMAGE").request_id
    for _ in range(70):
        bench.do("GET_STATUS")
    frames = bench.memory.record.frames
    assert replay(bench, "TAKE_IMAGE", old) == ("rejected", "id_reused")
    assert replay(bench, "TAKE_IMAGE", 0) == ("rejected", "id_reused")
    bench.run(3.0)
    assert bench.memory.record.frames == frames == 1


def test_a_command_lost_on_the_line_may_be_retried_after_newer_ones(bench: Bench) -> None:
    """The device accepts an id below the highest one if it never received it and still stores all executed ids."""
    first = bench.do("GET_STATUS").request_id
    lost = first + 1
    bench.host._ids.following = first + 2
    for _ in range(20):
        bench.do("GET_STATUS")
    assert replay(bench, "SET_GAIN", lost, gain=2)[0] == "completed"
