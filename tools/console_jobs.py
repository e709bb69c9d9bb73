"""Measure clicks and seconds of an operator's usual tasks in a browser, on a server with a simulated sensor.

``python -m tools.console_jobs --photograph FILE --night FILE FILE FILE`` prints a table in Markdown. A key press that
replaces a mouse click counts as a click. The seconds do not include time for thinking or reading.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from playwright.sync_api import Browser, Page, expect, sync_playwright

from tools import console_night
from tools.browser import launch_options
from tools.process_memory import Memory
from tools.screenshots import two_line_elements

PASSWORD = "orion over the sea"  # noqa: S105 - of a server that lives for minutes
TIMEOUT_MS = 180_000


@dataclass
class Server:
    """Process of ``gss serve`` that can be killed and restarted. ``link``: URL printed at its start."""

    folder: Path
    port: str = "0"
    link: str = ""
    process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        """Start the server, at the previous port if it ran before."""
        command = [sys.executable, "-m", "gss", "serve", "--port", self.port, "--data", str(self.folder)]
        self.process = subprocess.Popen(
            [*command, "--simulator", "cubestar"], stdout=subprocess.PIPE, text=True, env={**os.environ}
        )
        if self.process.stdout is None:
            raise RuntimeError("no pipe to the server")
        line = next(line for line in self.process.stdout if "http://" in line)
        self.link = line[line.index("http://") :].split()[0]
        self.port = self.address.rsplit(":", 1)[1]

    @property
    def address(self) -> str:
        """Address of the console."""
        return self.link.split("/setup#")[0].rstrip("/")

    @property
    def pid(self) -> int:
        """Id of the process. Raises RuntimeError if it does not run."""
        if self.process is None:
            raise RuntimeError("the server does not run")
        return self.process.pid

    def end(self, number: signal.Signals) -> None:
        """End the process."""
        if self.process is not None:
            self.process.send_signal(number)
            self.process.wait(timeout=60)


@dataclass
class Job:
    """One task in progress, with counters of the operator's actions."""

    page: Page
    clicks: int = 0
    fields: int = 0
    start_s: float = field(default_factory=time.monotonic)

    def click(self, testid: str) -> None:
        """Click a control."""
        self.page.get_by_test_id(testid).first.click()
        self.clicks += 1

    def fill(self, testid: str, text: str) -> None:
        """Fill a field."""
        self.page.get_by_test_id(testid).fill(text)
        self.fields += 1

    def wait_for_text(self, testid: str, pattern: str) -> None:
        """Wait until a part of the page matches a regular expression."""
        expect(self.page.get_by_test_id(testid).first).to_contain_text(re.compile(pattern))

    def row(self, name: str) -> str:
        """Return the table row of this task in Markdown."""
        return f"| {name} | {self.clicks} | {self.fields} | {time.monotonic() - self.start_s:.1f} |"


def set_up(page: Page, server: Server) -> str:
    """Measure the task from the printed link to an attitude."""
    job = Job(page)
    page.goto(server.link)
    job.fill("set-up-name", "ann")
    job.fill("new-password", PASSWORD)
    job.fill("new-password-again", PASSWORD)
    job.click("set-up-go")
    job.wait_for_text("link-state", "up")
    job.click("cmd-RUN_ITERATION")
    job.wait_for_text("ground-ra", "°")
    return job.row("set-up link to attitude")


def catalogue(page: Page, server: Server) -> str:
    """Measure the task from a TLE to a confirmed catalogue on board."""
    job = Job(page)
    page.goto(f"{server.address}/catalogues/new")
    job.click("step-1")
    page.get_by_role("group", name="Orbit from").get_by_role("button", name="TLE").click()
    job.clicks += 1
    job.fill("build-tle", two_line_elements(datetime.now(UTC)))
    expect(page.get_by_test_id("build")).to_be_enabled()
    job.click("build")
    expect(page).to_have_url(re.compile(r"/catalogues/\d+"))
    job.click("upload-start")
    job.wait_for_text("upload", "committed")
    job.click("activate")
    job.fill("hazard-name", "ACTIVATE_BANK")
    job.click("hazard-queue")
    job.click("confirm-bank")
    job.wait_for_text("upload", "active and confirmed")
    return job.row("TLE to catalogue active on board")


def photograph(page: Page, server: Server, file: Path) -> str:
    """Measure the task from an image of an unknown camera to its attitude."""
    page.goto(f"{server.address}/frames")
    job = Job(page)
    page.get_by_test_id("import-file").set_input_files(file)
    job.clicks += 2  # the button, and the file in the dialog of the browser
    job.wait_for_text("made-with", "Ground result")  # a single file opens its page
    job.wait_for_text("solved-field", "field of view")
    return job.row("photograph of an unknown camera to attitude, field of view and scale")


