"""The console without a server or a line: the state of ABORT and of lamps that report a present state."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import httpx2
import pytest
from playwright.sync_api import Browser, Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
CURRENT = "[data-lamp=ok], [data-lamp=watch], [data-lamp=warning], [data-lamp=critical], [data-lamp=progress]"
"""Selector of lamps that report a present state."""


class Server:
    """``gss serve`` with a simulated sensor, which a test may stop, kill and start again at the same address."""

    def __init__(self, folder: Path, headers: dict[str, str]) -> None:
        self.folder, self.headers = folder, headers
        self.address = ""
        self._process: subprocess.Popen[str] | None = None
        self.start()

    def start(self) -> None:
        """Start the server, on its previous port if it had one."""
        port = self.address.rsplit(":", 1)[1].rstrip("/") if self.address else "0"
        if self._process is not None and self._process.stdout is not None:
            self._process.stdout.close()
        command = [sys.executable, "-m", "gss", "serve", "--port", port, "--data", str(self.folder)]
        self._process = subprocess.Popen([*command, "--simulator", "cubestar"], stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        line = next(line for line in self._process.stdout if "http://" in line)
        self.address = line[line.index("http://") :].strip()

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process. After SIGKILL, wait for its end."""
        assert self._process is not None
        self._process.send_signal(number)
        if number == signal.SIGKILL:
            self._process.wait()

    def stop(self) -> None:
        """Stop the server in any state."""
        assert self._process is not None
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGCONT)
            self._process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=30)
            self._process.kill()
            self._process.wait()
        assert self._process.stdout is not None
        self._process.stdout.close()

    def post(self, path: str) -> None:
        """Send a changing request directly."""
        httpx2.post(f"{self.address}/api{path}", headers=self.headers, timeout=30).raise_for_status()

    def aborts(self) -> list[dict[str, object]]:
        """Return the ABORT commands of the history."""
        reply = httpx2.get(f"{self.address}/api/commands?name=ABORT", headers=self.headers, timeout=30)
        rows: list[dict[str, object]] = reply.raise_for_status().json()
        return rows


@pytest.fixture
def server(tmp_path: Path, signed_in: Callable[..., dict[str, str]]) -> Iterator[Server]:
    """Server of one test, because the tests kill it."""
    server_of_test = Server(tmp_path, signed_in(tmp_path))
    yield server_of_test
    server_of_test.stop()


@pytest.fixture
def page(browser: Browser, server: Server) -> Iterator[Page]:
    """The Live page of an admin. A browser logs every request that a dead server does not answer: the log is not
    checked.
    """
    context = browser.new_context(base_url=server.address, viewport={"width": 1440, "height": 900})
    key = server.headers["Cookie"].split("=", 1)[1]
    context.add_cookies([{"name": "gss_session", "value": key, "url": server.address}])
    live = context.new_page()
    live.set_default_timeout(30_000)
    live.goto("/live")
    expect(live.get_by_test_id("link-state")).to_contain_text("up")
    expect(live.get_by_test_id("dictionary")).to_contain_text("match")
    yield live
    context.close()


def abort_strip(page: Page):
    """Return the strip with the state of ABORT."""
    return page.get_by_test_id("abort-strip")


def start_cycle(page: Page) -> None:
    """Start the cycle and wait until the sensor reports it."""
    page.get_by_test_id("cmd-cycle").click()
    expect(page.get_by_test_id("cmd-cycle")).to_have_text("Stop cycle")


def test_abort_without_a_server_ends_as_not_sent_and_stays_until_acknowledged(page, server):
    """The strip with the unsent ABORT stays on every page and after a reload. ABORT is sent only when it is pressed
    again.
    """
    server.signal(signal.SIGKILL)
    expect(page.get_by_test_id("offline")).to_contain_text("commands are disabled")
    page.keyboard.press("Shift+Escape")
    expect(abort_strip(page)).to_contain_text("ABORT NOT SENT")
    expect(abort_strip(page)).to_have_attribute("role", "alert")
    expect(abort_strip(page)).to_contain_text("could not be reached")
    expect(abort_strip(page)).to_contain_text("waiting for the server")
    expect(page.get_by_test_id("abort-again")).to_have_count(0)
    page.keyboard.press("3")
    expect(page).to_have_url(re.compile(r"/telemetry"))
    expect(abort_strip(page)).to_contain_text("ABORT NOT SENT")

    server.start()
    expect(page.get_by_test_id("offline")).to_have_count(0)
    expect(page.get_by_test_id("outage")).to_contain_text("the server was restarted")
    expect(page.get_by_test_id("outage")).to_contain_text("telemetry was not recorded while it was down")
    expect(page.get_by_test_id("abort-again")).to_be_visible()
    expect(abort_strip(page)).not_to_contain_text("command history has no such ABORT")  # a record may be stored late
    expect(abort_strip(page)).to_contain_text("command history has no such ABORT", timeout=90_000)
    page.reload()
    expect(abort_strip(page)).to_contain_text("ABORT NOT SENT")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    assert server.aborts() == []

    page.get_by_test_id("abort-again").click()
    expect(page.get_by_test_id("abort-completed")).to_have_attribute("data-point", "done")
    expect(page.get_by_test_id("abort-earlier")).to_contain_text("NOT SENT")
    assert [c["result"] for c in server.aborts()] == ["completed"]
    page.get_by_test_id("abort-acknowledge").click()
    expect(abort_strip(page)).to_have_count(0)


