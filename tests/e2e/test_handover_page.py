"""Checklist and hand-over notes in a browser, with two users."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from gss.operations.contacts.handover import DEFAULT_ITEMS
from tools.screenshots import RUN_AXE

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def test_an_operator_checks_items_and_leaves_a_note_for_the_next_one(
    page: Page, served, root: Path, signed_in: Callable[..., dict[str, str]]
) -> None:
    """A checked item shows user and time after a reload. The notes are on Live of the next operator, one after the other,
    until that operator acknowledges them."""
    contact = served.until("/link", lambda link: link["contact_id"])
    page.goto(f"/contacts?contact={contact}")
    items = page.get_by_test_id("checklist-item")
    expect(items).to_have_count(len(DEFAULT_ITEMS))
    items.first.check()
    expect(page.get_by_test_id("checklist-progress")).to_contain_text(f"1 of {len(DEFAULT_ITEMS)} done, default items")
    page.get_by_test_id("handover-text").fill("Bank B is not confirmed.")
    page.get_by_test_id("handover-add").click()
    expect(page.get_by_test_id("handover-note")).to_contain_text("not acknowledged")
    page.get_by_test_id("handover-text").fill("Frame 7 has gaps.")
    page.get_by_test_id("handover-add").click()
    expect(page.get_by_test_id("handover-note")).to_have_count(2)
    page.get_by_test_id("checklist-edit").click()
    expect(page.get_by_test_id("checklist-items")).to_have_value(re.compile(re.escape(DEFAULT_ITEMS[0])))
    page.get_by_test_id("checklist-items").fill("Dome closed")
    page.get_by_test_id("checklist-save").click()
    expect(page.get_by_test_id("checklist-progress")).to_contain_text("1 of 2 done, items changed by")
    page.reload()
    expect(items).to_have_count(2)
    expect(items.nth(1)).to_be_checked()
    expect(page.get_by_test_id("handover-strip")).to_have_count(0)

    key = signed_in(served.folder, "operator", "kim")["Cookie"].split("=", 1)[1]
    page.context.add_cookies([{"name": "gss_session", "value": key, "url": served.address}])
    page.goto("/live")
    strip = page.get_by_test_id("handover-strip")
    expect(strip).to_contain_text("1 of 2")
    page.evaluate((root / "web/node_modules/axe-core/axe.min.js").read_text())
    assert page.evaluate(RUN_AXE) == []
    expect(strip).to_contain_text("Bank B is not confirmed.")
    page.get_by_test_id("handover-acknowledge").click()
    expect(strip).to_contain_text("Frame 7 has gaps.")
    page.get_by_test_id("handover-acknowledge").click()
    expect(strip).to_have_count(0)
    page.goto(f"/contacts?contact={contact}")
    expect(page.get_by_test_id("handover-note").first).to_contain_text("acknowledged by kim")
