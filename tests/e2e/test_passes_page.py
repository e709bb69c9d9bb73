"""Passes page: import of an orbit, stations, passes, plans and invalid input."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def test_a_pass_is_shown_after_importing_orbit_and_station(page, tle_of, picture):
    """After an orbit was imported and a station added, the page shows passes. Invalid elements and positions are
    rejected.
    """
    page.goto("/passes")
    expect(page.get_by_test_id("passes-problem")).to_contain_text("No orbit was imported")
    page.get_by_role("link", name="Import an orbit").click()
    broken = tle_of(1).rstrip()
    page.get_by_test_id("orbit-text").fill(broken[:-1] + str((int(broken[-1]) + 1) % 10))
    page.get_by_test_id("orbit-save").click()
    expect(page.get_by_test_id("orbit-problem")).to_contain_text("wrong checksum")
    for name in ("first.tle", "second.tle"):  # the source is the file whose text is imported
        file = {"name": name, "mimeType": "text/plain", "buffer": tle_of(5).encode()}
        page.get_by_test_id("orbit-file").set_input_files(file)
        expect(page.get_by_test_id("orbit-source")).to_have_value(name)
    page.get_by_test_id("orbit-source").fill("tracking service")
    page.get_by_test_id("orbit-save").click()
    expect(page.get_by_test_id("orbit-panel")).to_contain_text("5.0 days old")
    expect(page.get_by_test_id("orbit-panel")).to_contain_text("tracking service")
    page.get_by_role("button", name="Ground stations").click()
    page.get_by_test_id("station-name").fill("Stellenbosch")
    page.get_by_test_id("station-latitude_deg").fill("-33.9275")
    page.get_by_test_id("station-longitude_deg").fill("200")
    expect(page.get_by_test_id("station-save")).to_be_disabled()
    page.get_by_test_id("station-longitude_deg").fill("18.865")
    page.get_by_test_id("station-mask").fill("0, 4\n60, 14\n120, 5\n240, 3")
    page.get_by_test_id("station-save").click()
    expect(page.get_by_test_id("station-row")).to_contain_text("4 points")
    page.get_by_role("button", name="Passes", exact=True).click()
    expect(page.get_by_test_id("next-pass")).to_contain_text(re.compile("Next pass|Pass in progress"))
    expect(page.get_by_test_id("pass-timeline")).to_be_visible()
    page.get_by_test_id("pass-row").nth(1).click()
    expect(page.get_by_test_id("pass-panel")).to_contain_text("Culmination")
    expect(page.get_by_test_id("pass-budget")).to_contain_text("of the line")
    expect(page.get_by_test_id("sky-plot")).to_be_visible()
    picture("passes")
    with page.expect_download() as download:
        page.get_by_test_id("passes-ics").click()
    assert download.value.path().read_text().startswith("BEGIN:VCALENDAR")
    page.reload()
    expect(page.get_by_test_id("pass-panel")).to_contain_text("Culmination")


def test_an_armed_plan_is_on_every_page_until_it_is_stopped(page, served, tle_of, picture):
    """An armed plan is shown on other pages, marked as last reported while it cannot be read, and can be stopped
    there.
    """
    served.ask("PUT", "/spacecraft", {"text": tle_of(1)})
    place = {"latitude_deg": 50.0, "longitude_deg": 8.0, "name": "Frankfurt"}
    if all(s["name"] != "Frankfurt" for s in served.ask("GET", "/stations")):
        served.ask("POST", "/stations", place)
    passes = served.ask("GET", "/passes?days=3")["passes"]
    later_pass = [p for p in passes if p["station"] == "Frankfurt" and p["duration_s"] > 400][1]
    page.goto("/passes?show=plans")
    page.get_by_test_id("plan-pass").select_option(f"{later_pass['station_id']} {later_pass['culmination']}")
    page.get_by_test_id("plan-name").fill("Evening image")
    page.get_by_test_id("plan-add-download").click()
    page.get_by_test_id("plan-save").click()
    expect(page.get_by_test_id("plan-detail")).to_contain_text("Download frame of slot 0")
    page.get_by_test_id("plan-arm").click()
    expect(page.get_by_test_id("plan-strip")).to_contain_text("Pass plan armed")
    picture("pass-plan")
    page.goto("/telemetry")
    expect(page.get_by_test_id("plan-strip")).to_contain_text("Evening image")
    expect(page.get_by_test_id("plan-strip")).to_contain_text("armed by admin")
    page.route("**/api/pass-plans/active", lambda route: route.fulfill(status=404))
    expect(page.get_by_test_id("plan-strip")).to_contain_text("last reported")
    page.unroute("**/api/pass-plans/active")
    expect(page.get_by_test_id("plan-strip")).not_to_contain_text("last reported")
    page.get_by_test_id("plan-strip-stop").click()
    expect(page.get_by_test_id("plan-strip")).to_have_count(0)
    plan = max((p for p in served.ask("GET", "/pass-plans") if p["name"] == "Evening image"), key=lambda p: p["id"])
    assert (plan["state"], plan["reason"], plan["items"][0]["state"]) == ("stopped", "stopped by admin", "waiting")


IMAGE = """# Take an image

## image: Take the image

```command
TAKE_IMAGE slot=0 exposure_ms=250
```

## sharp: Continue?

```question
Was an image taken?
yes: end
no: end
```
"""


def test_a_plan_is_rehearsed_with_a_question_and_a_loss_of_signal(page, served, tle_of, picture):
    """The report shows both passes on its timeline, the answer to the question, and the completed items."""
    served.ask("PUT", "/spacecraft", {"text": tle_of(1)})
    if all(s["name"] != "Longyearbyen" for s in served.ask("GET", "/stations")):
        served.ask("POST", "/stations", {"latitude_deg": 78.23, "longitude_deg": 15.64, "name": "Longyearbyen"})
    served.ask("POST", "/procedures", {"text": IMAGE})
    passes = served.ask("GET", "/passes?days=3")["passes"]
    long_pass = [p for p in passes if p["station"] == "Longyearbyen" and p["duration_s"] > 400][1]
    page.goto("/passes?show=plans")
    if page.get_by_test_id("plan-new").count():
        page.get_by_test_id("plan-new").click()
    page.get_by_test_id("plan-pass").select_option(f"{long_pass['station_id']} {long_pass['culmination']}")
    page.get_by_test_id("plan-name").fill("Night image")
    page.get_by_test_id("plan-add-procedure").click()
    page.get_by_test_id("plan-add-download").click()
    page.get_by_test_id("plan-resume").check()
    page.get_by_test_id("plan-save").click()
    page.get_by_text("Answers, losses of signal, and assumptions").click()
    page.get_by_test_id("rehearse-answers").fill("sharp: yes")
    page.get_by_test_id("rehearse-losses").fill("1, 30, 1800")
    page.get_by_test_id("plan-rehearse").click()
    report = page.get_by_test_id("rehearsal-report")
    expect(report).to_contain_text("Rehearsal completed", timeout=180_000)
    expect(report).to_contain_text("question sharp, answered by the rehearsal: yes")
    expect(report).to_contain_text("paused: loss of signal")
    timeline = page.get_by_test_id("rehearsal-timeline")
    expect(timeline.get_by_role("img")).to_have_attribute("aria-label", "Items executed in 2 passes")
    expect(timeline).to_contain_text("2. Download frame of slot 0")
    report.scroll_into_view_if_needed()
    picture("rehearsal")
