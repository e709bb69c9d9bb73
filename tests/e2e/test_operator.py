"""The main tasks of an operator, a catalogue manager and an engineer, in the browser."""

from __future__ import annotations

import re
import threading

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Route, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def test_operator_commands_the_sensor_to_an_attitude(page, served, new_frame, picture, pictures):
    """An operator commands the steps to an attitude, compares on-board and ground results, and runs the 1 Hz cycle."""
    new_frame(page)
    expect(page.get_by_test_id("identity")).to_have_text("SIMULATED")
    expect(page.get_by_test_id("dictionary")).to_contain_text("match")
    for step, words in (("FIND_CENTROIDS", "found"), ("MATCH_STARS", "stars"), ("CALCULATE_ATTITUDE", "solved")):
        page.get_by_test_id(f"cmd-{step}").click()
        expect(page.get_by_test_id(f"cmd-{step}")).to_contain_text(words)
    expect(page.get_by_test_id("attitude")).to_contain_text("on board and ground agree")
    expect(page.get_by_test_id("delta-ra")).to_have_text(re.compile(r"^[+−]?\d+\.\d"))

    page.get_by_test_id("set-exposure_ms").fill("300")
    expect(page.get_by_test_id("live-preview")).to_contain_text("Will send SET_EXPOSURE")
    page.get_by_test_id("send-SET_EXPOSURE-exposure_ms").click()
    expect(page.get_by_test_id("recent-SET_EXPOSURE").first).to_contain_text("completed")

    page.get_by_test_id("cmd-cycle").click()
    expect(page.get_by_test_id("cmd-cycle")).to_have_text("Stop cycle")
    expect(page.get_by_test_id("mode")).to_contain_text("TRACKING")
    expect(page.get_by_test_id("cycle").locator("svg .end").nth(7 if pictures else 1)).to_be_visible()
    if pictures:
        expect(page.get_by_test_id("attitude")).to_contain_text("on board and ground agree")
    picture("live")
    page.get_by_test_id("theme").click()
    picture("live-light")
    page.get_by_test_id("theme").click()
    page.get_by_test_id("cmd-cycle").click()
    expect(page.get_by_test_id("cmd-cycle")).to_have_text("Start cycle")

    shown = page.get_by_test_id("set-mode").input_value()
    page.get_by_test_id("send-SET_MODE-mode").click()
    sent = served.until("/commands?name=SET_MODE&limit=1", lambda rows: rows[0] if rows else None)
    assert (shown, sent["arguments"]["mode"]) == ("tracking", "tracking")


def test_commands_have_forms_dry_runs_hazards_and_a_history(page, served, picture):
    """A value out of range cannot be sent. A critical command must be confirmed with its name. The history shows
    results.
    """
    page.goto("/commands")
    page.get_by_test_id("command-search").fill("exposure")
    page.get_by_test_id("dictionary-list").locator("[data-command=SET_EXPOSURE]").click()
    field = page.get_by_test_id("arg-exposure_ms")
    field.fill("2001")
    expect(page.get_by_text("1 – 2 000, got 2 001")).to_be_visible()
    expect(page.get_by_test_id("command-send")).to_be_disabled()
    field.fill("251")
    expect(page.get_by_test_id("byte-preview")).to_contain_text("CRC")
    with page.expect_response("**/api/dictionary"):  # a change of the mode changes the preconditions
        served.ask("POST", "/commands", {"name": "SET_MODE", "arguments": {"mode": "standby"}})
    expect(page.get_by_test_id("mode")).to_contain_text("STANDBY")
    expect(field).to_have_value("251")
    page.get_by_test_id("command-send").click()
    expect(page.get_by_test_id("history-row").filter(has_text="exposure 251")).to_contain_text("completed")

    page.get_by_test_id("command-search").fill("")
    page.get_by_test_id("dictionary-list").locator("[data-command=ERASE_BANK]").click()
    page.get_by_test_id("command-send").click()
    expect(page.get_by_test_id("hazard")).to_contain_text("Confirm a critical command")
    expect(page.get_by_test_id("hazard-queue")).to_be_disabled()
    page.get_by_test_id("hazard-name").fill("ERASE_BAN")
    expect(page.get_by_test_id("hazard-queue")).to_be_disabled()
    picture("commands")
    page.get_by_test_id("hazard-cancel").click()
    expect(page.get_by_test_id("hazard")).to_have_count(0)