def test_abort_that_left_without_an_answer_is_unknown(page, server):
    """If the server ends after it accepted the connection, the console shows the result of ABORT as unknown."""
    server.signal(signal.SIGSTOP)
    page.keyboard.press("Shift+Escape")
    expect(page.get_by_test_id("abort-sent")).to_have_attribute("data-point", "now")
    server.signal(signal.SIGKILL)
    expect(abort_strip(page)).to_contain_text("ABORT UNKNOWN")
    expect(abort_strip(page)).to_contain_text("may or may not have reached the sensor")
    expect(page.get_by_test_id("abort-sent")).to_have_attribute("data-point", "unknown")


def test_abort_on_a_closed_line_is_not_sent_with_the_servers_reason(page, server):
    """On a closed line the strip states that ABORT was not sent, with the reason from the server."""
    server.post("/link/close")
    expect(page.get_by_test_id("link-state")).to_contain_text("down")
    page.keyboard.press("Shift+Escape")
    expect(abort_strip(page)).to_contain_text("ABORT NOT SENT")
    expect(abort_strip(page)).to_contain_text("the line is down")
    expect(abort_strip(page)).to_contain_text("waiting for the line")


def test_abort_shows_its_stages_and_no_stale_toast(page):
    """ABORT shows its stages pressed, sent, accepted and completed with their times, and no message about queueing."""
    page.keyboard.press("Shift+Escape")
    for stage in ("pressed", "sent", "accepted", "completed"):
        expect(page.get_by_test_id(f"abort-{stage}")).to_have_attribute("data-point", "done")
        expect(page.get_by_test_id(f"abort-{stage}")).to_contain_text(re.compile(r"\d\d:\d\d:\d\d\.\dZ"))
    expect(abort_strip(page)).to_contain_text("ABORT completed")
    expect(page.get_by_text("ABORT queued")).to_have_count(0)


def test_no_lamp_claims_a_present_state_without_the_server(page, server):
    """Without the server no lamp reports a present state. Link, mode and cycle are unknown, with their last reported
    state.
    """
    start_cycle(page)
    server.signal(signal.SIGKILL)
    expect(page.get_by_test_id("offline")).to_be_visible()
    for part in ("header", "command-panel", "key-telemetry", "console-state", "authority", "clock", "sky"):
        lamps = page.get_by_test_id(part).locator(CURRENT)
        if part == "command-panel":  # what a step gave is a record of a command
            lamps = page.get_by_test_id("cycle-state").locator(CURRENT)
        expect(lamps).to_have_count(0)
    expect(page.get_by_test_id("header").locator("[data-lamp=unreported]").first).to_be_visible()
    expect(page.get_by_test_id("link-state")).to_contain_text(re.compile(r"unknown\s*last up \d\d:\d\d:\d\dZ"))
    expect(page.get_by_test_id("mode")).to_contain_text(re.compile(r"cycle unknown.*\d\d:\d\d:\d\dZ"))
    expect(page.get_by_test_id("cycle-state")).to_contain_text(re.compile(r"unknown, last reported running"))
    expect(page.get_by_test_id("console-state")).to_contain_text("offline")


def test_the_cycle_is_shown_as_unknown_after_the_line_was_lost(page, server):
    """After the line was lost, the console shows the cycle as unknown, with the last report and its time."""
    start_cycle(page)
    server.post("/link/close")
    expect(page.get_by_test_id("link-state")).to_contain_text("down")
    last_report = re.compile(r"unknown, last reported running \d\d:\d\d:\d\dZ")
    expect(page.get_by_test_id("cycle-state")).to_contain_text(last_report)
    expect(page.get_by_test_id("cycle")).to_contain_text(re.compile(r"Last reported running \d\d:\d\d:\d\dZ"))
    for part in ("mode", "bank", "dictionary", "key-telemetry", "cycle-state"):
        expect(page.get_by_test_id(part).locator(CURRENT)).to_have_count(0)
    expect(page.get_by_test_id("mode")).to_contain_text("cycle unknown")


def test_space_never_presses_a_button_that_sends(page, server):
    """Space freezes the picture on Live and does not press a button that sends. Enter presses the button."""
    sent = "/commands?name=TAKE_IMAGE"

    def images() -> int:
        reply = httpx2.get(f"{server.address}/api{sent}", headers=server.headers, timeout=30)
        return len(reply.raise_for_status().json())

    page.get_by_test_id("cmd-TAKE_IMAGE").click()
    expect(page.get_by_test_id("recent-TAKE_IMAGE")).to_have_count(1)
    expect(page.get_by_test_id("cmd-TAKE_IMAGE")).to_be_focused()
    expect(page.get_by_test_id("sky-image")).to_have_attribute("data-ready", "true")
    page.keyboard.press("Space")
    expect(page.get_by_text("frozen", exact=True)).to_be_visible()
    page.keyboard.press("Space")
    expect(page.get_by_text("frozen", exact=True)).to_have_count(0)
    assert images() == 1
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("recent-TAKE_IMAGE")).to_have_count(2)

    page.goto("/commands")
    page.get_by_test_id("dictionary-list").locator("[data-command=TAKE_IMAGE]").first.click()
    page.get_by_test_id("command-send").focus()
    page.keyboard.press("Space")
    page.get_by_test_id("theme").focus()
    theme = page.evaluate("document.documentElement.dataset.theme")
    page.keyboard.press("Space")  # an ordinary button, on a page without a use of Space
    page.wait_for_function("(before) => document.documentElement.dataset.theme !== before", arg=theme)
    assert images() == 2
    page.get_by_test_id("command-send").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("history-row").filter(has_text="TAKE_IMAGE")).to_have_count(3)
