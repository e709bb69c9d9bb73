"""An engineer edits a camera and sees the predicted performance."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def test_a_camera_is_edited_shared_by_link_counted_and_reset(page, picture):
    """A changed focal length is marked, appears in the URL and changes the computed values. The full count adds a table.
    Impossible numbers are rejected, and reset restores the documented camera.
    """
    page.goto("/catalogues")
    page.get_by_test_id("open-design").click()
    design = page.get_by_test_id("design")
    expect(design).to_have_attribute("data-ready", "true")
    page.get_by_test_id("design-profile").select_option("sunsat")
    tile = page.get_by_test_id("tile-fov_circle_deg")
    expect(tile).to_contain_text("10.9")
    page.get_by_test_id("design-focal_mm").fill("50")
    expect(page.locator("[data-testid=design-field][data-key=focal_mm]")).to_have_attribute("data-changed", "true")
    expect(tile).to_contain_text("5.4")
    expect(page).to_have_url(re.compile(r"profile=sunsat&focal_mm=50"))
    expect(page.get_by_test_id("design-histogram")).to_be_visible()
    expect(page.get_by_test_id("curve")).to_have_count(3)
    picture("design-stars")
    page.reload()
    expect(page.get_by_test_id("design-focal_mm")).to_have_value("50")
    expect(tile).to_contain_text("5.4")
    page.get_by_role("button", name="Baffle").click()
    expect(page.get_by_test_id("baffle")).to_have_count(2)
    picture("design-baffle")
    page.get_by_role("button", name="Performance sheet").click()
    expect(page.get_by_test_id("sheet-temporal-noise")).to_contain_text("Cramér–Rao bound")
    expect(page.get_by_test_id("sheet-bias")).to_contain_text("a design has no misalignment")
    picture("design-sheet")
    with page.expect_download() as download:
        page.get_by_test_id("design-sheet-pdf").click()
    assert download.value.path().read_bytes().startswith(b"%PDF")
    page.get_by_role("button", name="Cameras and lenses").click()
    expect(page.get_by_test_id("design-table")).to_have_count(1)
    page.get_by_test_id("design-pointings").fill("5000")
    expect(page).to_have_url(re.compile(r"pointings=5000"))
    page.get_by_test_id("design-run").click()
    expect(design).to_have_attribute("data-full", "true", timeout=180_000)
    expect(page.get_by_test_id("design-table")).to_have_count(2)
    page.get_by_test_id("design-f_number").fill("0")
    expect(page.locator("[data-testid=design-field][data-key=f_number]")).to_contain_text("0.4 – 32")
    page.get_by_test_id("design-reset").click()
    expect(page.get_by_test_id("design-focal_mm")).to_have_value("25")
    expect(tile).to_contain_text("10.9")
    fits = page.evaluate(
        "[document.documentElement.scrollWidth <= innerWidth, document.documentElement.scrollHeight <= innerHeight]"
    )
    assert fits == [True, True]


def test_curves_of_zeros_have_a_line_instead_of_a_plot(page):
    """The titles of curves whose values are all 0 are in a line, and the other plots use their space."""
    page.set_viewport_size({"width": 1440, "height": 900})
    page.goto("/catalogues/design")
    expect(page.get_by_test_id("zero-curves")).to_contain_text("by focal length, at V 5.3: all values are 0")
    expect(page.get_by_test_id("curve")).to_have_count(2)
    last, panel = page.get_by_test_id("curve").last.bounding_box(), page.get_by_test_id("design").bounding_box()
    assert last is not None
    assert panel is not None
    assert last["width"] > panel["width"] / 2
