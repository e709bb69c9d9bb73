"""A real browser on a real server with a simulated sensor. Pictures go to the test's folder, and to docs/pictures with
GSS_DOCS_PICTURES=1."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, expect, sync_playwright

FLAGS = [
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
PATIENCE_MS = 30_000
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


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The server's data folder."""
    folder: Path = tmp_path_factory.mktemp("data")
    return folder


@pytest.fixture(scope="module")
def headers(data_folder: Path, signed_in: Callable[..., dict[str, str]]) -> dict[str, str]:
    """Of requests of an admin, for what a test does past the page."""
    return signed_in(data_folder)


@pytest.fixture(scope="module")
def address(data_folder: Path, headers: dict[str, str]) -> Iterator[str]:
    """``gss serve`` with a simulated CubeStar at 3 MBd and stars of Orion, and an admin; its address."""
    assert headers
    command = [
        sys.executable,
        "-m",
        "gss",
        "serve",
        "--port",
        "0",
        "--data",
        str(data_folder),
        "--simulator",
        "cubestar",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = next(line for line in process.stdout if "http://" in line)
    yield line[line.index("http://") :].strip()
    process.send_signal(signal.SIGINT)
    process.wait(timeout=20)
    process.stdout.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Debian's chromium, headless."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def cookie(headers: dict[str, str]) -> str | None:
    """Key of the admin's session; None in tests that sign in by hand."""
    return headers["Cookie"].split("=", 1)[1]


@pytest.fixture
def page(browser: Browser, address: str, cookie: str | None) -> Iterator[Page]:
    """A page on which an admin is signed in, that fails its test on a console error or on any request that leaves the origin."""
    context = browser.new_context(base_url=address, viewport={"width": 1440, "height": 900})
    if cookie:
        morsel = {"name": "gss_session", "value": cookie, "url": address, "httpOnly": True, "sameSite": "Strict"}
        context.add_cookies([morsel])
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    errors: list[str] = []
    strangers: list[str] = []

    def on_console(message: ConsoleMessage) -> None:
        if message.type == "error" and not any(word in message.text for word in EXPECTED_ERRORS):
            errors.append(message.text)

    def on_request(request: Request) -> None:
        if not request.url.startswith((address, "data:", "blob:")) and not request.failure:
            strangers.append(request.url)

    page.on("console", on_console)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("requestfinished", on_request)
    yield page
    context.close()
    assert errors == []
    assert strangers == []


@pytest.fixture
def picture(page: Page, root: Path, tmp_path: Path) -> Callable[[str], None]:
    """Takes a picture of the page."""
    folder = root / "docs" / "pictures" if os.environ.get("GSS_DOCS_PICTURES") else tmp_path

    def take(name: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        page.wait_for_timeout(400)
        page.screenshot(path=folder / f"{name}.png")

    return take


@pytest.fixture(scope="session")
def docs_pictures(root: Path) -> Path | None:
    """Where the documents' pictures go; None unless they are to be taken."""
    return root / "docs" / "pictures" if os.environ.get("GSS_DOCS_PICTURES") else None
