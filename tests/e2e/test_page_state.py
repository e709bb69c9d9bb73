"""What a page states when its selection, the server's data or the connection changes, in a browser."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
UNIT = {
    "name": "FM1",
    "instrument": "cubestar",
    "address": "simulator",
    "process": "running",
    "restarts": 0,
    "last_end": "",
    "reason": "",
    "process_age_s": 900.0,
    "link": None,
    "age_s": 0.5,
    "current": True,
}
ALARM = {
    "id": 7,
    "packet": "housekeeping",
    "field": "temp_sensor_c",
    "title": "Sensor temperature",
    "state": "raised",
    "level": "watch",
    "worst": "watch",
    "value": 50.0,
    "unit": "degC",
    "text": "Sensor temperature above 45",
    "limit_text": "above 45",
    "limit_set": "nominal",
    "cleared": None,
    "acknowledged": None,
    "acknowledged_by": "",
    "shelved": False,
    "shelved_until": None,
    "shelved_by": "",
    "note": "",
    "closed": None,
    "action": "",
}


TWO_CLICKS = "(button) => { button.click(); button.click(); }"


def once(content: Any) -> Callable[[Route], None]:
    """Return a handler that answers the first request. Later requests get no response."""
    contents = [content]

    def handle(route: Route) -> None:
        if contents:
            route.fulfill(json=contents.pop())

    return handle


def test_a_confirmation_ends_when_another_kind_of_table_is_chosen(page: Page) -> None:
    """The confirmation of an activation names the kind of the table. It is not shown beside tables of another kind,
    because it would then activate a table of that kind."""
    page.goto("/catalogues")
    tables = page.get_by_test_id("tables")
    expect(tables.get_by_test_id("table-bank").first).to_be_visible()  # a later report would replace the tables below
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


def test_units_are_not_current_after_a_request_without_response(page: Page) -> None:
    """If the server accepts the request of the Fleet page and does not respond, the page states this after a few
    seconds, and no unit is current."""
    page.route("**/api/fleet", once({"units": [UNIT]}))
    page.goto("/fleet")
    expect(page.get_by_test_id("fleet-unit")).to_have_attribute("data-current", "true")
    expect(page.get_by_test_id("fleet-unit")).to_have_attribute("data-current", "false")
    expect(page.get_by_role("alert").first).to_contain_text("No answer from the server")


def test_checks_that_failed_do_not_count_as_checked(page: Page) -> None:
    """While the health checks cannot be read, the page keeps the time of the last successful check, and the lamps are
    not current."""
    page.goto("/admin?show=health")
    health = page.get_by_test_id("health")
    expect(health.get_by_test_id("health-row").first).to_be_visible()
    page.route("**/api/admin/health", lambda route: route.fulfill(status=429, json={"message": "Too busy."}))
    expect(health.get_by_role("alert")).to_contain_text("Too busy.")
    checked = re.search(r"checked \S+Z", health.inner_text())
    assert checked is not None
    with page.expect_request("**/api/admin/health"):
        pass
    expect(health).to_contain_text(checked.group())
    expect(health.get_by_test_id("health-row").first).to_have_attribute("data-state", "unreported")
    expect(health).to_contain_text("not current")


def test_the_period_without_plots_follows_the_clock(page: Page) -> None:
    """Without a plotted parameter, the displayed period, which an export uses, ends at the present time."""
    page.goto("/telemetry?plot=none")
    times = page.get_by_test_id("telemetry").locator(".times").first
    expect(times).to_contain_text("Z to ")
    first = times.inner_text()
    expect(times).not_to_have_text(first)
    page.goto("/telemetry?plot=none&from=2026-01-01T00:00:00Z&to=2026-01-01T01:00:00Z")
    page.get_by_test_id("export").click()
    expect(page.get_by_test_id("export-csv-file")).to_have_attribute(
        "href", re.compile(r"start=2026-01-01T00%3A00%3A00.*end=2026-01-01T01%3A00%3A00")
    )


def test_the_details_of_an_old_alarm_are_read_once(page: Page, at_rest: Callable[[Page], None]) -> None:
    """Commands and events around an alarm are read again only if their period has changed."""
    raised = (datetime.now(UTC) - timedelta(days=2)).isoformat()
    page.route("**/api/alarms?open=true*", lambda route: route.fulfill(json=[{**ALARM, "raised": raised}]))
    requests: list[str] = []
    page.on("request", lambda r: requests.append(r.url) if "/api/commands?" in r.url and "start=" in r.url else None)
    page.goto("/telemetry?below=monitor&plot=none&alarm=7")
    expect(page.get_by_test_id("alarm-detail")).to_contain_text("No commands or events")
    at_rest(page)
    before = len(requests)
    page.wait_for_timeout(4000)
    assert len(requests) == before


def test_the_palette_shows_two_catalogues_of_one_name(page: Page) -> None:
    """Catalogues with the same name, number of stars and date are two results."""
    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    catalogue = {"name": "night", "profile": "cubestar", "format": "cubestar", "author": "ann", "stars": 5, "pairs": 9}
    catalogue |= {"created": "2026-11-01T10:00:00Z", "bytes": 9, "sha256": "a", "valid_from": None, "valid_to": None}
    both = [{**catalogue, "id": number, "validity_known": True, "banks": []} for number in (901, 902)]
    page.route("**/api/catalogues", lambda route: route.fulfill(json=both))
    page.keyboard.press("Control+k")
    page.get_by_test_id("palette-text").fill("night")
    expect(page.get_by_test_id("place").filter(has_text="5 stars")).to_have_count(2)


def test_one_click_or_two_start_one_build_which_keeps_later_edits(page: Page) -> None:
    """A double click on Build starts one build. If the form is edited before the build has ended, its catalogue is not
    opened. A new catalogue does not start with the name and request of the one that was open, and opening the step
    "Stars" of a catalogue of a star list changes nothing."""
    page.goto("/catalogues/new")
    page.get_by_test_id("build-name").fill("first")
    expect(page.get_by_text("preview in")).to_be_visible()
    held: list[Route] = []
    page.route(
        "**/api/catalogues", lambda route: held.append(route) if route.request.method == "POST" else route.continue_()
    )
    page.get_by_test_id("build").dblclick()
    page.get_by_test_id("build-name").fill("second")
    expect(page.get_by_test_id("build")).to_be_disabled()
    assert len(held) == 1
    held[0].continue_()
    expect(page.get_by_text(re.compile(r"Catalogue \d+ was built"))).to_be_visible()
    expect(page).to_have_url(re.compile("/catalogues/new$"))
    expect(page.get_by_test_id("build-name")).to_have_value("second")
    page.unroute("**/api/catalogues")

    page.get_by_test_id("build").click()
    expect(page).to_have_url(re.compile(r"/catalogues/\d+$"))
    expect(page.get_by_role("heading", name="second")).to_be_visible()
    page.keyboard.press("Control+k")
    page.get_by_test_id("palette-text").fill("build a catalogue")
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="New catalogue")).to_be_visible()
    expect(page.get_by_test_id("build-name")).to_have_value("")

    stars = {"id": 3, "name": "own", "stars": 5, "format": "csv", "epoch_jyear": 2000, "frame": "icrs", "dropped": 0}
    page.route("**/api/catalogues/sources", lambda route: route.fulfill(json=[{**stars, "report": {}}]))

    def from_list(route: Route) -> None:
        detail = route.fetch().json()
        route.fulfill(body=json.dumps(detail | {"request": {**detail["request"], "source": "list", "star_list": 3}}))

    page.route("**/api/catalogues/1", from_list)
    page.goto("/catalogues/1")
    page.get_by_test_id("step-4").click()
    expect(page.get_by_test_id("build-list").locator("option", has_text="own")).to_have_count(1)
    expect(page.get_by_text("edited, not built")).to_have_count(0)
    epoch = page.get_by_test_id("list-epoch")
    epoch.fill("1991,25")
    expect(page.get_by_text("a Julian year such as 1991.25 is needed")).to_be_visible()
    expect(page.locator("input[type=file]")).to_be_disabled()


def test_two_clicks_send_one_command(page: Page) -> None:
    """A double click or a second Enter on a confirmation sends the command once, also if the response is slow. A command
    that only its value makes hazardous needs a confirmation, too. A double click schedules a command once."""
    held: list[Route] = []
    for path in ("**/api/commands", "**/api/schedule"):
        page.route(path, lambda r: held.append(r) if r.request.method == "POST" else r.continue_())
    page.goto("/commands?command=POWER")
    page.get_by_test_id("command-form").get_by_role("button", name="off", exact=True).click()
    page.get_by_test_id("command-send").click()
    expect(page.get_by_test_id("hazard")).to_contain_text("loses its stored content")
    page.get_by_test_id("hazard-queue").evaluate(TWO_CLICKS)
    expect(page.get_by_test_id("command-send")).to_have_text("Queueing …")
    expect(page.get_by_test_id("hazard")).to_have_count(0)
    page.get_by_test_id("schedule-add").click()
    page.get_by_test_id("schedule-command").select_option("GET_STATUS")
    expect(page.get_by_test_id("schedule-send")).to_be_enabled()
    page.get_by_test_id("schedule-send").evaluate(TWO_CLICKS)
    expect(page.get_by_test_id("schedule-send")).to_be_disabled()
    assert [route.request.url.rsplit("/", 1)[1] for route in held] == ["commands", "schedule"]
    for route in held:
        route.fulfill(status=409, json={"message": "Busy."})


def test_the_quick_list_runs_the_text_that_it_shows(page: Page, served: Any) -> None:
    """If another user has changed the shown procedure, it does not start; the page then shows its present text."""
    text = "# Morning\n\n## send-1: Send\n\n```command\nGET_STATUS\n```\n"
    stored = served.ask("POST", "/procedures", {"text": text})
    page.goto("/commands")
    step = page.get_by_test_id("quick-step")
    expect(step).to_contain_text("GET_STATUS")
    changed = {"text": text.replace("GET_STATUS", "LIST_TABLES"), "sha256": stored["sha256"]}
    served.ask("PUT", f"/procedures/{stored['id']}", changed)
    page.get_by_test_id("quick-run").click()
    expect(page.get_by_text("The procedure has changed since you opened it").first).to_be_visible()
    expect(step).to_contain_text("LIST_TABLES")
    assert served.ask("GET", "/procedure-runs") == []


def test_the_history_and_the_last_commands_are_read_from_the_server(page: Page, served: Any) -> None:
    """Commands of the contact are listed, and the last ones of a command, although they are not among the latest commands
    of the page. If the commands of a filter cannot be loaded, the page states this instead of showing others."""
    sent = served.ask("POST", "/commands", {"name": "GET_STATUS", "arguments": {}})
    old = {**sent, "id": 9_000_000, "name": "ERASE_BANK", "result": "completed"}
    for part in ("contact=", "name=ERASE_BANK"):
        page.route(re.compile(rf"/api/commands\?.*{part}"), lambda route: route.fulfill(json=[old]))
    page.goto("/commands?command=ERASE_BANK&side=about")
    rows = page.get_by_test_id("history-row")
    expect(rows).to_have_count(1)
    expect(rows).to_have_attribute("data-command", "ERASE_BANK")
    facts = page.get_by_test_id("command-facts")
    expect(facts.locator(".sent")).to_have_count(1)
    expect(facts).not_to_contain_text("Not sent yet")
    page.route(re.compile(r"/api/commands\?.*text="), lambda r: r.fulfill(status=429, json={"message": "Too busy."}))
    page.get_by_test_id("history-text").fill("other")
    expect(page.get_by_test_id("history").get_by_role("alert")).to_contain_text("Too busy.")
    expect(rows).to_have_count(0)
