"""Transfers belong to the unit with which they were started, also after a restart of the server."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gss.domain.errors import Conflict
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services


def wait(done: Callable[[], Any]) -> None:
    """Wait until ``done()`` is true. The timeout in real time only limits how long a failing test runs."""
    limit_s = time.monotonic() + 60
    while not done():
        assert time.monotonic() < limit_s
        time.sleep(0.005)


def connect(folder: Path, sensor: Any) -> Services:
    """Return the services of a new server in this folder, connected to the sensor."""
    services = build(Settings(data=folder))
    services.transfers.transfers.start()
    services.dispatcher.start()
    services.line.link.start()
    sensor.keep_pace_with(services.line.link.events)
    services.line.link.open_later(sensor.url)
    wait(lambda: services.line.link.hello is not None)
    return services


@pytest.mark.parametrize("serial", ["FM-1", ""])
def test_a_transfer_of_another_unit_does_not_continue_after_a_restart(
    tmp_path: Path, sensor_in_memory: Callable[..., Any], serial: str
) -> None:
    """If another unit answers, the paused transfer fails and cannot be resumed on it. It can be resumed on its own unit, also if
    that has no serial number."""
    services = connect(tmp_path, sensor_in_memory(serial=serial))
    hello = services.line.link.hello
    assert hello is not None
    transfer_id = services.transfers.transfers.download("catalogue", 3, "golden bank").row.id
    services.transfers.transfers.pause(transfer_id)
    services.stop()

    services = connect(tmp_path, sensor_in_memory(serial="FM-2"))
    transfers = services.transfers.transfers
    wait(lambda: transfers.get(transfer_id).row.state == "failed")
    assert transfers.get(transfer_id).row.reason == f"unit FM-2 answered, not {hello.unit_name}"
    with pytest.raises(Conflict, match="another unit"):
        transfers.resume(transfer_id)
    assert transfers.get(transfer_id).row.state == "failed"
    services.stop()

    services = connect(tmp_path, sensor_in_memory(serial=serial))
    services.transfers.transfers.resume(transfer_id)
    wait(lambda: services.transfers.transfers.get(transfer_id).row.state == "verified")
    services.stop()
