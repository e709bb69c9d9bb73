"""A real browser with a real server and a simulated sensor.

Each file has a separate server and sensor, because results depend on what the sensor has imaged before; the browser is
shared. With GSS_DOCS_PICTURES=1 pictures are taken: those shown in a document go to docs/pictures, the others to the
test's folder.
"""

from __future__ import annotations

import os
import re
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, expect, sync_playwright

from tools.browser import chromium_for_tests, launch_options

HERE = Path(__file__).parent
PATIENCE_MS = 30_000
POLL_MS = 50
"""Time between two evaluations of a condition of ``wait_for_function``, which otherwise evaluates it in every drawing."""
SIZE = {"width": 1440, "height": 900}
expect.set_options(timeout=PATIENCE_MS)
# The Rerun viewer tries outside hosts for fonts and telemetry; the content policy stops it and the browser says so.
# A refused request is logged by the browser besides being shown by the page; the tests look at the page.
EXPECTED_ERRORS = (
    "the server responded with a status of 4",
    "Content Security Policy",
    "re_viewer",
    "rerun.io",
    "net::ERR_BLOCKED_BY_CSP",
    "wasm",
)
COUNT_REQUESTS = """(() => {
  const ask = window.fetch;
  window.pending = 0;
  window.fetch = (...what) => {
    window.pending += 1;
    const answer = ask(...what);
    const ended = () => { window.pending -= 1; };
    answer.then(ended, ended);
    return answer;
  };
})();"""
PAINTED = (
    "() => document.fonts.ready.then(() => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r))))"
)
AT_REST = """() => {
  if (window.pending) { window.quiet = undefined; return false; }
  return performance.now() - (window.quiet ??= performance.now()) > 200;
}"""

TRUST = ssl.create_default_context()
"""Reading the certificates takes 27 ms, too long for every request of a test that waits for a result."""

FOLLOW = """(address) => {
  const link = Object.assign(document.createElement('a'), { href: address });
  document.body.append(link);
  link.click();
  link.remove();
}"""
SHOWN = """() => {
  if (document.querySelector('.page > .late')) return false;
  window.quiet = undefined;
  return true;
}"""


@pytest.fixture(scope="module", autouse=True)
def _forked(forked: None) -> None:
    """Fork the servers and simulators of these tests from a preloaded process."""


# --- the browser is shared -----------------------------------------------------------------------------------------

_open = ExitStack()
_browsers: list[Browser] = []


def _close() -> None:
    _browsers.clear()
    _open.close()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """Close the browser before tests of another folder, because a synchronous browser leaves an event loop running in
    this thread.
    """
    del item
    yield
    if nextitem is None or HERE not in nextitem.path.parents:
        _close()


def pytest_sessionfinish() -> None:
    """Close the browser, also after an interruption."""
    _close()


@dataclass(frozen=True)
class Served:
    """A running server. ``headers``: request headers of an admin, for requests that a test sends directly."""

    address: str
    folder: Path
    headers: dict[str, str]

    def ask(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request directly."""
        url = f"{self.address}/api{path}"
        reply = httpx2.request(method, url, headers=self.headers, json=body, timeout=30, verify=TRUST)
        return reply.raise_for_status().json()

    def until(self, path: str, done: Callable[[Any], Any], seconds: float = 90) -> Any:
        """Repeat a request until it returns a result."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if found := done(self.ask("GET", path)):
                return found
            time.sleep(0.2)
        raise AssertionError(f"{path} did not return the expected result within {seconds} s")


@contextmanager
def serving(folder: Path, *arguments: str, **environment: str) -> Iterator[str]:
    """``gss serve`` on a free port with these arguments; the address."""
    command = [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(folder), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment})
    assert process.stdout is not None
    line = next(line for line in process.stdout if "http://" in line)
    try:
        yield line[line.index("http://") :].strip()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=PATIENCE_MS / 1000)
        process.stdout.close()


