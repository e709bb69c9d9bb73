"""Several units in one console: the Fleet page, the pages of a unit, and navigation between units."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(900)]
START_MS = 300_000
UNITS = ("FM1=cubestar@simulator", "EM=nos3@simulator")


@contextmanager
def _serving(folder: Path) -> Iterator[str]:
    command = [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(folder)]
    for unit in UNITS:
        command += ["--unit", unit]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = next(line for line in process.stdout if "http://" in line)
    try:
        yield line[line.index("http://") :].strip()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=60)
        process.stdout.close()


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def headers(data_folder: Path, signed_in: Callable[..., dict[str, str]]) -> dict[str, str]:
    return signed_in(data_folder)


@pytest.fixture(scope="module")
def address(data_folder: Path, headers: dict[str, str]) -> Iterator[str]:
    del headers  # the admin exists before the server starts
    with _serving(data_folder) as url:
        yield url


def test_a_unit_is_opened_from_the_fleet_and_left_for_another_one(page: Page) -> None:
    """The Fleet page lists the units with their state. Addresses, links and ABORT of a unit's pages name the unit."""
    page.goto("/")
    rows = page.get_by_test_id("fleet-unit")
    expect(rows).to_have_count(2)
    expect(page.locator("[data-unit=FM1][data-current=true]")).to_be_visible(timeout=START_MS)
    expect(page.locator("[data-unit=EM][data-current=true]")).to_be_visible(timeout=START_MS)
    expect(page.locator("[data-unit=EM]")).to_contain_text("SIMULATED")
    expect(page.get_by_test_id("abort")).to_have_count(0)
    expect(page.locator("[data-unit=FM1]").get_by_test_id("fleet-abort")).to_have_text("ABORT FM1")

    page.locator("[data-unit=FM1]").get_by_test_id("fleet-open").click()
    expect(page.get_by_test_id("unit-switch").locator("select")).to_have_value("FM1")
    expect(page.get_by_test_id("abort")).to_contain_text("ABORT FM1")
    expect(page.get_by_test_id("link-state")).to_contain_text("up", timeout=START_MS)
    hrefs = page.locator("nav a[data-testid^=nav-]").evaluate_all("all => all.map((a) => a.getAttribute('href'))")
    assert hrefs
    assert all(href.startswith("/units/FM1/") for href in hrefs)
    page.get_by_test_id("nav-commands").click()
    page.wait_for_url("**/units/FM1/commands")

    page.get_by_test_id("unit-switch").locator("select").select_option("EM")
    page.wait_for_url("**/units/EM/commands")
    expect(page.get_by_test_id("unit-switch").locator("select")).to_have_value("EM")
    expect(page.get_by_test_id("header")).to_contain_text("SIMULATED", timeout=START_MS)
    page.get_by_test_id("to-fleet").click()
    page.wait_for_url("**/fleet")
    page.get_by_test_id("nav-admin").click()
    page.wait_for_url("**/admin")
