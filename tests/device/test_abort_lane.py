"""ABORT is sent before all queued commands and transfers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import Stage
from gss.domain.errors import Conflict, NotFound
from gss.instruments.dictionary.read_dictionary import load_dictionary

if TYPE_CHECKING:
    from collections.abc import Callable

    from conftest import Bench


def names_in(data: bytes) -> list[str]:
    """Return the commands and service messages in these bytes, in order."""
    dictionary = load_dictionary()
    names = []
    for packet in LineReceiver(from_device=False).feed(b"\0" + data):
        command = dictionary.command_of_code(packet.code) if packet.type.name == "COMMAND" else None
        service = dictionary.service_of_code("transfer", packet.code)
        names.append(command.name if command else service.name if service else "?")
    return names


def test_abort_passes_four_queued_commands(bench: Bench) -> None:
    """With one command running and four queued, the next packet is ABORT alone. The device stops the running command and
    then executes the queued ones."""
    bench.do("SET_MODE", mode="lost_in_space")
    running = bench.host.submit(bench.host.encode("RUN_ITERATION", {}))
    bench.until(lambda: bench.stage(running) in (Stage.STARTED, Stage.PROGRESS))
    waiting = [bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 100 + k})) for k in range(4)]
    abort = bench.host.abort(bench.now_s)
    out, events = bench.host.poll(bench.now_s)
    assert names_in(out) == ["ABORT"]
    bench.events += events
    bench._up += out
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED, 2.0)
    assert (bench.stage(running), bench.stages(running)[-1].reason) == (Stage.FAILED, "aborted")
    bench.until(lambda: all(bench.stage(i) is Stage.COMPLETED for i in waiting))


def test_abort_passes_a_transfer_that_fills_the_window(make_bench: Callable[..., Bench]) -> None:
    """If the window is full of unacknowledged chunks, ABORT is sent before any chunk, and the transfer ends on board."""
    bench = make_bench(baud=115_200)
    bench.until(lambda: bench.host.hello is not None)
    data = np.random.default_rng(1).integers(0, 256, 512 * 1024, dtype=np.uint8).tobytes()
    transfer = bench.host.transfers.start_upload("image", 1, data, Compatibility())
    bench.until(lambda: bool(bench.updates(transfer)) and bench.updates(transfer)[-1].stored_bytes > 16_384)
    bench.connected = False
    bench.until(lambda: bench.updates(transfer)[-1].in_flight >= 8)
    bench.connected = True
    for k in range(4):
        bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 100 + k}))
    abort = bench.host.abort(bench.now_s)
    out, events = bench.host.poll(bench.now_s)
    assert names_in(out)[0] == "ABORT"
    bench.events += events
    bench._up += out
    bench.until(lambda: bench.stage(abort) is Stage.COMPLETED, bench.dictionary.command("ABORT").accept_s)
    bench.until(lambda: bench.updates(transfer)[-1].state in ("aborted", "failed"), 10.0)


def test_abort_is_sent_before_the_device_has_identified_itself(make_bench: Callable[..., Bench]) -> None:
    """A command waits for the reply to HELLO. ABORT is sent immediately."""
    bench = make_bench()
    bench.host.submit(bench.host.encode("GET_STATUS", {}))
    bench.host.abort(bench.now_s)
    out, _ = bench.host.poll(bench.now_s)
    assert names_in(out) == ["ABORT", "HELLO"]


def test_abort_can_be_sent_while_an_id_is_reserved(bench: Bench) -> None:
    """The caller reserves an id before it queues the command. An ABORT sent in between gets the next id."""
    reserved_id = bench.host.reserve()
    abort = bench.host.abort(bench.now_s)
    assert abort == reserved_id + 1
    assert bench.host.submit(bench.host.encode("GET_STATUS", {}), request_id=reserved_id) == reserved_id
    bench.until(lambda: bench.stage(reserved_id) is Stage.COMPLETED)
    assert bench.host.next_request_id == abort + 1


def test_only_queued_commands_are_withdrawn(bench: Bench) -> None:
    """A withdrawn command is not sent. A command whose retry is withdrawn remains unknown. A sent command cannot be
    withdrawn."""
    bench.connected = False
    lost = bench.host.submit(bench.host.encode("TAKE_IMAGE", {}))
    bench.until(lambda: bench.stage(lost) is Stage.UNKNOWN)
    blocking = bench.host.submit(bench.host.encode("SET_EXPOSURE", {"exposure_ms": 9}))
    bench.step()
    waiting = bench.host.submit(bench.host.encode("GET_STATUS", {}))
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
