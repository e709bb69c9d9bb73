"""ABORT has a lane of its own: whatever waits or fills the line, it is the next thing out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.dictionary_file import load_dictionary
from gss.device.protocol.line import LineReceiver
from gss.device.session import Compatibility
from gss.device.session_events import Stage
from gss.domain.errors import Conflict, NotFound

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Bench


def names_in(data: bytes) -> list[str]:
    """Commands and service messages in these bytes, in order."""
    dictionary = load_dictionary()
    names = []
    for packet in LineReceiver(from_device=False).feed(b"\0" + data):
        command = dictionary.command_of_code(packet.code) if packet.type.name == "COMMAND" else None
        service = dictionary.service_of_code("transfer", packet.code)
        names.append(command.name if command else service.name if service else "?")
    return names


def test_abort_passes_four_commands_that_wait(bench: Bench) -> None:
    """One under way and four behind it: ABORT is in the next bytes out, alone, and the device stops what runs."""
    bench.do("SET_MODE", mode="lost_in_space")
    running = bench.host.submit("RUN_ITERATION", {}, bench.now_s)
    bench.until(lambda: bench.stage(running) in (Stage.STARTED, Stage.PROGRESS))
    waiting = [bench.host.submit("SET_EXPOSURE", {"exposure_ms": 100 + k}, bench.now_s) for k in range(4)]
    abort = bench.host.abort(bench.now_s)
    out, events = bench.host.poll(bench.now_s)
    assert names_in(out) == ["ABORT"]
    bench.events += events
    bench._up += out
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED, 2.0)
    assert (bench.stage(running), bench.stages(running)[-1].reason) == (Stage.FAILED, "aborted")
    bench.until(lambda: all(bench.stage(i) is Stage.COMPLETED for i in waiting))


def test_abort_passes_a_transfer_that_fills_the_window(make_bench: Callable[..., Bench]) -> None:
    """With the window full of chunks that nobody has confirmed no chunk goes before it, and the transfer ends on board."""
    bench = make_bench(baud=115_200)
    bench.until(lambda: bench.host.hello is not None)
    data = np.random.default_rng(1).integers(0, 256, 512 * 1024, dtype=np.uint8).tobytes()
    transfer = bench.host.start_upload("image", 1, data, Compatibility(), bench.now_s)
    bench.until(lambda: bool(bench.updates(transfer)) and bench.updates(transfer)[-1].stored_bytes > 16_384)
    bench.connected = False
    bench.until(lambda: bench.updates(transfer)[-1].in_flight >= 8)
    bench.connected = True
    for k in range(4):
        bench.host.submit("SET_EXPOSURE", {"exposure_ms": 100 + k}, bench.now_s)
    abort = bench.host.abort(bench.now_s)
    out, events = bench.host.poll(bench.now_s)
    assert names_in(out)[0] == "ABORT"
    bench.events += events
    bench._up += out
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED, bench.dictionary.command("ABORT").accept_s)
    bench.until(lambda: bench.updates(transfer)[-1].state in ("aborted", "failed"), 10.0)


def test_abort_goes_out_before_the_device_has_said_who_it_is(make_bench: Callable[..., Bench]) -> None:
    """Commands wait for HELLO; ABORT does not."""
    bench = make_bench()
    bench.host.submit("GET_STATUS", {}, bench.now_s)
    bench.host.abort(bench.now_s)
    out, _ = bench.host.poll(bench.now_s)
    assert names_in(out) == ["ABORT", "HELLO"]


def test_a_reserved_id_is_used_once_and_abort_may_come_between(bench: Bench) -> None:
    """An owner writes the id down before it queues the command; an ABORT meanwhile has the next one."""
    reserved = bench.host.reserve()
    abort = bench.host.abort(bench.now_s)
    assert abort == reserved + 1
    assert bench.host.submit("GET_STATUS", {}, bench.now_s, request_id=reserved) == reserved
    bench.until(lambda: bench.stage(reserved) is Stage.COMPLETED)
    assert bench.host.next_request_id == abort + 1


def test_only_what_waits_is_withdrawn(bench: Bench) -> None:
    """A queued command never reaches the line; a withdrawn retry is as unknown as before."""
    bench.connected = False
    lost = bench.host.submit("TAKE_IMAGE", {}, bench.now_s)
    bench.until(lambda: bench.stage(lost) is Stage.UNKNOWN)
    blocking = bench.host.submit("SET_EXPOSURE", {"exposure_ms": 9}, bench.now_s)
    bench.step()
    waiting = bench.host.submit("GET_STATUS", {}, bench.now_s)
    stage = bench.host.withdraw(waiting, "not needed")
    assert (stage.stage, stage.reason, stage.detail) == (Stage.FAILED, "withdrawn", "not needed")
    bench.host.retry(lost, bench.now_s)
    again = bench.host.withdraw(lost, "not now")
    assert (again.stage, again.attempt) == (Stage.UNKNOWN, 1)
    for request_id, error in ((blocking, Conflict), (waiting, Conflict), (9999, NotFound)):
        with pytest.raises(error):
            bench.host.withdraw(request_id, "too late")
    bench.connected = True
    bench.host.retry(lost, bench.now_s)
    bench.until(lambda: bench.stage(lost) is Stage.COMPLETED)
    assert not [s for s in bench.stages(waiting) if s.stage is Stage.SENT]