def night(page: Page, server: Server, sources: list[Path]) -> str:
    """Measure the task from a folder of 200 photographs of a known camera to the comparison of two chains."""
    console_night.add_camera(page, sources)
    memory = Memory(server.pid)
    with tempfile.TemporaryDirectory() as folder, memory.watched():
        console_night.make_photographs(sources, Path(folder))
        page.goto(f"{server.address}/frames")
        page.evaluate(console_night.WATCH_DRAWING)
        job = Job(page)
        page.get_by_test_id("import-profile").select_option(console_night.CAMERA)
        page.get_by_test_id("import-folder-input").set_input_files(folder)
        job.clicks += 3  # the camera, the button, and the folder in the dialog of the browser
        expect(page.get_by_test_id("import-queue")).to_contain_text("finished", timeout=console_night.NIGHT_MS)
        stored = page.get_by_test_id("import-counts").inner_text()
        rows = [job.row(f"200 photographs of a known camera imported ({stored})")]
        outcomes = console_night.wait_until_solved(page, console_night.PHOTOGRAPHS + len(sources))
        rows.append(job.row(f"the same until all have a ground result ({outcomes})"))
        job.clicks += console_night.compare_chains(page, console_night.CHAIN)
        rows.append(job.row(f"the same until compared with the chain {console_night.CHAIN}"))
        report = page.get_by_test_id("chain-report").inner_text()
    pauses_ms = sorted(page.evaluate("() => window.pauses"))
    print(report[:3000], file=sys.stderr)
    print(
        f"memory at most: server {memory.server_mb:.0f} MB, browser {memory.browser_mb:.0f} MB, "
        f"page {console_night.heap_mb(page):.1f} MB heap; {len(pauses_ms)} pauses in drawing above 100 ms, "
        f"the longest {pauses_ms[-1] if pauses_ms else 0:.0f} ms",
        file=sys.stderr,
    )
    return "\n".join(rows)


def alarm(page: Page, server: Server) -> str:
    """Measure the task from an alarm in the header to its plot and its remedy."""
    page.goto(f"{server.address}/commands?side=training")
    page.get_by_test_id("training-fault").select_option("overheat")
    page.get_by_test_id("training-SIM_INJECT-value").fill("60")
    page.get_by_test_id("training-SIM_INJECT").click()
    page.goto(f"{server.address}/live")
    expect(page.get_by_test_id("alarm")).to_contain_text("Sensor temperature")
    job = Job(page)
    job.click("alarm")
    job.wait_for_text("alarm-detail", "Stop the cycle")
    job.wait_for_text("alarm-detail", "SIM_INJECT")
    return job.row("alarm to cause and remedy")


def hand_over(browser: Browser, page: Page, server: Server) -> str:
    """Measure a request for command authority by another user and its acceptance by the holder."""
    command = [sys.executable, "-m", "gss", "user", "add", "bea", "--role", "operator", "--password-stdin"]
    subprocess.run(
        [*command, "--data", str(server.folder)], input=f"{PASSWORD}\n", text=True, check=True, capture_output=True
    )
    other = browser.new_page(base_url=server.address)
    other.set_default_timeout(TIMEOUT_MS)
    other.goto("/live")
    other.get_by_test_id("sign-in-name").fill("bea")
    other.get_by_test_id("sign-in-password").fill(PASSWORD)
    other.keyboard.press("Enter")
    expect(other.get_by_test_id("authority")).to_contain_text("holds it")
    job, answer = Job(other), Job(page)
    job.click("authority-open")
    job.fill("authority-reason", "next shift")
    job.click("authority-request")
    answer.click("authority-accept")
    job.wait_for_text("authority", "you hold it")
    job.clicks += answer.clicks
    other.close()
    return job.row("hand-over of command authority, both users")


def abort_without_server(page: Page, server: Server) -> str:
    """Measure ABORT while the server is dead, until the page reports that it was not sent; then ABORT again after the
    restart."""
    page.goto(f"{server.address}/live")
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    server.end(signal.SIGKILL)
    job = Job(page)
    job.click("abort")
    job.wait_for_text("abort-strip", "NOT SENT")
    first = job.row("ABORT with the server killed, until NOT SENT")
    server.start()
    expect(page.get_by_test_id("link-state")).to_contain_text("up")
    again = Job(page)
    again.click("abort-again")
    again.wait_for_text("abort-strip", "completed")
    return f"{first}\n{again.row('ABORT again with the server back, until completed')}"


@contextmanager
def _browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(**launch_options())


def main() -> None:
    """Run all tasks and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photograph", type=Path, help="an image of the night sky")
    parser.add_argument("--night", type=Path, nargs=3, help="three images of the night sky of one camera")
    parser.add_argument("--only-night", action="store_true", help="measure only the set-up and the night")
    options = parser.parse_args()
    expect.set_options(timeout=TIMEOUT_MS)
    with tempfile.TemporaryDirectory() as folder, _browser() as browser:
        server = Server(Path(folder) / "data")
        server.start()
        page = browser.new_page(viewport={"width": 1440, "height": 900}, base_url=server.address)
        page.set_default_timeout(TIMEOUT_MS)
        jobs: list[Callable[[], str]] = [
            lambda: set_up(page, server),
            lambda: catalogue(page, server),
            lambda: alarm(page, server),
            lambda: hand_over(browser, page, server),
            lambda: abort_without_server(page, server),
        ]
        if options.photograph:
            jobs.insert(2, lambda: photograph(page, server, options.photograph))
        if options.night:
            jobs.insert(-2, lambda: night(page, server, options.night))
        if options.only_night:
            jobs = [lambda: set_up(page, server), lambda: night(page, server, options.night)]
        print("| job | clicks | fields | seconds |\n|---|---|---|---|")
        try:
            for job in jobs:
                print(job(), flush=True)
        finally:
            server.end(signal.SIGINT)


if __name__ == "__main__":
    main()