@pytest.fixture(scope="session")
def serve_units() -> Callable[..., AbstractContextManager[str]]:
    """Function that starts a server with units, each given as NAME=INSTRUMENT@ADDRESS, and returns its address."""

    def start(folder: Path, *units: str, **environment: str) -> AbstractContextManager[str]:
        return serving(folder, *(word for unit in units for word in ("--unit", unit)), **environment)

    return start


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory, signed_in: Callable[..., dict[str, str]]) -> Iterator[Served]:
    """Server of this test file, with a simulated CubeStar at 3 MBd and stars of Orion, and an admin."""
    folder = tmp_path_factory.mktemp("data")
    headers = signed_in(folder)
    with serving(folder, "--simulator", "cubestar") as address:
        yield Served(address, folder, headers)


@contextmanager
def _chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(**launch_options(chromium_for_tests()))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def data_folder(served: Served) -> Path:
    """The server's data folder."""
    return served.folder


@pytest.fixture(scope="module")
def headers(served: Served) -> dict[str, str]:
    """Request headers of an admin, for requests that a test sends directly."""
    return served.headers


@pytest.fixture(scope="module")
def address(served: Served) -> str:
    """Address of the server."""
    return served.address


@pytest.fixture(scope="module")
def browser() -> Browser:
    """Headless Chromium, which all test files share."""
    if not _browsers:
        _browsers.append(_open.enter_context(_chromium()))
    return _browsers[0]


# --- pages --------------------------------------------------------------------------------------------------------


@dataclass
class Watched:
    """A page with its console errors and its requests to other hosts."""

    page: Page
    errors: list[str] = field(default_factory=list)
    strangers: list[str] = field(default_factory=list)

    def look(self) -> None:
        """Fail if there was a console error or a request to another host since the last call."""
        errors, strangers = [*self.errors], [*self.strangers]
        self.errors.clear()
        self.strangers.clear()
        assert errors == []
        assert strangers == []


@contextmanager
def _watched(browser: Browser, address: str, **size: int) -> Iterator[Watched]:
    context = browser.new_context(base_url=address, viewport={**SIZE, **size}, color_scheme="dark")  # type: ignore[typeddict-item]
    context.add_init_script(COUNT_REQUESTS)
    watched = Watched(context.new_page())
    watched.page.set_default_timeout(PATIENCE_MS)

    def on_console(message: ConsoleMessage) -> None:
        if message.type == "error" and not any(word in message.text for word in EXPECTED_ERRORS):
            watched.errors.append(message.text)

    def on_request(request: Request) -> None:
        if not request.url.startswith((address, "data:", "blob:")) and not request.failure:
            watched.strangers.append(request.url)

    watched.page.on("console", on_console)
    watched.page.on("pageerror", lambda error: watched.errors.append(str(error)))
    watched.page.on("requestfinished", on_request)
    yield watched
    context.close()


def _sign_in(page: Page, address: str, key: str) -> None:
    page.context.add_cookies(
        [{"name": "gss_session", "value": key, "url": address, "httpOnly": True, "sameSite": "Strict"}]
    )


@pytest.fixture
def cookie(headers: dict[str, str]) -> str | None:
    """Key of the admin's session; None in tests that sign in by hand."""
    return headers["Cookie"].split("=", 1)[1]


@pytest.fixture(scope="module")
def _tab(browser: Browser, address: str) -> Iterator[Watched]:
    """Page of a file. To open a new one for each test would start a process and compile the scripts each time."""
    with _watched(browser, address) as watched:
        yield watched


@pytest.fixture
def page(_tab: Watched, address: str, cookie: str | None) -> Iterator[Page]:
    """Page of a signed-in admin, without anything stored by an earlier test. The test fails on a console error or on a
    request to another origin."""
    page, context = _tab.page, _tab.page.context
    if cookie:
        _sign_in(page, address, cookie)
    yield page
    page.unroute_all(behavior="ignoreErrors")  # does not wait: a failed test can leave a request without answer
    page.evaluate("() => { localStorage.clear(); sessionStorage.clear(); }")
    page.goto("about:blank")
    context.clear_cookies()
    page.set_viewport_size(SIZE)  # type: ignore[arg-type]
    _tab.look()


