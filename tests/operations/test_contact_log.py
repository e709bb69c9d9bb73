"""Stored properties of a contact's device."""

from __future__ import annotations

import pytest

from gss.device.session_events import DirectionCounters, HelloReceived, LinkCounters
from gss.domain.errors import BadInput
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch, LineOpened
from gss.operations.line.link import LinkService
from gss.store import devices

OWN = "socket://127.0.0.1:5555"
UNIT = HelloReceived("star tracker", "nos3", "not reported", "", None, "0", True, 0, 0, 0, 0, 0, 0, 0, 0, 0.0)
COUNTERS = LinkCounters(DirectionCounters(), DirectionCounters(), None)


@pytest.mark.parametrize(("url", "simulated"), [(OWN, True), ("socket://127.0.0.1:5556", None)])
def test_a_unit_at_the_address_of_the_servers_simulator_is_simulated(url, simulated, database, bus, clock, tmp_path):
    """A unit whose protocol does not report it is simulated if it has the address of the server's simulator; otherwise this
    is not known. Link and stored device agree."""
    link = LinkService(
        load_dictionary(),
        default_roles(load_dictionary()),
        database,
        bus,
        tmp_path,
        clock,
        lambda: 0.0,
        LineEventQueue(clock, lambda: 0.0),
        own_simulator=OWN,
    )
    link.handle(LineBatch((LineOpened(url, 1, "", COUNTERS), UNIT), clock(), 0.0))
    assert link.last_hello.simulated is simulated
    with database.unit_of_work() as session:
        device = devices.get_contact(session, 1)[1]
    assert device is not None
    assert device.simulated is simulated


def test_a_line_that_does_not_fit_the_framing_is_rejected(database, bus, clock, tmp_path) -> None:
    """A CAN line is rejected for a sensor with a framing for serial lines."""
    queue = LineEventQueue(clock, lambda: 0.0)
    link = LinkService(
        load_dictionary(), default_roles(load_dictionary()), database, bus, tmp_path, clock, lambda: 0.0, queue
    )
    with pytest.raises(BadInput, match="does not fit the sensor's framing cobs"):
        link.open("can://socketcan/can0")
