"""Stored properties of a contact's device."""

from __future__ import annotations

import pytest

from gss.device.session_events import DirectionCounters, HelloReceived, LinkCounters
from gss.domain.errors import BadInput, Conflict
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch, LineOpened
from gss.operations.line.link import LinkService
from gss.store import devices

OWN = "socket://127.0.0.1:5555"
UNIT = HelloReceived("star tracker", "nos3", "not reported", "", None, "0", True, 0, 0, 0, 0, 0, 0, 0, 0, 0.0)
COUNTERS = LinkCounters(DirectionCounters(), DirectionCounters(), None)


def link_of(database, bus, clock, tmp_path, own_simulator: str = "") -> LinkService:
    dictionary, queue = load_dictionary(), LineEventQueue(clock, lambda: 0.0)
    roles = default_roles(dictionary)
    return LinkService(
        dictionary, roles, database, bus, tmp_path, clock, lambda: 0.0, queue, own_simulator=own_simulator
    )


@pytest.mark.parametrize(("url", "simulated"), [(OWN, True), ("socket://127.0.0.1:5556", None)])
def test_a_unit_at_the_address_of_the_servers_simulator_is_simulated(url, simulated, database, bus, clock, tmp_path):
    """A unit whose protocol does not report it is simulated if it has the address of the server's simulator; otherwise this
    is not known. Link and stored device agree."""
    link = link_of(database, bus, clock, tmp_path, OWN)
    link.handle(LineBatch((LineOpened(url, 1, "", COUNTERS), UNIT), clock(), 0.0))
    assert link.last_hello.simulated is simulated
    with database.unit_of_work() as session:
        device = devices.get_contact(session, 1)[1]
    assert device is not None
    assert device.simulated is simulated


def test_a_line_that_does_not_fit_the_framing_is_rejected(database, bus, clock, tmp_path) -> None:
    """A CAN line is rejected for a sensor with a framing for serial lines."""
    link = link_of(database, bus, clock, tmp_path)
    with pytest.raises(BadInput, match="does not fit the sensor's framing cobs"):
        link.open("can://socketcan/can0")


def test_the_page_shows_the_acknowledgement_that_the_session_has(database, bus, clock, tmp_path) -> None:
    """An acknowledgement remains if the same dictionary answers again, and ends if another one answers. A dictionary that the
    user has not seen cannot be acknowledged."""
    link = link_of(database, bus, clock, tmp_path)
    hello = link.session._handshake

    def answers(dictionary_hash: bytes, *, handled: bool = True) -> None:
        values = dict.fromkeys(("last_request_id", "line_baud", "boot_count"), 0)
        values |= dict.fromkeys(("device_model", "profile", "firmware", "serial"), "")
        values |= dict.fromkeys(("simulated", "columns", "rows", "bits", "image_slots", "bank_bytes"), 0)
        event = hello.met(values | {"dictionary_hash": dictionary_hash}, 0.0)
        if handled:
            link.handle(LineBatch((event,), clock(), 0.0))

    link.handle(LineBatch((LineOpened(OWN, 1, "", COUNTERS),), clock(), 0.0))
    answers(b"\x11" * 32)
    link.acknowledge_dictionary("mira")
    for device_hash, acknowledged in ((b"\x11" * 32, True), (b"\x22" * 32, False), (b"\x11" * 32, False)):
        answers(device_hash)
        assert (link.dictionary_acknowledged, hello.acknowledged) == (acknowledged, acknowledged)
    answers(b"\x22" * 32, handled=False)
    with pytest.raises(Conflict, match="another device has answered"):
        link.acknowledge_dictionary("mira")
    assert not hello.acknowledged
