"""What a page states when its selection, the server's data or the connection changes, in a browser."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def test_a_confirmation_ends_when_another_kind_of_table_is_chosen(page: Page) -> None:
    """The confirmation of an activation names the kind of the table. It is not shown beside tables of another kind,
    because it would then activate a table of that kind."""
    page.goto("/catalogues")
    tables = page.get_by_test_id("tables")
    bank = {"bank": "B", "state": "committed", "active": False, "size_bytes": 9, "sha256": "a", "confirm_left_s": 0}
    page.route(
        "**/api/tables/on-board",
        lambda route: route.fulfill(
            json=[{**bank, "table": kind, "table_id": 1} for kind in ("calibration", "parameters")]
        ),
    )
    page.goto("/catalogues")
    tables.get_by_test_id("table-activate").first.click()
    expect(tables.get_by_test_id("hazard")).to_contain_text("calibration, bank B")
    tables.get_by_role("button", name="parameters").click()
    expect(tables.get_by_test_id("table-bank").first).to_be_visible()
    expect(tables.get_by_test_id("hazard")).to_have_count(0)
