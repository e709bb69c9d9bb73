"""Stars in a browser: the palette finds them, and their page lists catalogues and frames."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def search(page: Page, text: str) -> None:
    """Open the palette and enter a text."""
    page.keyboard.press("Control+k")
    page.get_by_test_id("palette-text").fill(text)


def test_the_palette_finds_a_star_and_its_page_leads_to_a_frame(page: Page, new_frame: Callable[[Page], int]) -> None:
    """A name and a number find the same star first. Its page links to the frame in which it was matched, and the frame
    has this star selected."""
    number = new_frame(page)
    search(page, "HIP 26727")
    expect(page.get_by_test_id("place").first).to_contain_text("Alnitak")
    page.get_by_test_id("palette-text").fill("alnitak")
    expect(page.get_by_test_id("place").first).to_contain_text("HIP 26727")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(r"/stars/26727$"))
    expect(page.get_by_test_id("star-facts")).to_contain_text("Declination")
    page.get_by_test_id("star-frames").get_by_role("link", name=f"Frame {number}", exact=True).click()
    expect(page.get_by_test_id("stars").locator("tr.current")).to_contain_text("Alnitak")


def test_a_star_outside_the_table_is_named(page: Page) -> None:
    """The palette states that the star table does not contain a number, and so does the page of this number."""
    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    search(page, "HIP 999999")
    expect(page.get_by_test_id("palette")).to_contain_text("HIP 999999 is not among the 117")
    page.goto("/stars/999999")
    expect(page.get_by_test_id("star-problem")).to_contain_text("The star table does not contain this star")


def test_the_palette_finds_banks_help_pages_and_misspelled_names(page: Page) -> None:
    """The palette finds the banks of the device with their content, help pages by title, and names with one wrong
    letter."""
    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    first = page.get_by_test_id("place").first
    for text, name in (("bank b", "Bank B"), ("operator: a pass", "Operator: a pass"), ("campagins", "Campaigns")):
        search(page, text)
        expect(first).to_contain_text(name)
        page.keyboard.press("Escape")
    search(page, "betelguese")
    expect(first).to_contain_text("Betelgeuse")
