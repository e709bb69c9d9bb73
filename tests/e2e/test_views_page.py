"""Shared views in a browser: a page in its state is stored under a name, and its link opens the same state."""

from __future__ import annotations

import re
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
SLOW = 30_000


def test_a_view_is_stored_and_its_link_opens_the_same_page(page: Page, served) -> None:
    """A view stores the filters of Frames and restores them. A telemetry page is stored on the server, not in the
    browser.
    """
    page.goto("/views?save=/frames?outcome%3Dsolved%26stars%3D5")
    page.get_by_test_id("view-name").fill("Good frames")
    page.get_by_test_id("view-save").click()
    row = page.locator("[data-view='Good frames']")
    expect(row).to_contain_text("version 1", timeout=SLOW)
    frames_view = next(view for view in served.ask("GET", "/views") if view["name"] == "Good frames")
    page.goto(f"/views/{frames_view['id']}")
    expect(page).to_have_url(re.compile(r"/frames\?outcome=solved&stars=5$"), timeout=SLOW)

    page.goto("/telemetry?page=power")
    expect(page.get_by_test_id("plots").locator("canvas").first).to_be_visible(timeout=SLOW)
    page.get_by_role("button", name="Clear").click()
    expect(page).to_have_url(re.compile("plot=none"))
    expect(page.get_by_test_id("plot-limited")).to_be_visible()
    page.goto("/telemetry?plot=housekeeping.mode")
    page.get_by_test_id("save-page").click(timeout=SLOW)
    page.get_by_test_id("own-name").fill("Modes")
    page.get_by_test_id("own-name").press("Enter")
    expect(page.get_by_test_id("own-page")).to_contain_text("Modes", timeout=SLOW)
    stored = next(view for view in served.ask("GET", "/views") if view["name"] == "Modes")
    page.evaluate("localStorage.clear()")
    page.goto(stored["path"])
    expect(page.get_by_role("heading", name="Modes")).to_be_visible(timeout=SLOW)
    assert parse_qs(urlsplit(page.url).query)["fields"] == ["housekeeping.mode"]


def test_the_start_page_opens_after_sign_in_and_a_link_keeps_its_target(page: Page, served) -> None:
    """Without a page in the address, the page of the role opens, or the one that the user chose, with its plots. The
    choice is stored on the server. A link to a page opens this page."""
    page.goto("/")
    expect(page).to_have_url(re.compile(r"/admin$"), timeout=SLOW)
    page.goto("/telemetry?plot=housekeeping.frames_good")
    page.get_by_test_id("user-open").click(timeout=SLOW)
    page.get_by_test_id("start-here").click()
    expect(page.get_by_test_id("start-here")).to_be_disabled(timeout=SLOW)
    assert served.ask("GET", "/session")["start_page"] == "/telemetry?plot=housekeeping.frames_good"
    page.evaluate("localStorage.clear()")
    page.goto("/")
    expect(page).to_have_url(re.compile(r"/telemetry\?plot=housekeeping\.frames_good$"), timeout=SLOW)
    expect(page.get_by_test_id("plots").locator("canvas").first).to_be_visible(timeout=SLOW)
    page.goto("/contacts")
    expect(page.get_by_test_id("contacts")).to_be_visible(timeout=SLOW)
    page.get_by_test_id("user-open").click()
    page.get_by_test_id("start-page").select_option("")
    served.until("/session", lambda found: not found["start_page"])
    page.goto("/")
    expect(page).to_have_url(re.compile(r"/admin$"), timeout=SLOW)
