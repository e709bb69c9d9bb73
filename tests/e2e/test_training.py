"""Faults during a contact and the operator's reaction: alarms, authority, procedures, schedule, tables, replay."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import httpx2
import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
PATIENCE_MS = 120_000
"""Timeout for activities of the simulated sensor on a busy machine."""
SAME_COUNT = """() => {
  const [list, header] = ['open-alarms', 'alarm'].map((id) => document.querySelector(`[data-testid=${id}]`)?.textContent);
  return list && header && header.includes(`${parseInt(list)} open`);
}"""

FULLY_SHOWN = """() => {
  const cell = document.querySelector('[data-testid=alarm]'), text = cell.querySelector('.text');
  return text.scrollHeight <= text.clientHeight + 1 || text.textContent.includes('full text on Monitor');
}"""


def choose(page, kind: str, fault: str, value: str) -> None:
    """Fill in the training form and inject the fault."""
    page.get_by_test_id("training-fault").select_option(fault)
    page.get_by_test_id("training-SIM_INJECT-value").fill(value)
    page.get_by_test_id(f"training-{kind}").click()


def remove_faults(page) -> None:
    """Open the training panel and remove all faults, which a failed test may have left."""
    page.goto("/commands?side=training")
    page.get_by_test_id("training-calm").click()
    expect(page.get_by_test_id("training")).to_contain_text("no active fault")


def header_shows_the_whole_alarm(page) -> None:
    """Check that the header shows all of a cleared alarm at 1440 px, and that it states where the text is if it has
    no space for it."""
    alarm = page.get_by_test_id("alarm")
    expect(alarm).to_contain_text("cleared, not acknowledged", timeout=PATIENCE_MS)
    for width in (1440, 1250, 820):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_function(FULLY_SHOWN)
        if width == 1440:
            expect(alarm).not_to_contain_text("full text on Monitor")
    page.set_viewport_size({"width": 1440, "height": 900})
    alarm.click()
    expect(page.get_by_test_id("alarm-detail")).to_contain_text("Cleared, not acknowledged: ")


def test_an_alarm_latches_until_cleared_and_acknowledged(page, at_rest, picture):
    """Overheating raises an alarm, which can be acknowledged and shelved and closes after cooling and
    acknowledgement.
    """
    remove_faults(page)
    choose(page, "SIM_INJECT", "overheat", "60")
    expect(page.get_by_test_id("training")).to_contain_text("1 training fault active")
    picture("training")
    expect(page.get_by_test_id("alarm")).to_contain_text("Sensor temperature")
    page.goto("/telemetry?page=power")
    row = page.locator("[data-testid=alarm-row][data-alarm=sensor_temperature_c]").first
    expect(row).to_have_attribute("data-state", "raised")
    picture("alarms")
    page.goto("/live")
    expect(page.get_by_test_id("alarm")).to_contain_text("Sensor temperature")
    page.get_by_test_id("alarm").click()
    expect(page.get_by_test_id("alarm-detail")).to_contain_text("Stop the cycle")
    expect(page.get_by_test_id("alarm-detail")).to_contain_text("SIM_INJECT")
    expect(page.get_by_test_id("plots").locator("canvas")).to_have_count(1)
    page.wait_for_function(SAME_COUNT, timeout=PATIENCE_MS)
    row.get_by_test_id("acknowledge").click()
    expect(row).to_have_attribute("data-state", "acked")
    row.get_by_test_id("shelve").click()
    page.get_by_test_id("alarm-note").fill("heater test")
    page.get_by_test_id("alarm-note-save").click()
    expect(row).to_have_attribute("data-state", "shelved")
    row.get_by_test_id("unshelve").click()
    remove_faults(page)
    page.goto("/telemetry?page=power")
    at_rest(page)
    header_shows_the_whole_alarm(page)
    rows = page.locator("[data-testid=alarm-row][data-alarm=sensor_temperature_c]")
    for _ in range(PATIENCE_MS // 500):
        again = rows.and_(page.locator("[data-state=cleared]")).get_by_test_id("acknowledge")
        if again.count():  # it became worse after it was acknowledged, which ends the acknowledgement
            again.first.click()
        if not rows.count():
            break
        page.wait_for_timeout(500)
    expect(rows).to_have_count(0)


def test_another_operator_holds_authority_and_it_is_broken_with_a_reason(
    page, picture, address, headers, data_folder, signed_in
):
    """The page names the holder of the authority. ABORT works meanwhile, and commands after the authority was
    broken.
    """
    httpx2.post(f"{address}/api/authority/release", headers=headers)
    other = signed_in(data_folder, "operator", "operator-2")
    taken = httpx2.post(f"{address}/api/authority/take", headers=other)
    assert taken.status_code == 200, taken.text
    page.goto("/commands")
    expect(page.get_by_test_id("authority")).to_contain_text("operator-2 holds it")
    expect(page.get_by_test_id("command-send")).to_be_disabled()
    page.keyboard.press("Shift+Escape")
    expect(page.get_by_test_id("history-row").filter(has_text="ABORT").first).to_contain_text("completed")
    page.get_by_test_id("authority-open").click()
    expect(page.get_by_test_id("authority-break-now")).to_be_disabled()
    page.get_by_test_id("authority-reason").fill("operator-2 left the desk")
    picture("authority")
    page.get_by_test_id("authority-break-now").click()
    expect(page.get_by_test_id("authority")).to_contain_text("you hold it")
    rows = page.get_by_test_id("history-row")
    before = rows.count()
    page.get_by_test_id("command-send").click()
    expect(rows).to_have_count(before + 1)
    expect(rows.first).to_contain_text("completed")


def test_a_quick_list_runs_step_by_step_and_a_schedule_waits_on_board(page, picture):
    """A quick list of two commands completes and can be edited again. A scheduled command is listed and can be cancelled."""
    page.goto("/commands")
    page.get_by_test_id("quick-new").click()
    page.get_by_test_id("quick-name").fill("evening start")
    page.get_by_test_id("step-command").first.select_option("SET_EXPOSURE")
    page.get_by_test_id("step-add").click()
    page.get_by_test_id("step-command").nth(1).select_option("TAKE_IMAGE")
    page.get_by_test_id("quick-save").click()
    expect(page.get_by_test_id("quick-step")).to_have_count(2)
    page.get_by_test_id("quick-run").click()
    expect(page.locator("[data-testid=quick-step][data-state=done]")).to_have_count(2)
    expect(page.get_by_test_id("quick-list")).to_contain_text("completed")
    page.get_by_test_id("quick-edit").click()
    expect(page.get_by_test_id("step-command").nth(1)).to_have_value("TAKE_IMAGE")
    page.get_by_role("button", name="Cancel").click()

    page.get_by_test_id("schedule-add").click()
    page.get_by_test_id("schedule-command").select_option("GET_STATUS")
    at = datetime.now(UTC) + timedelta(minutes=30)
    page.get_by_test_id("schedule-at").fill(at.strftime("%Y-%m-%dT%H:%M:%S"))
    expect(page.get_by_test_id("schedule-form")).to_contain_text("device time")
    page.get_by_test_id("schedule-send").click()
    waiting = page.locator("[data-testid=schedule-row][data-state=waiting]")
    expect(waiting.first).to_contain_text("GET_STATUS")
    picture("quick-list-and-schedule")
    waiting.first.get_by_test_id("schedule-cancel").click()
    expect(waiting).to_have_count(0)


def test_a_calibration_is_written_sent_activated_and_confirmed(page, picture):
    """A table with the values of the profile is stored, sent, activated with its typed name, and confirmed."""
    page.goto("/catalogues")
    page.get_by_test_id("table-new").click()
    page.get_by_test_id("table-name").fill("after bench test")
    page.get_by_test_id("table-save").click()
    page.get_by_test_id("table-row").first.get_by_test_id("table-send").click()
    bank = page.locator("[data-testid=table-bank]").filter(has_text="committed")
    expect(bank).to_have_count(1)
    bank.get_by_test_id("table-activate").click()
    page.get_by_test_id("hazard-name").fill("ACTIVATE_TABLE")
    page.get_by_test_id("hazard-queue").click()
    page.get_by_test_id("table-confirm").click()
    expect(page.locator("[data-testid=table-bank]").filter(has_text="after bench test")).to_contain_text("active")
    picture("tables")


def test_a_stored_frame_is_uploaded_and_solved_on_board(page, new_frame):
    """A stored frame is uploaded into another image memory, and the sensor solves it. The replay is equal."""
    remove_faults(page)
    page.goto(f"/frames/{new_frame(page)}")
    page.get_by_test_id("open-send").click()
    page.get_by_test_id("send-slot").select_option("2")
    page.get_by_test_id("send-frame-start").click()
    expect(page.get_by_test_id("send-frame")).to_contain_text("committed", timeout=PATIENCE_MS)
    on_board = page.get_by_test_id("chain-row").filter(has_text="on board")
    expect(on_board).to_contain_text("equal", timeout=PATIENCE_MS)


def test_a_contact_is_read_back_replayed_and_reported(page, picture):
    """The page shows the counters of a contact, replays its capture, and links to a report without scripts."""
    page.goto("/contacts")
    page.get_by_test_id("contact-row").first.click()
    expect(page.get_by_test_id("contact-detail")).to_contain_text("Counters")
    page.get_by_test_id("replay-speed").select_option("max")
    page.get_by_test_id("replay-start").click()
    expect(page.get_by_test_id("replay")).to_contain_text("ended", timeout=PATIENCE_MS)
    picture("contact")
    report = page.request.get(page.get_by_test_id("pass-report").get_attribute("href"))
    assert report.ok
    assert "<script" not in report.text()
    assert "SIM-0001" in report.text()


def test_an_experiment_shows_the_papers_figures_beside_ours(page, picture):
    """A small run of Erlank's Table 3.6 shows the figures of the paper in a table."""
    page.goto("/campaigns")
    page.get_by_test_id("trials").fill("500")
    page.get_by_test_id("run-erlank-3-6").click()
    expect(page.locator("[data-experiment=erlank-3-6]")).to_contain_text("Erlank 2013 Table 3.6", timeout=60_000)
    expect(page.locator("[data-experiment=erlank-3-6]")).to_contain_text("84.04")
    picture("campaigns")
