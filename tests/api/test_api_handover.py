"""Checklists of contacts and hand-over notes over HTTP, in the pass report, and in a copy of the database."""

from __future__ import annotations

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.domain.errors import Conflict
from gss.operations.contacts.handover import DEFAULT_ITEMS, ChecklistRequest, HandoverService
from gss.settings import Settings
from gss.store import engine
from gss.store.audit import AuditFilter
from gss.store.dump import dump
from gss.store.engine import Database, open_engine
from gss.store.handover import unacknowledged_notes
from gss.store.models import Contact
from gss.wiring.build import build

FIRST = DEFAULT_ITEMS[0]


@pytest.fixture(scope="module")
def contacts(app: FastAPI) -> tuple[int, int]:
    """Ids of a closed and of an open contact."""
    now = datetime.now(UTC)
    with app.state.services.base.database.unit_of_work() as session:
        closed = Contact(url="loop://", started=now - timedelta(hours=2), ended=now - timedelta(hours=1))
        opened = Contact(url="loop://", started=now)
        session.add_all([closed, opened])
        session.flush()
        return closed.id, opened.id


def test_an_item_keeps_who_checked_it_and_when(clients: dict[str, TestClient], contacts: tuple[int, int]) -> None:
    """A viewer reads the default checklist. The first user who checks an item stays recorded; removing the check is
    recorded too. An item that is not in the list is rejected."""
    path = f"/api/contacts/{contacts[1]}"
    before = clients["viewer"].get(f"{path}/handover").json()
    assert (before["checklist"]["source"], [i["text"] for i in before["items"]]) == ("default", list(DEFAULT_ITEMS))
    assert (before["items"][0]["done"], before["items"][0]["at"]) == (False, None)
    assert clients["viewer"].put(f"{path}/checklist", json={"item": FIRST, "done": True}).status_code == 403
    done = clients["operator"].put(f"{path}/checklist", json={"item": FIRST, "done": True}).json()
    assert (done["done"], done["user"]) == (True, "the operator")
    again = clients["engineer"].put(f"{path}/checklist", json={"item": FIRST, "done": True}).json()
    assert again == done
    undone = clients["engineer"].put(f"{path}/checklist", json={"item": FIRST, "done": False}).json()
    assert (undone["done"], undone["user"], undone["unchecked"]) == (False, "the engineer", "the operator")
    assert "check of the operator removed" in clients["viewer"].get(f"{path}/report.html").text
    reply = clients["operator"].put(f"{path}/checklist", json={"item": "something else", "done": True})
    assert (reply.status_code, reply.json()["got"]) == (400, "something else")


def test_a_changed_checklist_applies_to_open_contacts_only(
    app: FastAPI, clients: dict[str, TestClient], contacts: tuple[int, int]
) -> None:
    """A user changes the list; a closed contact keeps all its items, and checked items that the list no longer contains
    stay visible. An outdated version and repeated or invisible items are rejected."""
    closed, opened = contacts
    clients["operator"].put(f"/api/contacts/{closed}/checklist", json={"item": FIRST, "done": True})
    assert "1 of 7 items done" in clients["viewer"].get(f"/api/contacts/{closed}/report.html").text
    clients["operator"].put(f"/api/contacts/{opened}/checklist", json={"item": FIRST, "done": True})
    old = clients["operator"].get("/api/checklist").json()
    new = {"items": ["Dome closed", "  Dew  heater off "], "version": old["version"]}
    changed = clients["admin"].put("/api/checklist", json=new).json()
    assert (changed["items"], changed["source"], changed["user"]) == (
        ["Dome closed", "Dew heater off"],
        "user",
        "the admin",
    )
    assert clients["operator"].put("/api/checklist", json=new).status_code == 409
    for items in (["a", " a"], ["caf\u00e9", "cafe\u0301"], ["\u200b"]):
        reply = clients["operator"].put("/api/checklist", json={"items": items, "version": changed["version"]})
        assert reply.status_code == 400
    texts = {
        c: [i["text"] for i in clients["viewer"].get(f"/api/contacts/{c}/handover").json()["items"]] for c in contacts
    }
    assert texts[closed] == list(DEFAULT_ITEMS)
    assert "1 of 7 items done" in clients["viewer"].get(f"/api/contacts/{closed}/report.html").text
    assert texts[opened] == ["Dome closed", "Dew heater off", FIRST]
    audit = app.state.services.accounts.audit.page(AuditFilter(who="the operator"), 50)
    assert any(FIRST in row.detail and row.result == "done" for row in audit)