def test_manager_builds_uploads_and_activates_a_catalogue(page, picture):
    """A manager builds a catalogue, uploads it to an inactive bank, activates and confirms it. The header shows the
    bank.
    """
    page.goto("/catalogues")
    page.get_by_test_id("new-catalogue").click()
    page.get_by_test_id("build-name").fill("zen-e2e")
    if not page.get_by_role("group", name="Orbit from").is_visible():
        page.get_by_test_id("step-1").click()
    expect(page.get_by_test_id("funnel")).to_contain_text("411")
    page.get_by_role("group", name="Orbit from").get_by_role("button", name="elements").click()
    page.get_by_test_id("build-raan_from").fill("20")
    page.get_by_test_id("build-raan_to").fill("34")
    page.get_by_test_id("step-4").click()
    page.get_by_test_id("build-faint_mag").fill("4")
    expect(page.get_by_test_id("funnel")).to_contain_text("519")
    page.get_by_test_id("build").click()
    expect(page).to_have_url(re.compile(r"/catalogues/\d+"))
    expect(page.get_by_test_id("quality")).to_contain_text("P(fewer than 3)")
    page.get_by_test_id("upload-bank").select_option("A")
    picture("catalogue")
    page.get_by_test_id("upload-start").click()
    expect(page.get_by_test_id("upload")).to_contain_text("committed")
    page.get_by_test_id("activate").click()
    page.get_by_test_id("hazard-name").fill("ACTIVATE_BANK")
    page.get_by_test_id("hazard-queue").click()
    page.get_by_test_id("confirm-bank").click()
    expect(page.get_by_test_id("upload")).to_contain_text("active and confirmed")
    expect(page.get_by_test_id("bank")).to_contain_text("Bank A active")
    expect(page.get_by_test_id("bank")).to_contain_text("zen-e2e")
    expect(page.get_by_test_id("bank")).to_contain_text("left")
    picture("catalogue-active")


def test_engineer_inspects_a_frame(page, new_frame, picture):
    """An engineer opens a frame, previews changed constants of a chain, and stores the result."""
    number = new_frame(page)
    page.goto("/frames")
    expect(page.get_by_test_id("frame-row").first).to_contain_text("correct")
    picture("frames")
    page.get_by_test_id("frame-row").first.click()
    expect(page).to_have_url(re.compile(rf"/frames/{number}\b"))
    expect(page.get_by_test_id("chain-row").filter(has_text="reference")).to_contain_text("correct")
    expect(page.get_by_test_id("star-row").first).to_be_visible()
    stars = page.get_by_test_id("stars")
    for tab in ("No match", "Rejected", "Predicted", "Matched"):
        button = stars.get_by_role("button", name=re.compile(rf"^{tab} \d+$"))
        button.click()
        expect(button).to_have_attribute("aria-pressed", "true")
        expect(stars.locator("tbody tr")).to_have_count(int(button.inner_text().split()[-1]))
    page.get_by_test_id("open-run-chain").click()
    page.get_by_test_id("run-chain-form").get_by_role("button", name="cubestar").click()
    stored = page.get_by_test_id("chain-row").count()
    page.get_by_test_id("slider-min_area_px").fill("2")
    expect(page.get_by_test_id("changed-count")).to_have_text("1 changed")
    page.get_by_test_id("preview").check()
    expect(page.get_by_test_id("preview-result")).to_contain_text("preview: ")
    expect(page.get_by_test_id("preview-result")).to_contain_text("Preview shown")
    picture("frame-preview")
    page.get_by_test_id("blink").click()
    expect(page.get_by_test_id("preview-result")).to_contain_text("Earlier result shown")
    assert page.get_by_test_id("chain-row").count() == stored
    page.get_by_test_id("run-chain").click()
    changed = page.get_by_test_id("chain-row").filter(has_text="min_area_px=2")
    expect(changed.first).to_be_visible()
    expect(changed.first).to_contain_text("cubestar")
    page.get_by_test_id("star-row").first.click()
    picture("frame")
    expect(page.get_by_test_id("open-rerun")).to_contain_text("Open in Rerun")


def test_engineer_imports_a_photograph_and_gets_the_reason_for_a_rejected_one(page, tmp_path):
    """A text file named .png is rejected with a message that names the file."""
    bad = tmp_path / "notes.png"
    bad.write_text("not a picture")
    page.goto("/frames")
    page.get_by_test_id("import-file").set_input_files(bad)
    expect(page.get_by_test_id("import-problem")).to_contain_text("notes.png")


def test_engineer_imports_many_files_and_sees_each_that_was_rejected(page, tmp_path):
    """Valid files are stored although another file is rejected. Files of other types are skipped."""
    run = tmp_path.name  # a repetition of this test stores other files
    names = [f"{run}-{file}" for file in ("one.png", "two.png", "broken.png", "notes.txt")]
    for k, name in enumerate(names):
        (tmp_path / name).write_text("not a picture")
        if k < 2:
            Image.fromarray(np.full((16, 24 + k), 20, np.uint8)).save(tmp_path / name)
    page.goto("/frames")
    page.get_by_test_id("import-file").set_input_files([tmp_path / name for name in names])
    expect(page.get_by_test_id("import-counts")).to_have_text("2 stored, 1 rejected, 1 file of other types skipped")
    expect(page.get_by_test_id("import-problem")).to_contain_text("broken.png")
    for name in names[:2]:
        expect(page.get_by_test_id("frame-row").filter(has_text=name)).to_have_count(1)
    page.get_by_test_id("import-file").set_input_files(tmp_path / names[0])
    expect(page.get_by_test_id("same-as")).to_contain_text("same pixels as frame")
    page.goto("/frames")
    page.get_by_test_id("import-file").set_input_files([tmp_path / name for name in names[:2]])
    expect(page.get_by_test_id("import-known")).to_contain_text(f"{names[1]} as frame")


