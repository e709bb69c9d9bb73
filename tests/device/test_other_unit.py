"""If another unit answers on the line, commands for the previous unit are not sent to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from gss.device.protocol.transfer import Compatibility
from gss.device.session import HostSession
from gss.device.session_commands import KEPT_HELLOS, CommandQueue
from gss.device.session_events import Stage
from gss.device.session_handshake import HELLO_AGAIN_S
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.domain.errors import Conflict
from gss.instruments.dictionary.read_dictionary import load_dictionary, parse_dictionary

if TYPE_CHECKING:
    from conftest import Bench


def replace_unit(bench: Bench, *, serial: str = "SIM-0002", device_hash: bytes | None = None) -> None:
    """Open the line again, with another unit on it. ``device_hash``: hash of its dictionary, by default that of the host."""
    bench.events += bench.host.link_lost(bench.now_s)
    bench._up.clear()
    bench._down.clear()
    dictionary = bench.dictionary
    if device_hash is not None:
        dictionary = replace(dictionary, hash=device_hash, same_layout_as=frozenset())
    unit = Identity(serial=serial, line_baud=bench.baud)
    bench.device = SimulatedDevice(dictionary, unit, bench.memory, bench.tracker, bench.now_s)
    bench.host.link_up(bench.now_s)


def test_no_command_is_sent_before_the_device_identifies_itself(bench: Bench) -> None:
    """After the line was lost and reopened, a queued command is sent only after the same unit has replied to HELLO."""
    bench.until(lambda: bench.host.hello is not None)
    bench.host.link_lost(bench.now_s)
    waiting = bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 123}))
    bench.host.link_up(bench.now_s)
    out, events = bench.host.poll(bench.now_s)
    bench.events += events
    bench._up += out
    assert bench.stage(waiting) is Stage.QUEUED
    bench.until(lambda: bench.stage(waiting) is Stage.COMPLETED)


def test_queued_and_unknown_commands_do_not_reach_another_unit(bench: Bench) -> None:
    """If another unit answers, queued commands are withdrawn with its name in the detail, and unknown commands can
    be retried only when their unit is back."""
    bench.until(lambda: bench.host.hello is not None)
    lost = bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 111}))
    bench.connected = False
    bench.host.poll(bench.now_s)
    bench.events += bench.host.link_lost(bench.now_s)
    assert bench.stage(lost) is Stage.UNKNOWN
    waiting = bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 123}))
    bench.device._identity = Identity(serial="SIM-0002")
    bench.connected = True
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.stage(waiting) is Stage.FAILED)
    last = bench.stages(waiting)[-1]
    assert last.reason == "withdrawn"
    assert "SIM-0002 answered" in last.detail
    with pytest.raises(Conflict, match="another unit"):
        bench.host.retry(lost, bench.now_s)
    replace_unit(bench, serial="SIM-0001")
    bench.until(lambda: bench.host.hello.serial == "SIM-0001")
    bench.host.retry(lost, bench.now_s)
    bench.until(lambda: bench.stage(lost) is Stage.COMPLETED)


def test_a_report_of_another_unit_ends_no_command_of_the_previous_one(bench: Bench) -> None:
    """Another ground can have used the same request id for a command to the new unit."""
    orders = CommandQueue()
    orders.identified("SIM-0001")
    orders.add(7, bench.host.encode("SET_EXPOSURE", {"exposure_ms": 111}))
    orders.release(0.0)
    orders.lose_all("The line was lost.")
    orders.identified("SIM-0002")
    assert orders.report(7, Stage.COMPLETED, 1.0, {}) == ()
    orders.identified("SIM-0001")
    assert [update.stage for update in orders.report(7, Stage.COMPLETED, 2.0, {})] == [Stage.COMPLETED]


def test_a_retried_abort_does_not_reach_another_unit(bench: Bench) -> None:
    """A retried ABORT waits in the queue like any other command."""
    orders = CommandQueue()
    orders.identified("SIM-0001")
    orders.add(7, bench.host.encode("ABORT", {}), urgent=True)
    orders.release(0.0)
    orders.lose_all("The line was lost.")
    orders.retry(7)
    assert [update.stage for update in orders.identified("SIM-0002")] == [Stage.UNKNOWN]
    assert orders.release(1.0) == ([], [])


def test_no_transfer_continues_on_another_unit(bench: Bench) -> None:
    """If another unit answers, transfers that are interrupted, queued or paused fail with its name in the reason, and the new unit
    receives no message of them."""
    fits = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, format_version=1)
    upload = bench.host.transfers.start_upload("catalogue", 1, bytes(100_000), fits)
    bench.until(lambda: bench.host.transfer(upload).stored_bytes > 0)
    queued, paused = (bench.host.transfers.start_download("frame", slot) for slot in (0, 1))
    bench.host.transfers.pause(paused)
    replace_unit(bench)
    bench.until(lambda: bench.host.hello.serial == "SIM-0002")
    started = bench.host.transfers.start_download("catalogue", 3)
    bench.until(lambda: bench.host.transfer(started).stored_bytes > 0)
    for transfer_id in (upload, queued, paused):
        end = bench.host.transfer(transfer_id)
        assert (end.state, end.reason) == ("failed", "unit SIM-0002 answered, not SIM-0001")
        assert [u.state for u in bench.updates(transfer_id)].count("opening") == (transfer_id == upload)


def test_a_transfer_of_a_previous_server_does_not_continue_on_another_unit(bench: Bench) -> None:
    """After a restart of the server, the transfers of a unit fail if another unit answers, and cannot be resumed on it. They
    can be resumed when their unit is back."""
    bench.host = HostSession(bench.dictionary)
    fits = Compatibility(bench.dictionary.device_model, "cubestar", bench.dictionary.hash, 1, 1991.25)
    waiting = bench.host.transfers.start_upload("catalogue", 1, bytes(2000), fits, paused="restart", unit="SIM-0009")
    own = bench.host.transfers.start_download("catalogue", 3, paused="restart", unit="SIM-0001")
    bench.host.link_up(bench.now_s)
    bench.until(lambda: bench.host.transfer(own).stored_bytes > 0)
    end = bench.host.transfer(waiting)
    assert (end.state, end.reason) == ("failed", "unit SIM-0001 answered, not SIM-0009")
    for again in (
        lambda: bench.host.transfers.resume(waiting),
        lambda: bench.host.transfers.start_upload("catalogue", 1, bytes(2000), fits, unit="SIM-0009"),
    ):
        with pytest.raises(Conflict, match="another unit"):
            again()
    replace_unit(bench, serial="SIM-0009")
    bench.until(lambda: bench.host.hello.serial == "SIM-0009")
    bench.host.transfers.resume(waiting)
    bench.until(lambda: bench.host.transfer(waiting).stored_bytes > 0)


def test_a_transfer_starts_after_the_dictionary_was_acknowledged(bench: Bench) -> None:
    """The unit does not have to answer HELLO again."""
    replace_unit(bench, serial="SIM-0001", device_hash=b"\x11" * 32)
    download = bench.host.transfers.start_download("catalogue", 3, paused="restart")
    bench.until(lambda: not bench.host.hello.dictionary_match)
    bench.run(1.0)
    assert bench.host.transfer(download).state == "paused"
    bench.host.acknowledge_mismatch()
    bench.until(lambda: bench.host.transfer(download).stored_bytes > 0)


def test_a_command_under_way_cannot_be_retried_on_another_unit(bench: Bench) -> None:
    """If another unit answers on an open line, the outcome of a command under way is unknown and the command cannot be retried.
    ABORT, which the new unit can have received, still ends with its report."""
    under_way = bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 77}))
    bench.connected = False
    bench.run(0.05)
    assert bench.stage(under_way) is Stage.SENT
    bench._up.clear()
    bench.device._identity = Identity(serial="SIM-0002")
    bench.connected = True
    bench.host._handshake.ask_at(bench.now_s)  # as the BOOT event of the new unit does
    bench.step()
    abort = bench.host.abort(bench.now_s)
    bench.until(lambda: bench.host.hello.serial == "SIM-0002")
    last = bench.stages(under_way)[-1]
    assert (last.stage, last.detail) == (Stage.UNKNOWN, "The unit SIM-0002 answered, not SIM-0001.")
    with pytest.raises(Conflict, match="another unit"):
        bench.host.retry(under_way, bench.now_s)
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED)


def test_an_acknowledgement_is_valid_for_one_dictionary(bench: Bench) -> None:
    """An accepted mismatch is valid for this dictionary on a new line. Another dictionary blocks commanding, and
    its telemetry is not decoded, neither before nor after its reply to HELLO."""
    replace_unit(bench, device_hash=b"\x11" * 32)
    bench.until(lambda: bench.host.hello.serial == "SIM-0002")
    bench.host.acknowledge_mismatch()
    replace_unit(bench, device_hash=b"\x11" * 32, serial="SIM-0003")
    bench.until(lambda: bench.host.hello.serial == "SIM-0003")
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED
    decoded = len(bench.telemetry("housekeeping"))
    assert decoded
    replace_unit(bench, device_hash=b"\x22" * 32, serial="SIM-0004")
    bench.until(lambda: bench.host.hello.serial == "SIM-0004")
    with pytest.raises(Conflict, match="another dictionary"):
        bench.host.check_allowed("SET_EXPOSURE")
    bench.run(3.0)
    assert len(bench.telemetry("housekeeping")) == decoded
    bench.host.acknowledge_mismatch()
    assert bench.do("GET_STATUS").stage is Stage.COMPLETED


def test_a_unit_with_an_earlier_wording_of_the_same_layout_is_commanded_as_usual(
    make_bench: Callable[..., Bench],
) -> None:
    """The earlier dictionaries, among them that of version 0.4, differ only in descriptions, so there is no mismatch. Packets
    have the device's dictionary prefix."""
    for earlier in make_bench().dictionary.same_layout_as:
        bench = make_bench()
        old = replace(bench.dictionary, hash=earlier, same_layout_as=frozenset())
        bench.device = SimulatedDevice(old, Identity(line_baud=bench.baud), bench.memory, bench.tracker, bench.now_s)
        bench.until(lambda bench=bench: bench.host.hello is not None)
        assert bench.host.hello.dictionary_match
        assert bench.do("TAKE_IMAGE").stage is Stage.COMPLETED
        assert bench.telemetry("housekeeping")
        assert bench.download("frame", 0)


