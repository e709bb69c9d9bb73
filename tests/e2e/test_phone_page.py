"""Live page on a phone: alarms, acknowledgement, ABORT, attitude, link and next pass."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tools.screenshots import STATION

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
PHONE = {"width": 390, "height": 844}


def test_an_operator_on_call_sees_and_acts(page, served, tle_of):
    """The summary shows alarm, attitude and next pass. The operator acknowledges the alarm and sends ABORT there."""
    served.until("/link", lambda link: link["connected"] and link["dictionary_match"])
    served.ask("PUT", "/spacecraft", {"text": tle_of(1), "source": "test"})
    served.ask("POST", "/stations", STATION)
    served.ask("POST", "/commands", {"name": "RUN_ITERATION", "arguments": {}})
    served.ask("POST", "/commands", {"name": "SIM_INJECT", "arguments": {"fault": "overheat", "value": 60}})
    served.until("/alarms", lambda alarms: [a for a in alarms if a["field"] == "sensor_temperature_c"])
    page.set_viewport_size(PHONE)
    page.goto("/live")
    summary = page.get_by_test_id("phone-summary")
    expect(summary).to_contain_text("Sensor temperature")
    expect(page.get_by_test_id("phone-pass")).to_contain_text(re.compile(r"in \d"))
    expect(page.get_by_test_id("attitude")).to_be_in_viewport()
    expect(page.get_by_test_id("link-state")).to_be_in_viewport()
    row = summary.locator(".line", has_text="Sensor temperature")
    row.get_by_test_id("phone-acknowledge").click()
    expect(row.get_by_test_id("phone-acknowledge")).to_have_count(0)
    page.get_by_test_id("header-more").click()
    expect(page.get_by_test_id("authority-open")).to_be_in_viewport()
    abort = page.get_by_test_id("abort")
    expect(abort).to_be_in_viewport()
    abort.click()
    expect(page.get_by_test_id("abort-strip")).to_contain_text("ABORT")


def test_a_command_is_chosen_in_the_dictionary_above_the_form(page, served):
    """The dictionary is folded above the form. It opens on request and closes when a command is chosen."""
    served.until("/link", lambda link: link["connected"] and link["dictionary_match"])
    page.set_viewport_size(PHONE)
    page.goto("/commands")
    send = page.get_by_test_id("command-send")
    expect(send).to_be_in_viewport()
    fold = page.get_by_test_id("dictionary-fold")
    fold.click()
    page.locator("[data-command=SET_MODE]").first.click()
    expect(page).to_have_url(re.compile("command=SET_MODE"))
    expect(page.get_by_test_id("dictionary-list")).not_to_be_visible()
    expect(send).to_be_in_viewport()


def test_abort_stays_beside_a_long_alarm_text(page, served):
    """ABORT stays in the first line of the header at every width, also beside a long alarm text."""
    served.ask("POST", "/commands", {"name": "SIM_INJECT", "arguments": {"fault": "overheat", "value": 60}})
    served.until("/alarms", lambda alarms: [a for a in alarms if a["field"] == "sensor_temperature_c"])
    served.ask("POST", "/commands", {"name": "SIM_INJECT", "arguments": {"fault": "none"}})
    for width in (390, 820, 1280, 1440):
        page.set_viewport_size({"width": width, "height": 844})
        page.goto("/contacts")
        expect(page.get_by_test_id("alarm")).to_contain_text("cleared, not acknowledged")
        box = page.get_by_test_id("abort").bounding_box()
        assert box is not None
        assert box["y"] < 20, width
