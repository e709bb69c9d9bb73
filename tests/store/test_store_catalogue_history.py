"""Bank history and star lists, on every supported database."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from gss.domain.errors import NotFound
from gss.store import bank_history, devices, star_lists
from gss.store.models import BankHistory, StarList

T0 = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)
DAY = timedelta(days=1)


def add_device(session, name: str, first_seen: datetime):
    """Store a device first seen at a time."""
    facts = {"profile": "p", "firmware": "1", "simulated": True, "dictionary_hash": "h"}
    return devices.remember(session, first_seen, name=name, **facts)


def bank_period(device_id: int, bank: str, began: datetime, ended: datetime | None, sha256: str = "") -> BankHistory:
    """Return a period in which a bank had this content."""
    return BankHistory(
        device_id=device_id, bank=bank, state="held", sha256=sha256, began=began, reported=ended or began, ended=ended
    )


def star_list(name: str, profile: str = "") -> StarList:
    """Return the row of a star list."""
    return StarList(
        name=name,
        created=T0,
        author="a",
        format="csv",
        epoch_jyear=2016.0,
        frame="icrs",
        profile=profile,
        stars=3,
        dropped=1,
        size=90,
        sha256="cd" * 32,
        mapping={"columns": {"ra": "RAJ2000"}},
        report={"dropped": [{"row": 2}]},
    )


def test_bank_history_is_read_by_time_span_and_by_device(database):
    """Periods that overlap the span are ordered by bank and time. Periods without an end are the current state. Devices
    are separate."""
    with database.unit_of_work() as session:
        first, second = add_device(session, "one", T0), add_device(session, "two", T0 + DAY)
        bank_history.add(session, bank_period(first.id, "B", T0 - 9 * DAY, T0 - 5 * DAY, "aa"))
        bank_history.add(session, bank_period(first.id, "B", T0 - 5 * DAY, None, "bb"))
        bank_history.add(session, bank_period(first.id, "A", T0 - 2 * DAY, None))
        bank_history.add(session, bank_period(second.id, "A", T0, None, "cc"))
        first_id, second_id = first.id, second.id
    with database.unit_of_work() as session:
        matches = bank_history.between(session, first_id, T0 - 4 * DAY, T0)
        assert [(r.bank, r.sha256) for r in matches] == [("A", ""), ("B", "bb")]
        assert [r.sha256 for r in bank_history.between(session, first_id, T0 - 30 * DAY, T0 - 5 * DAY)] == ["aa", "bb"]
        assert [(r.bank, r.sha256) for r in bank_history.still_so(session, first_id)] == [("A", ""), ("B", "bb")]
        assert [d.id for d in bank_history.devices(session)] == [second_id, first_id]
        assert matches[1].began == T0 - 5 * DAY
        assert matches[1].ended is None


def test_contacts_of_a_span_are_those_of_the_device(database):
    """Contacts of the device that overlap the span are returned in order, including an open one. Contacts with another
    device or with none are not returned."""
    with database.unit_of_work() as session:
        first, second = add_device(session, "one", T0), add_device(session, "two", T0)
        ids = []
        cases = ((first, -20, -19.9), (first, 0, None), (first, -3, -2.9), (second, -3, -2.9), (None, -3, -2.9))
        for device, began, ended in cases:
            contact = devices.open_contact(session, "u", T0 + began * DAY, "c")
            if device is not None:
                devices.update_contact(session, contact.id, device_id=device.id)
            contact.ended = None if ended is None else T0 + ended * DAY
            ids.append(contact.id)
        first_id = first.id
    with database.unit_of_work() as session:
        matches = bank_history.contacts_between(session, first_id, T0 - 10 * DAY, T0 + DAY)
        assert [(c.id, c.ended is None) for c in matches] == [(ids[2], False), (ids[1], True)]
        assert bank_history.device_of_contact(session, ids[0]) == first_id
        assert bank_history.device_of_contact(session, ids[4]) is None
        assert bank_history.device_of_contact(session, 10**6) is None


def test_star_lists_are_read_completely_and_newest_first(database):
    """Star lists are read with their camera, mapping and report, newest first. An unknown one raises NotFound."""
    with database.unit_of_work() as session:
        ids = [star_lists.add(session, star_list(name, camera)).id for name, camera in (("x", ""), ("y", "sunsat"))]
    with database.unit_of_work() as session:
        assert [row.id for row in star_lists.newest(session, 5)] == ids[::-1]
        assert len(star_lists.newest(session, 1)) == 1
        row = star_lists.get(session, ids[1])
        assert (row.profile, row.mapping, row.report["dropped"]) == (
            "sunsat",
            {"columns": {"ra": "RAJ2000"}},
            [{"row": 2}],
        )
        assert (row.created, row.epoch_jyear) == (T0, 2016.0)
        with pytest.raises(NotFound, match="no such star list"):
            star_lists.get(session, 10**6)
