"""Layout and accessibility of every page in both themes and several sizes, with pictures.

All tests share the stored data and one browser page.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import expect

from tools.screenshots import FIND_CUT, RUN_AXE, STATION, SWEEP

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
AXE = "web/node_modules/axe-core/axe.min.js"
SMALL, LARGE = {"width": 1280, "height": 800}, {"width": 1920, "height": 1080}
TABLET, PHONE = {"width": 820, "height": 1180}, {"width": 390, "height": 844}
# On a small screen tables scroll inside their panel; the page itself does not scroll sideways, except for a pixel of
# rounding.
SIDEWAYS = """() => document.querySelector('.page').scrollWidth <= innerWidth + 1 ? [] : [...document.querySelectorAll('.page *')]
  .map((e) => [e, e.getBoundingClientRect().right]).filter(([, right]) => right > innerWidth)
  .map(([e, right]) => `${e.tagName} ${e.className} to ${right} px: ${e.textContent.trim().slice(0, 40)}`)"""
RUN_AXE_CONTRAST = RUN_AXE.replace("{resultTypes", "{runOnly: ['color-contrast'], resultTypes")
"""The only rule whose result differs between the themes."""
BEYOND = "[document.documentElement.scrollHeight - innerHeight, document.documentElement.scrollWidth - innerWidth]"
# Address, name of the picture, expected content.
PAGES = [
    ("/live", "page-live", "command-panel"),
    ("/commands?command=ACTIVATE_BANK", "page-commands", "history-row"),
    ("/telemetry?plot=housekeeping.sensor_temperature_c,housekeeping.stars_matched", "page-telemetry", "plot-stack"),
    ("/telemetry/derived", "page-derived", "derived-form"),
    ("/procedures", "page-procedures", "procedure-new"),
    ("/frames", "page-frames", "nav-frames"),
    ("/frames/lists", "page-lists", "lists-form"),
    ("/frames/{frame}", "page-frame", "nav-frames"),
    ("/catalogues", "page-catalogues", "catalogue-row"),
    ("/catalogues/{catalogue}", "page-builder", "sweep"),
    ("/catalogues/design", "page-design", "tile-limit_mag"),
    ("/stars/27989", "page-star", "star-frame-words"),
    ("/calibration", "page-calibration", "calibration"),
    ("/sheet", "page-sheet", "sheet-form"),
    ("/campaigns?job={job}", "page-campaigns", "paper-ours"),
    ("/contacts?contact=1", "page-contacts", "contact-timeline"),
    ("/passes?days=1", "page-passes", "pass-row"),
    ("/views", "page-views", "views"),
    ("/instruments", "page-instruments", "instruments"),
    ("/admin", "page-admin", "nav-admin"),
]


@pytest.fixture(scope="module")
def stored_data(served: Any, tle_of: Any) -> dict[str, int]:
    """Store a solved frame, a catalogue with a sweep and an experiment for the pages to show."""
    served.until("/link", lambda link: link["connected"] and link["dictionary_match"])
    before = max((f["id"] for f in served.ask("GET", "/frames?limit=1&source=device")["frames"]), default=0)
    served.ask("POST", "/commands", {"name": "SET_MODE", "arguments": {"mode": "lost_in_space"}})
    served.ask("POST", "/commands", {"name": "RUN_ITERATION", "arguments": {}})
    served.ask("POST", "/catalogues", SWEEP)
    served.ask("PUT", "/spacecraft", {"text": tle_of(1), "source": "test"})
    served.ask("POST", "/stations", STATION)
    job = served.ask("POST", "/campaigns/experiments", {"names": ["moniteq-4-2"], "trials": None, "seed": 1})
    catalogue = served.until("/catalogues", lambda found: [c["id"] for c in found if c["name"] == "sweep"])
    solved = served.until(
        "/frames?limit=5", lambda found: [f["id"] for f in found["frames"] if f["matched"] and f["id"] > before]
    )
    served.until("/jobs", lambda found: [j for j in found if j["id"] == job["id"] and j["state"] == "done"])
    return {"frame": solved[0], "catalogue": catalogue[0], "job": job["id"]}


@pytest.mark.parametrize(("path", "name", "content"), PAGES, ids=[name for _, name, _ in PAGES])
def test_a_page_fits_and_is_accessible(lasting, stored_data, root: Path, at_rest, snap, path, name, content):
    """The document does not scroll, no text is cut off, axe finds nothing serious, and the browser logs no error."""
    page = lasting.page
    page.set_viewport_size(SMALL)
    page.goto(path.format(**stored_data))
    expect(page.get_by_test_id(content).first).to_be_visible()
    page.evaluate((root / AXE).read_text())
    for theme in ("dark", "light"):
        if page.locator("html").get_attribute("data-theme") != theme:
            page.get_by_test_id("theme").click()
        for size in (SMALL, LARGE):
            page.set_viewport_size(size)
            at_rest(page)
            snap(page, name if (theme, size) == ("dark", SMALL) else f"{name}-{theme}-{size['width']}x{size['height']}")
            assert page.evaluate(BEYOND) == [0, 0], (theme, size)
            if size is SMALL:
                assert page.evaluate(RUN_AXE if theme == "dark" else RUN_AXE_CONTRAST) == [], theme
    for size in (TABLET, PHONE):
        page.set_viewport_size(size)
        at_rest(page)
        snap(page, f"{name}-light-{size['width']}x{size['height']}")
        assert page.evaluate(FIND_CUT) == [], size
        assert page.evaluate(SIDEWAYS) == [], size
    assert page.evaluate(RUN_AXE) == [], "phone"
    lasting.look()


def test_a_derived_parameter_is_plotted_with_its_telemetry(page, served, stored_data):
    """Below the plot of a derived parameter are plots of the telemetry in its expression."""
    power = {"name": "power_mw", "expression": "housekeeping.supply_3v3_v * housekeeping.current_imager_ma"}
    served.ask("POST", "/telemetry/derived", power | {"title": "Imager power", "unit": "mW", "decimals": 1})
    page.goto("/telemetry/derived")
    for title in ("Imager power", "3.3 V rail", "Imager current"):
        expect(page.get_by_test_id("plot-stack")).to_contain_text(title)


def test_a_large_screen_shows_the_pass_below_all_columns_of_the_list(page, stored_data):
    """The list has every column, and below it are the plots of the pass and its path."""
    page.set_viewport_size(LARGE)
    page.goto("/passes?days=1")
    expect(page.get_by_role("columnheader", name="Line budget")).to_be_in_viewport()
    expect(page.get_by_test_id("sky-plot")).to_be_in_viewport()
    expect(page.get_by_test_id("elevation-plot")).to_be_in_viewport()
    expect(page.get_by_role("columnheader", name="Path, UTC")).to_be_in_viewport()


def test_the_frames_below_the_list_open_from_their_bar(page, stored_data):
    """A short list leaves room for the map and for the numbers of stars. A bar opens its frame."""
    page.set_viewport_size(LARGE)
    page.goto("/frames")
    expect(page.get_by_test_id("pointings-map")).to_be_in_viewport()
    page.get_by_test_id("star-counts").locator("g", has_text=f"Frame {stored_data['frame']}:").click()
    expect(page).to_have_url(re.compile(f"/frames/{stored_data['frame']}$"))


def test_a_tablet_shows_the_description_below_the_form_and_the_map_above_the_steps(page, stored_data):
    """On a tablet in portrait, Commands describes the command below its form, and the builder's map has the whole
    width."""
    page.set_viewport_size(TABLET)
    page.goto("/commands?command=ACTIVATE_BANK")
    expect(page.get_by_test_id("command-send")).to_be_in_viewport()
    expect(page.get_by_test_id("command-facts")).to_be_in_viewport(ratio=1)
    page.goto(f"/catalogues/{stored_data['catalogue']}")
    sky = page.get_by_test_id("envelope-map")
    expect(sky).to_be_in_viewport(ratio=1)
    expect(page.get_by_test_id("step-5")).to_be_in_viewport()
    box, step = sky.bounding_box(), page.get_by_test_id("step-1").bounding_box()
    assert box is not None
    assert step is not None
    assert box["width"] > 700
    assert box["y"] + box["height"] < step["y"]


def test_a_phone_folds_controls_so_that_results_are_in_view(page, stored_data):
    """On a phone, Telemetry folds the value format and the limit set, and Frame the overlays, so that the first chain
    is in view."""
    page.set_viewport_size(PHONE)
    page.goto("/telemetry")
    expect(page.get_by_test_id("page-attitude")).to_be_in_viewport()
    expect(page.get_by_text("Converted")).to_have_count(0)
    page.get_by_test_id("telemetry-options").click()
    expect(page.get_by_text("Converted")).to_be_in_viewport()
    page.goto(f"/frames/{stored_data['frame']}")
    expect(page.get_by_test_id("chain-row").first).to_be_in_viewport(ratio=1)
    expect(page.get_by_test_id("overlay-grid")).to_have_count(0)
    page.get_by_test_id("overlay-fold").click()
    page.get_by_test_id("overlay-grid").click()
    expect(page.get_by_test_id("overlay-grid")).to_have_attribute("aria-pressed", "false")


def test_the_name_of_a_bank_is_above_its_bar_in_a_narrow_panel(page, stored_data):
    """On a phone, the name of the active catalogue is above its bar and inside the panel."""
    page.set_viewport_size(PHONE)
    page.goto("/catalogues")
    banks = page.get_by_test_id("banks")
    name, bar = (
        banks.locator("text", has_text=", active").bounding_box(),
        banks.locator("rect[stroke-width='1.5']").bounding_box(),
    )
    assert name is not None
    assert bar is not None
    assert name["y"] + name["height"] <= bar["y"] + bar["height"] / 4
    assert name["x"] + name["width"] <= PHONE["width"]
