"""Setup with the printed link, sign-in, sign-out, the tour, and continuing after the end of a session."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys

import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(180)]
NAME, PASSWORD = "ann", "orion over the sea"
CHEAP = {"GSS_PASSWORD_MEMORY_KIB": "64", "GSS_PASSWORD_PASSES": "1"}


@pytest.fixture(scope="module")
def setup_link(tmp_path_factory):
    """Setup link that ``gss serve`` prints with an empty folder and a simulated CubeStar."""
    folder = tmp_path_factory.mktemp("fresh") / "data"
    command = [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(folder), "--simulator", "cubestar"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, **CHEAP})
    assert process.stdout is not None
    line = next(line for line in process.stdout if "/setup#" in line)
    yield line[line.index("http://") :].split()[0]
    process.send_signal(signal.SIGINT)
    process.wait(timeout=20)
    process.stdout.close()


@pytest.fixture(scope="module")
def address(setup_link):
    """Address of the server without users, instead of the shared server."""
    return setup_link.split("/setup#")[0]


@pytest.fixture
def cookie():
    """No session, because these tests sign in."""
    return


def sign_in(page, name=NAME, password=PASSWORD):
    """Fill the form and press Enter."""
    page.get_by_test_id("sign-in-name").fill(name)
    page.get_by_test_id("sign-in-password").fill(password)
    page.keyboard.press("Enter")


def test_the_printed_link_leads_to_live_by_the_keyboard_alone(page, setup_link, picture):
    """With the keyboard, a user chooses a name and a password, and Live opens. A second use of the link is rejected."""
    page.goto(setup_link)
    expect(page.get_by_test_id("set-up-name")).to_be_focused()
    page.keyboard.type(NAME)
    page.keyboard.press("Tab")
    page.keyboard.type("short")
    expect(page.get_by_test_id("password-words")).to_contain_text("too short: 5 of 10 characters")
    expect(page.get_by_test_id("set-up-go")).to_be_disabled()
    page.get_by_test_id("new-password").fill(PASSWORD)
    page.keyboard.press("Tab")
    page.keyboard.type("orion over the lake")
    expect(page.get_by_text("Passwords differ")).to_be_visible()
    picture("set-up")
    page.get_by_test_id("new-password-again").fill(PASSWORD)
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("/live$"))
    expect(page.get_by_test_id("user-cell")).to_contain_text(NAME)
    expect(page.get_by_test_id("user-cell")).to_contain_text("admin")
    assert "#" not in page.url

    page.context.clear_cookies()
    page.goto("about:blank")
    page.goto(setup_link)
    expect(page.get_by_test_id("link-over")).to_contain_text("invalid, expired or already used")
    expect(page.get_by_test_id("link-over")).to_contain_text("Ask an admin for a new link")
    expect(page.get_by_test_id("set-up")).to_have_count(0)


def test_a_failed_sign_in_gives_the_reason_and_a_successful_one_opens_the_requested_page(page, picture):
    """A wrong password gives a message that does not reveal the wrong part. Sign-in opens the requested page."""
    page.goto("/telemetry")
    expect(page.get_by_test_id("sign-in-name")).to_be_focused()
    sign_in(page, password="not the password")
    expect(page.get_by_test_id("sign-in-problem")).to_contain_text("Wrong name or password")
    expect(page.get_by_test_id("sign-in-password")).to_have_value("")
    expect(page.get_by_test_id("sign-in-password")).to_be_focused()
    picture("sign-in")
    sign_in(page)
    expect(page.get_by_test_id("telemetry")).to_be_visible()
    assert page.url.endswith("/telemetry")


def test_a_tour_leads_an_empty_store_to_the_first_attitude(page, picture):
    """The tour advances with each report of the sensor and ends with the comparison of on-board and ground results.

    After it was closed, a link opens it again.
    """
    page.goto("/live")
    sign_in(page)
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    tour = page.get_by_test_id("tour")
    expect(tour).to_have_attribute("data-step", "0")
    page.get_by_test_id("authority-open").click()
    expect(tour).to_have_attribute("data-step", "0")
    page.get_by_test_id("authority-take").click()
    for step, press in enumerate(("TAKE_IMAGE", "FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"), start=1):
        expect(tour).to_have_attribute("data-step", str(step))
        if step == 2:
            picture("tour")
        page.get_by_test_id(f"cmd-{press}").click()
    expect(tour).to_have_attribute("data-step", "5")
    expect(tour).to_contain_text("the ground result agrees")
    expect(page.get_by_test_id("attitude")).to_contain_text("on board and ground agree")
    page.get_by_test_id("tour-close").click()
    expect(tour).to_have_count(0)
    page.reload()
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    expect(tour).to_have_count(0)
    page.goto("/live?tour=1")
    expect(tour).to_be_visible()


def test_the_page_is_unchanged_after_a_session_ended(page, picture):
    """After the session was ended elsewhere, sign-in opens in place, the half-filled form is kept, and the rejected
    request is not resent.
    """
    page.goto("/commands")
    sign_in(page)
    page.get_by_test_id("command-search").fill("exposure")
    page.get_by_test_id("dictionary-list").locator("[data-command=SET_EXPOSURE]").click()
    page.get_by_test_id("arg-exposure_ms").fill("321")
    held_requests = []
    page.route("**/api/commands?*text=exposure", lambda route: held_requests.append(route))
    with page.expect_request("**/api/commands?*text=exposure"):
        page.get_by_test_id("history-text").fill("exposure")
    deletion_status = page.evaluate(
        """async () => {
            const who = await (await fetch('/api/session')).json();
            const mine = (await (await fetch('/api/sessions')).json()).find((s) => s.own);
            const gone = await fetch('/api/sessions/' + mine.id, { method: 'DELETE', headers: { 'X-GSS': who.csrf } });
            return gone.status;
        }"""
    )
    assert deletion_status == 204
    rejections = [route.fetch() for route in held_requests]  # requested by the old session, rejected after its end
    assert [rejection.status for rejection in rejections] == [401] * len(held_requests) != []
    expect(page.get_by_test_id("session-ended")).to_contain_text("Your session ended")
    expect(page.get_by_test_id("sign-in-name")).to_have_value(NAME)
    expect(page.get_by_test_id("sign-in-password")).to_be_focused()
    picture("session-ended")
    page.get_by_test_id("sign-in-password").fill(PASSWORD)
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("arg-exposure_ms")).to_have_value("321")
    expect(page.get_by_test_id("console-state")).to_contain_text("console connected")
    for route, rejection in zip(
        held_requests, rejections, strict=False
    ):  # answers that are older than the new session do not end it
        route.fulfill(response=rejection)
    page.unroute("**/api/commands?*text=exposure")
    page.get_by_test_id("command-send").click()
    expect(page.get_by_test_id("history-row").filter(has_text="exposure 321")).to_contain_text("completed")


def test_a_user_changes_the_password_and_signs_out(page, picture):
    """A password change needs the old password and keeps the session. After signing out only the new password works."""
    page.goto("/contacts")
    sign_in(page)
    page.get_by_test_id("user-open").click()
    page.get_by_test_id("change-password").click()
    page.get_by_test_id("old-password").fill("not it")
    page.get_by_test_id("new-password").fill("rigel under the hill")
    page.get_by_test_id("new-password-again").fill("rigel under the hill")
    page.get_by_test_id("change-password-go").click()
    expect(page.get_by_test_id("own-problem")).to_contain_text("Wrong current password")
    picture("own-account")
    page.get_by_test_id("old-password").fill(PASSWORD)
    page.get_by_test_id("change-password-go").click()
    expect(page.get_by_test_id("toasts")).to_contain_text("Password changed")
    expect(page.get_by_test_id("contacts")).to_be_visible()
    page.get_by_test_id("user-open").click()
    page.get_by_test_id("sign-out").click()
    expect(page.get_by_test_id("sign-in")).to_be_visible()
    sign_in(page)
    expect(page.get_by_test_id("sign-in-problem")).to_be_visible()
    sign_in(page, password="rigel under the hill")
    expect(page.get_by_test_id("user-cell")).to_contain_text(NAME)
