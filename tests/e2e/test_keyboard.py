"""The console without a mouse: from the sign-in to an attitude, the palette, the command line, lists and tables."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
PASSWORD = "antares low in the south"
SMALL = [(1024, 768), (720, 450)]
"""Sizes of a tablet and of 1440 pixels at 200 % zoom."""


def focused(page: Page, attribute: str = "data-testid") -> str:
    """Return an attribute of the focused element."""
    return str(page.evaluate(f"document.activeElement?.getAttribute('{attribute}') ?? ''"))


def tab_to(page: Page, testid: str, most: int = 80) -> None:
    """Press Tab until the control has the focus."""
    for _ in range(most):
        if focused(page) == testid:
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"{testid} is not reached by {most} times Tab")


def test_from_the_sign_in_to_an_attitude_without_a_mouse(page, data_folder):
    """With the keyboard, an operator signs in, opens Live with the palette, and runs the steps of the chain."""
    command = [sys.executable, "-m", "gss", "user", "add", "kim", "--role", "operator", "--password-stdin"]
    subprocess.run([*command, "--data", str(data_folder)], input=f"{PASSWORD}\n", text=True, check=True)
    page.context.clear_cookies()
    page.goto("/telemetry")
    expect(page.get_by_test_id("sign-in-name")).to_be_focused()
    page.keyboard.type("kim")
    page.keyboard.press("Tab")
    page.keyboard.type(PASSWORD)
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("user-cell")).to_contain_text("kim")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    page.keyboard.press("Control+k")
    expect(page.get_by_test_id("palette-text")).to_be_focused()
    page.keyboard.type("live")
    expect(page.get_by_test_id("place").first).to_contain_text("Live")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(r"/live$"))
    for step, words in (
        ("TAKE_IMAGE", "ago"),
        ("FIND_CENTROIDS", "found"),
        ("MATCH_STARS", "stars"),
        ("CALCULATE_ATTITUDE", "solved"),
    ):
        expect(page.get_by_test_id(f"cmd-{step}")).to_be_visible()  # the page is there
        tab_to(page, f"cmd-{step}")
        page.keyboard.press("Enter")
        expect(page.get_by_test_id(f"cmd-{step}")).to_contain_text(words)
    expect(page.get_by_test_id("attitude")).to_contain_text("RA")
    tab_to(page, "authority-open", most=200)
    page.keyboard.press("Enter")
    tab_to(page, "authority-release")
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("authority")).not_to_contain_text("you hold it")


def test_a_command_is_written_completed_checked_and_sent_in_one_line(page):
    """A colon opens the command line and Tab completes. Errors are shown before sending, and an arrow key recalls
    commands.
    """
    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    page.keyboard.press(":")
    line = page.get_by_test_id("line-text")
    expect(line).to_be_focused()
    page.keyboard.type("setexp")
    expect(line).to_have_attribute("aria-expanded", "true")
    page.keyboard.press("Tab")
    expect(line).to_have_value("SET_EXPOSURE ")
    page.keyboard.type("9999")
    expect(page.get_by_test_id("command-line")).to_contain_text("1 – 2 000, got 9 999")
    page.keyboard.press("Enter")
    expect(line).to_have_value("SET_EXPOSURE 9999")
    for _ in "9999":
        page.keyboard.press("Backspace")
    page.keyboard.type("240")
    expect(page.get_by_test_id("byte-preview")).to_contain_text("00 f0")
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("line-result")).to_contain_text("completed")
    page.keyboard.press("ArrowUp")
    expect(line).to_have_value("SET_EXPOSURE 240")
    page.keyboard.press("Escape")
    expect(page.get_by_test_id("command-line")).to_have_count(0)


def test_a_hazardous_line_leads_to_its_confirmation(page):
    """Enter on a critical command sends nothing, but opens the form with its confirmation."""
    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    page.keyboard.press(":")
    page.keyboard.type("erase_bank bank=C")
    expect(page.get_by_test_id("command-line")).to_contain_text("confirmation on Commands")
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("hazard-name")).to_be_focused()
    expect(page.get_by_test_id("hazard-queue")).to_be_disabled()
    page.keyboard.press("Escape")
    expect(page.get_by_test_id("hazard")).to_have_count(0)
    expect(page.get_by_test_id("history").get_by_text("ERASE_BANK")).to_have_count(0)


def test_a_table_is_one_stop_with_arrows_inside(page):
    """Tab reaches one button of the telemetry table. Arrow keys move between rows, and End moves to the last row."""
    page.goto("/telemetry")
    table = page.get_by_test_id("telemetry").locator("table").first
    expect(table.locator("button").nth(5)).to_be_visible()
    expect(table.locator("button[tabindex='0']")).to_have_count(1)
    tab_to_table = "document.querySelector('[data-testid=telemetry] table button[tabindex=\"0\"]').focus()"
    page.evaluate(tab_to_table)
    first = page.evaluate("document.activeElement.textContent")
    page.keyboard.press("ArrowDown")
    second = page.evaluate("document.activeElement.textContent")
    assert second != first
    page.keyboard.press("p")
    expect(page).to_have_url(re.compile(r"plot="))
    page.keyboard.press("End")
    assert page.evaluate("document.activeElement.closest('tr').nextElementSibling === null")
    expect(table.locator("button[tabindex='0']")).to_have_count(1)


def test_keys_lead_to_pages_and_do_nothing_while_typing(page):
    """Numbers, and g with a letter, open pages. In a field these keys are text. The question mark lists the keys."""
    page.goto("/live")
    expect(page.get_by_test_id("nav-commands")).to_be_visible()
    page.keyboard.press("3")
    expect(page).to_have_url(re.compile(r"/telemetry"))
    expect(page.get_by_test_id("telemetry-filter")).to_be_visible()
    page.keyboard.press("/")
    page.keyboard.type("g2")
    expect(page.get_by_test_id("telemetry-filter")).to_have_value("g2")
    expect(page).to_have_url(re.compile(r"/telemetry"))
    page.get_by_test_id("telemetry-filter").blur()
    page.keyboard.press("g")
    page.keyboard.press("k")
    expect(page).to_have_url(re.compile(r"/catalogues"))
    page.keyboard.press("?")
    expect(page.get_by_test_id("keys-help")).to_contain_text("ABORT")
    page.keyboard.press("Escape")
    expect(page.get_by_test_id("keys-help")).to_have_count(0)


@pytest.mark.parametrize("path", ["/live", "/commands", "/telemetry", "/catalogues/new"])
def test_every_control_is_reachable_on_a_small_screen(page, at_rest, path):
    """On a small screen every cell of the header is visible, and every control can be scrolled into view."""
    page.goto(path)
    for size in SMALL:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        at_rest(page)
        for cell in ("identity", "link-state", "mode", "bank", "dictionary", "alarm", "utc", "authority", "abort"):
            box = page.get_by_test_id(cell).bounding_box()
            assert box is not None, cell
            assert box["x"] >= 0, f"{size}: {cell}"
            assert box["x"] + box["width"] <= size[0] + 1, f"{size}: {cell} ends at {box['x'] + box['width']}"
        unreachable = page.evaluate(
            """() => [...document.querySelectorAll('main button, main a, main input, main select')].filter((e) => {
              e.scrollIntoView({block: 'center', inline: 'center'});
              const b = e.getBoundingClientRect();
              return b.width > 0 && (b.left < -1 || b.right > innerWidth + 1 || b.top < -1 || b.bottom > innerHeight + 1);
            }).map((e) => e.outerHTML.slice(0, 120))"""
        )
        assert unreachable == [], size
