"""The catalogue manager in a real browser: laws, corrections, quality maps, differences, files and banks by date."""

from __future__ import annotations

import re

from playwright.sync_api import expect


def build(page, name: str, first: str, last: str) -> None:
    """Build a two-week catalogue of a zenith camera."""
    page.goto("/catalogues/new")
    page.get_by_test_id("build-name").fill(name)
    page.get_by_test_id("step-1").click()
    page.get_by_role("group", name="Orbit from").get_by_role("button", name="elements").click()
    page.get_by_test_id("build-raan_from").fill(first)
    page.get_by_test_id("build-raan_to").fill(last)
    page.get_by_test_id("step-4").click()
    page.get_by_test_id("correct-annual_aberration").check()
    page.get_by_test_id("build").click()
    expect(page).to_have_url(re.compile(r"/catalogues/\d+"))
    expect(page.get_by_test_id("quality")).to_contain_text("annual aberration")


def test_manager_compares_exports_and_reports(page, picture):
    """A manager builds two catalogues, compares them, exports the stars and opens the report."""
    build(page, "zen-old", "20", "34")
    build(page, "zen-new", "34", "48")
    expect(page.get_by_test_id("quality")).to_contain_text("Drift out of the field")
    page.get_by_role("group", name="Map of").get_by_role("button", name="Similar stars").click()
    picture("catalogue-alike")
    page.get_by_test_id("diff-open").click()
    old = page.get_by_test_id("diff-old")
    old.select_option(label=old.locator("option", has_text="zen-old").first.inner_text())
    expect(page.get_by_test_id("diff")).to_contain_text("moved")
    expect(page.get_by_test_id("diff").locator("tbody tr").nth(3)).to_be_visible()
    picture("catalogue-diff")
    page.get_by_test_id("diff-close").click()
    page.get_by_test_id("export-menu").click()
    with page.expect_download() as download:
        page.get_by_test_id("export-csv").click()
    assert download.value.suggested_filename == "zen-new.csv"
    address = page.get_by_test_id("report").get_attribute("href")
    page.goto(address)
    expect(page.get_by_role("heading", name="Catalogue zen-new")).to_be_visible()


def test_every_law_updates_the_preview(page, at_rest):
    """The preview follows the selected pointing law. Impossible values give a message at once."""
    page.goto("/catalogues/new")
    page.get_by_test_id("step-2").click()
    expect(page.get_by_text("preview in")).to_be_visible()
    at_rest(page)
    for law in ("anti_sun", "sun_pointing", "inertial"):
        with page.expect_response("**/api/catalogues/preview*") as preview:
            page.get_by_test_id("build-pointing").select_option(law)
        assert preview.value.ok, law
        expect(page.get_by_test_id("funnel")).to_contain_text("kept")
    page.get_by_test_id("build-dec_deg").fill("-60")
    page.get_by_test_id("step-4").click()
    page.get_by_test_id("build-bright_mag").fill("5")
    expect(page.get_by_text("bright limit is not brighter")).to_be_visible()
    page.get_by_test_id("build-bright_mag").fill("-2")
    page.get_by_test_id("hide-earth").check()
    expect(page.get_by_text("needs the altitude")).to_be_visible()


def test_recorded_banks_are_shown(page):
    """The page shows the banks that the device reported, with a sentence about coverage."""
    page.goto("/catalogues")
    expect(page.get_by_test_id("banks")).to_contain_text("golden")
    expect(page.get_by_test_id("banks")).to_contain_text("validity of bank golden is unknown")


def test_the_selection_of_stars_and_the_mounting_change_the_preview(page):
    """The preview follows screening, thinning, reduced catalogue and mounting. An invalid mounting gives a message."""
    page.goto("/catalogues/new")
    page.get_by_test_id("step-4").wait_for()  # open from the start
    page.get_by_role("group", name="Screening list").get_by_role("button", name="exclude").click()
    page.get_by_test_id("build-companions").fill("9")
    expect(page.get_by_test_id("funnel")).to_contain_text("on the screening list")
    page.get_by_test_id("build-brightest_per_field").fill("6")
    page.get_by_role("group", name="Area for the brightest stars").get_by_role("button", name="upright frame").click()
    expect(page.get_by_test_id("funnel")).to_contain_text("beyond 6 per upright frame")
    page.get_by_test_id("step-5").click()
    page.get_by_test_id("build-reduced").check()
    page.get_by_test_id("build-reduced_brightest").fill("4")
    page.get_by_test_id("step-2").click()
    page.get_by_test_id("build-pointing").select_option("inertial")
    mounting = page.get_by_role("group", name="Mounting of the camera")
    mounting.get_by_role("button", name="rotations").click()
    page.get_by_test_id("build-turn_y").fill("90")
    expect(page.get_by_text("preview in")).to_be_visible()
    mounting.get_by_role("button", name="matrix").click()
    page.get_by_test_id("build-matrix").fill("1 0 0 0 1 0 0 0")
    expect(page.get_by_text("nine numbers by rows, got 8")).to_be_visible()
    expect(page.get_by_test_id("build")).to_be_disabled()
    page.get_by_test_id("build-matrix").fill("0.5 0 0 0 1 0 0 0 1")
    expect(page.get_by_text("the mounting is not a rotation")).to_be_visible()
    page.get_by_test_id("build-matrix").fill("1 0 0 0 1 0 0 0 1")
    expect(page.get_by_text("preview in")).to_be_visible()


def test_the_list_shows_the_stars_of_the_active_catalogue(page, served):
    """The map shows the stars of the active bank, which were read back from the device. Another catalogue can be
    selected.
    """
    build(page, "zen-map", "20", "34")
    active = next(c for c in served.ask("GET", "/catalogues") if c["banks"])
    page.goto("/catalogues")
    stars = page.get_by_test_id("catalogue-stars")
    expect(stars.get_by_test_id("envelope-map")).to_have_attribute(
        "aria-label", re.compile(f": {active['stars']} stars kept")
    )
    page.get_by_test_id("stars-of").select_option(label="zen-map")
    expect(stars.get_by_text(re.compile("^edge "))).to_have_count(2)
