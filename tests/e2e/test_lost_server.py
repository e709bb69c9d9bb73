"""The console without server or line: ABORT is never lost silently, and no lamp stays green."""

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
"""Lamps that claim a present state."""


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
        """Send the process a signal; after SIGKILL wait until it is gone."""
        assert self._process is not None
        self._process.send_signal(number)
        if number == signal.SIGKILL:
            self._process.wait()

    def stop(self) -> None:
        """Stop it, whatever state it is in."""
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
        """ABORT commands in the history."""
        reply = httpx2.get(f"{self.address}/api/commands?name=ABORT", headers=self.headers, timeout=30)
        found: list[dict[str, object]] = reply.raise_for_status().json()
        return found


@pytest.fixture
def server(tmp_path: Path, signed_in: Callable[..., dict[str, str]]) -> Iterator[Server]:
    """A server for one test, because the tests kill it."""
    own = Server(tmp_path, signed_in(tmp_path))
    yield own
    own.stop()


@pytest.fixture
def page(browser: Browser, server: Server) -> Iterator[Page]:
    """The Live page of an admin. A browser logs every request that a dead server does not answer: the log is not checked."""
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


def strip(page: Page):
    """The strip with the state of ABORT."""
    return page.get_by_test_id("abort-strip")


def start_cycle(page: Page) -> None:
    """Start the cycle and wait until the sensor reports it."""
    page.get_by_test_id("cmd-cycle").click()
    expect(page.get_by_test_id("cmd-cycle")).to_have_text("Stop cycle")


def test_abort_without_a_server_ends_as_not_sent_and_stays_until_acknowledged(page, server):
    """The strip is on every page, survives a reload, and offers ABORT again; nothing is sent without another press."""
    server.signal(signal.SIGKILL)
    expect(page.get_by_test_id("offline")).to_contain_text("commands are disabled")
    page.keyboard.press("Shift+Escape")
    expect(strip(page)).to_contain_text("ABORT NOT SENT")
    expect(strip(page)).to_have_attribute("role", "alert")
    expect(strip(page)).to_contain_text("could not be reached")
    expect(strip(page)).to_contain_text("waiting for the server")
    expect(page.get_by_test_id("abort-again")).to_have_count(0)
    page.keyboard.press("3")
    expect(page).to_have_url(re.compile(r"/telemetry"))
    expect(strip(page)).to_contain_text("ABORT NOT SENT")

    server.start()
    expect(page.get_by_test_id("offline")).to_have_count(0)
    expect(page.get_by_test_id("abort-again")).to_be_visible()
    expect(strip(page)).not_to_contain_text("command history has no such ABORT")  # a record may be stored late
    expect(strip(page)).to_contain_text("command history has no such ABORT", timeout=90_000)
    page.reload()
    expect(strip(page)).to_contain_text("ABORT NOT SENT")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    assert server.aborts() == []

    page.get_by_test_id("abort-again").click()
    expect(page.get_by_test_id("abort-completed")).to_have_attribute("data-point", "done")
    expect(page.get_by_test_id("abort-earlier")).to_contain_text("NOT SENT")
    assert [c["result"] for c in server.aborts()] == ["completed"]
    page.get_by_test_id("abort-acknowledge").click()
    expect(strip(page)).to_have_count(0)


def test_abort_that_left_without_an_answer_is_unknown(page, server):
    """The server accepts the connection and dies before it responds: the console shows the result as unknown."""
    server.signal(signal.SIGSTOP)
    page.keyboard.press("Shift+Escape")
    expect(page.get_by_test_id("abort-sent")).to_have_attribute("data-point", "now")
    server.signal(signal.SIGKILL)
    expect(strip(page)).to_contain_text("ABORT UNKNOWN")
    expect(strip(page)).to_contain_text("may or may not have reached the sensor")
    expect(page.get_by_test_id("abort-sent")).to_have_attribute("data-point", "unknown")


def test_abort_on_a_closed_line_is_not_sent_with_the_servers_reason(page, server):
    """The server answers 409: the reason is in the strip, and ABORT is offered when the line is open again."""
    server.post("/link/close")
    expect(page.get_by_test_id("link-state")).to_contain_text("down")
    page.keyboard.press("Shift+Escape")
    expect(strip(page)).to_contain_text("ABORT NOT SENT")
    expect(strip(page)).to_contain_text("the line is down")
    expect(strip(page)).to_contain_text("waiting for the line")


def test_abort_shows_its_stages_and_no_stale_toast(page):
    """Pressed, sent, accepted, completed, each with its time; nothing says "queued" afterwards."""
    page.keyboard.press("Shift+Escape")
    for stage in ("pressed", "sent", "accepted", "completed"):
        expect(page.get_by_test_id(f"abort-{stage}")).to_have_attribute("data-point", "done")
        expect(page.get_by_test_id(f"abort-{stage}")).to_contain_text(re.compile(r"\d\d:\d\d:\d\d\.\dZ"))
    expect(strip(page)).to_contain_text("ABORT completed")
    expect(page.get_by_text("ABORT queued")).to_have_count(0)


def test_no_lamp_claims_a_present_state_without_the_server(page, server):
    """After the server died the header, the cycle and the telemetry are grey and hatched, with the time of the last report."""
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
    """The sensor continues its cycle without a line: the console shows the last report with its time."""
    start_cycle(page)
    server.post("/link/close")
    expect(page.get_by_test_id("link-state")).to_contain_text("down")
    said = re.compile(r"unknown, last reported running \d\d:\d\d:\d\dZ")
    expect(page.get_by_test_id("cycle-state")).to_contain_text(said)
    expect(page.get_by_test_id("cycle")).to_contain_text(re.compile(r"Last reported running \d\d:\d\d:\d\dZ"))
    for part in ("mode", "bank", "dictionary", "key-telemetry", "cycle-state"):
        expect(page.get_by_test_id(part).locator(CURRENT)).to_have_count(0)
    expect(page.get_by_test_id("mode")).to_contain_text("cycle unknown")


def test_space_never_presses_a_button_that_sends(page, server):
    """On Live it freezes and follows whatever has the focus; on Commands it does nothing on Send; Enter presses both."""
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