def test_telemetry_and_contacts_show_received_data(page, picture):
    """Telemetry shows values and plots, and Contacts lists the current contact."""
    page.goto("/telemetry")
    page.get_by_test_id("page-power").click()
    expect(page.get_by_test_id("telemetry")).to_contain_text("3.3 V rail")
    page.goto("/telemetry?page=power&plot=housekeeping.sensor_temperature_c,housekeeping.supply_3v3_v")
    expect(page.get_by_test_id("plot-stack")).to_be_visible()
    picture("telemetry")
    page.locator("[data-field='housekeeping.current_imager_ma'] td.num").first.click()
    expect(page).to_have_url(re.compile("current_imager_ma"))
    page.goto("/contacts")
    expect(page.get_by_test_id("contact-row").first).to_contain_text("SIM-0001")
    expect(page.get_by_test_id("contact-detail")).to_contain_text("Checklist")
    page.get_by_test_id("contact-detail").get_by_role("button", name="Close").click()
    expect(page.get_by_test_id("contact-detail")).to_have_count(0)


def test_abort_answers_its_key_on_every_page(page):
    """Shift+Escape sends ABORT without a dialog."""
    page.goto("/frames")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    page.keyboard.press("Shift+Escape")
    page.goto("/commands")
    expect(page.get_by_test_id("history-row").filter(has_text="ABORT").first).to_contain_text("completed")


@pytest.mark.parametrize("pressed_here", [True, False])
def test_a_waiting_command_is_not_sent_after_abort(page, served, pressed_here):
    """A command that waits for the answer to the previous one is not sent after ABORT, also if another page sent ABORT. A
    message names the command."""

    def sent() -> int:
        return sum(command["name"] == "MATCH_STARS" for command in served.ask("GET", "/commands?limit=100"))

    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    held, before = [], sent()
    page.route(re.compile(r"/api/commands$"), lambda route: route.continue_() if held else held.append(route))
    page.get_by_test_id("cmd-FIND_CENTROIDS").click()
    page.get_by_test_id("cmd-MATCH_STARS").click()
    if pressed_here:
        page.keyboard.press("Shift+Escape")
        expect(page.get_by_test_id("abort-sent")).to_have_attribute("data-point", "done")
    else:
        elsewhere = served.ask("POST", "/commands/abort")["command"]
        expect(page.locator(f"[data-testid=recent-ABORT][href$='id={elsewhere['id']}']")).to_be_visible()
    assert len(held) == 1
    held[0].continue_()
    expect(page.locator("body")).to_contain_text("MATCH_STARS was not sent: ABORT cancelled it")
    assert sent() == before


def test_the_live_page_at_rest_sends_few_requests(page, at_rest):
    """The Live page sends fewer than twelve requests in three seconds, because the event stream updates it."""
    page.goto("/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    at_rest(page)
    requested: list[str] = []
    page.on("request", lambda request: requested.append(request.url))
    page.wait_for_timeout(3000)
    assert len(requested) < 12, requested


def test_the_page_of_a_frame_at_rest_sends_no_requests(page, new_frame, at_rest):
    """A frame that does not change is read once."""
    frame = new_frame(page)
    page.goto(f"/frames/{frame}")
    expect(page.get_by_test_id("chain-row").first).to_be_visible()
    at_rest(page)
    requested: list[str] = []
    page.on("request", lambda request: requested.append(request.url))
    page.wait_for_timeout(2000)
    assert not [url for url in requested if f"/api/frames/{frame}" in url]


@pytest.mark.parametrize(
    ("page_path", "request_path", "empty"),
    [("/procedures", "procedures", "0 stored"), ("/sheet", "analyses", "No sheets yet")],
)
def test_a_list_is_loading_until_the_first_answer(page, page_path, request_path, empty):
    """Before the first answer a page states that it loads, not that its list is empty."""
    held, ended = [], threading.Event()

    def hold(route: Route) -> None:
        if ended.is_set():
            route.continue_()
        else:
            held.append(route)

    page.route(re.compile(rf"/api/{request_path}(\?|$)"), hold)
    page.goto(page_path)
    main = page.locator("main")
    expect(main).to_contain_text("Loading …")
    expect(main).not_to_contain_text(empty)
    assert held
    ended.set()
    for route in held:
        route.continue_()
    expect(main).not_to_contain_text("Loading …")