def test_descriptions_do_not_change_the_hash_and_layout_does() -> None:
    """Another description does not change the hash; another code does."""
    from importlib import resources

    text = resources.files("gss.instruments.dictionary").joinpath("gss-common.yaml").read_text("utf-8")
    original_hash = parse_dictionary(text).hash
    purpose = next(line for line in text.splitlines() if "purpose: " in line)
    assert (
        parse_dictionary(text.replace(purpose, purpose.replace("purpose: ", "purpose: Other, "), 1)).hash
        == original_hash
    )
    assert parse_dictionary(text.replace("code: 16,", "code: 216,", 1)).hash != original_hash


def test_hello_is_repeated_after_the_pause_of_the_instrument() -> None:
    """Without a reply, the session repeats HELLO after ``hello_again_s`` of link.yaml, and not earlier."""
    session = HostSession(load_dictionary(), hello_again_s=7.0)
    session.link_up(0.0)
    assert [bool(session.poll(now_s)[0]) for now_s in (0.0, 6.9, 7.0, 13.9, 14.0)] == [True, False, True, False, True]


def test_unanswered_hellos_are_forgotten_but_a_late_answer_still_identifies(make_bench: Callable[..., Bench]) -> None:
    """During an hour of silence the number of tracked commands remains constant. A reply to one of the last HELLOs that timed out
    still identifies the device, for a line with a long delay."""
    bench = make_bench()
    for second in range(100, 3_700, 3):
        frames, _ = bench.host.poll(float(second))
    assert len(bench.host._command_queue._records) <= KEPT_HELLOS + 2
    bench.now_s = second + 1.0
    late_s = bench.now_s + 10 * HELLO_AGAIN_S
    bench.device.advance(bench.now_s)
    bench.device.feed(frames, bench.now_s)
    while bench.now_s < late_s:
        bench.now_s += 0.5
        bench.host.poll(bench.now_s)
    reply = b"".join(iter(lambda: bench.device.next_frame(bench.now_s) or b"", b""))
    bench.host.feed(reply, bench.now_s)
    assert bench.host.hello is not None