@pytest.fixture(scope="module")
def lasting(browser: Browser, address: str, headers: dict[str, str]) -> Iterator[Watched]:
    """One page for all tests of a file, in the smallest supported desktop size."""
    with _watched(browser, address, width=1280, height=800) as watched:
        _sign_in(watched.page, address, headers["Cookie"].split("=", 1)[1])
        yield watched


@pytest.fixture(scope="session")
def follow() -> Callable[[Page, str], None]:
    """Function that clicks on a link to an address of the console and waits for its page. The console is not loaded again:
    0.25 s of processor time instead of 0.7 s."""

    def click(page: Page, address: str) -> None:
        page.evaluate(FOLLOW, address)
        page.wait_for_function(SHOWN, polling=POLL_MS)

    return click


@pytest.fixture(scope="session")
def painted() -> Callable[[Page], None]:
    """Function that waits until the page has painted the last change."""
    return lambda page: page.evaluate(PAINTED)


@pytest.fixture(scope="session")
def at_rest() -> Callable[[Page], None]:
    """Function that waits until the page has sent no request for 0.2 s and has been painted."""

    def wait(page: Page) -> None:
        page.wait_for_function(AT_REST, polling=POLL_MS)
        page.evaluate(PAINTED)

    return wait


@pytest.fixture
def new_frame(served: Served) -> Callable[[Page], int]:
    """Function that takes an image on the Live page, waits for its ground result there, and returns the number of the
    frame.
    """

    def take(page: Page) -> int:
        newest = served.ask("GET", "/frames?limit=1&source=device")["frames"]
        before = newest[0]["id"] if newest else 0
        page.goto("/live")
        expect(page.get_by_test_id("link-state")).to_contain_text("up")
        page.get_by_test_id("cmd-TAKE_IMAGE").click()
        image = page.locator("[data-testid=sky-image][data-ready=true]")
        page.wait_for_function(
            "(before) => Number(document.querySelector('[data-testid=sky-image]')?.dataset.frame) > before",
            arg=before,
            polling=POLL_MS,
        )
        expect(image).to_be_visible()
        number = int(image.get_attribute("data-frame") or 0)
        expect(page.get_by_test_id("attitude")).to_contain_text(re.compile(rf"(?<!solving )frame {number}\b"))
        expect(page.get_by_test_id("ground-ra")).to_contain_text("°")
        return number

    return take


# --- pictures -----------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _shown(docs: Path) -> frozenset[str]:
    """Names of the pictures that a document shows."""
    texts = [page.read_text() for page in docs.rglob("*.md")]
    return frozenset(part.split(".png", 1)[0] for text in texts for part in text.split("pictures/")[1:])


@pytest.fixture(scope="session")
def pictures() -> bool:
    """True if pictures are enabled."""
    return bool(os.environ.get("GSS_DOCS_PICTURES"))


@pytest.fixture
def snap(root: Path, tmp_path: Path, pictures: bool) -> Callable[[Page, str], None]:
    """Function that takes a picture of a page if pictures are enabled."""

    def take(page: Page, name: str) -> None:
        if not pictures:
            return
        from PIL import Image

        page.wait_for_timeout(400)
        page.evaluate(PAINTED)
        folder = root / "docs" / "pictures" if name in _shown(root / "docs") else tmp_path
        file = folder / f"{name}.png"
        page.screenshot(path=file)
        # A palette per picture: a third of the bytes without a visible difference.
        with Image.open(file) as full:
            small = full.convert("RGB").quantize(256, dither=Image.Dither.NONE)
        small.save(file, optimize=True)

    return take


@pytest.fixture
def picture(page: Page, snap: Callable[[Page, str], None]) -> Callable[[str], None]:
    """Function that takes a picture of the page if pictures are enabled."""
    return partial(snap, page)