def test_a_note_is_shown_until_another_user_acknowledges_it(
    app: FastAPI, clients: dict[str, TestClient], contacts: tuple[int, int], tmp_path: Path
) -> None:
    """A note has author and time. Its author cannot acknowledge it, and it is acknowledged once. The note is
    in the pass report and in a copy of the database."""
    path = f"/api/contacts/{contacts[1]}"
    assert clients["operator"].post(f"{path}/handover-notes", json={"text": "  "}).status_code == 400
    text = "Bank B not confirmed.\nTake two frames <first>."
    note = clients["operator"].post(f"{path}/handover-notes", json={"text": text}).json()
    assert (note["user"], note["text"], note["acknowledged_by"]) == ("the operator", text, "")
    later = clients["engineer"].post(f"{path}/handover-notes", json={"text": "Frame 7 has gaps."}).json()
    assert clients["viewer"].get("/api/handover-notes").json() == [note, later]
    acknowledge = f"/api/handover-notes/{note['id']}/acknowledge"
    assert clients["operator"].post(acknowledge).status_code == 409
    assert clients["viewer"].post(acknowledge).status_code == 403
    assert clients["engineer"].post(acknowledge).json()["acknowledged_by"] == "the engineer"
    assert clients["admin"].post(acknowledge).json()["got"] == "by the engineer"
    assert clients["viewer"].get("/api/handover-notes").json() == [later]
    assert clients["operator"].get(f"{path}/report").json()["handover"]["notes"][0]["text"] == text
    page = clients["operator"].get(f"{path}/report.html").text
    assert "Take two frames &lt;first&gt;." in page
    assert FIRST in page
    copy = tmp_path / "copy.db"
    dump(app.state.services.base.settings.database_url, copy)
    with Database(open_engine(f"sqlite:///{copy}")).unit_of_work() as session:
        assert [stored.text for stored in unacknowledged_notes(session, "", 5)] == ["Frame 7 has gaps."]


def test_items_of_the_instrument_package_replace_the_default(tmp_path: Path) -> None:
    """Each version of a package with other items applies to the open contact and later ones, until a user changes the list.
    Spaces and repetitions are removed. Of a contact before the first version, no items are known."""
    base = build(Settings(data=tmp_path)).base

    def started(*items: str) -> HandoverService:
        service = HandoverService(base.database, base.bus, base.clock.now, items)
        service.start()
        return service

    def contact(ended: datetime | None) -> int:
        with base.database.unit_of_work() as session:
            row = Contact(url="loop://", started=base.clock.now(), ended=ended)
            session.add(row)
            session.flush()
            return row.id

    now = base.clock.now()
    before = contact(now)
    service = started(" Lens  cap off", "Lens cap off", " ")
    first = contact(now)
    service = started("Lens cap off", "Dome open")
    opened = contact(None)
    service = started("Dome open")
    listed = {number: [item.text for item in service.of_contact(number).items] for number in (before, first, opened)}
    assert listed == {before: [], first: ["Lens cap off"], opened: ["Dome open"]}
    assert service.checklist().source == "instrument"
    service.change_checklist(ChecklistRequest(items=["Mine"], version=service.checklist().version), user="kim")
    assert started("Lens cap off").checklist().items == ("Mine",)


def test_a_database_that_is_locked_at_the_start_gets_the_list_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server starts, and the next reader stores the list."""
    monkeypatch.setattr(engine, "LOCK_WAIT_MS", 10)
    base = build(Settings(data=tmp_path)).base
    service = HandoverService(base.database, base.bus, base.clock.now, ("Dome open",))
    with closing(sqlite3.connect(tmp_path / "gss.db", isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        service.start()
    assert (service.checklist().items, service.checklist().version) == (("Dome open",), 1)


def test_the_first_of_equal_checks_is_kept_and_one_acknowledgement_wins(tmp_path: Path) -> None:
    """Twenty users check an item at the same time: one change is stored. Twelve users acknowledge a note: the others see
    who did."""
    base = build(Settings(data=tmp_path)).base
    service = HandoverService(base.database, base.bus, base.clock.now, ())
    service.start()
    with base.database.unit_of_work() as session:
        session.add(Contact(id=1, url="loop://", started=base.clock.now()))
    with ThreadPoolExecutor(20) as pool:
        states = list(pool.map(lambda k: service.check(1, FIRST, done=True, user=f"user {k}"), range(20)))
    assert len({(state.user, state.at) for state in states}) == 1
    note = service.add_note(1, "Frame 7 has gaps.", user="the author")

    def acknowledge(k: int) -> str:
        try:
            return f"by {service.acknowledge(note.id, user=f'user {k}').acknowledged_by}"
        except Conflict as error:
            return error.got

    with ThreadPoolExecutor(12) as pool:
        assert len(set(pool.map(acknowledge, range(12)))) == 1
