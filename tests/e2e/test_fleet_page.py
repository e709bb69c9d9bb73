"""Four simulated units of four protocols in one console: the Fleet page, the pages of each unit, and the operator's tour
on the sensors of other manufacturers."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Locator, Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(1200)]
START_MS = 600_000
LONG_MS = 180_000
UNITS = {"FM1": "cubestar", "EM-2": "nos3", "SAG": "sagitta", "ORE": "oresat"}
NO_IMAGES = (
    "This sensor has no command to take image.",
    "This sensor cannot download images.",
    "This sensor cannot accept a catalogue.",
    "This sensor has no command to abort.",
)
ABSENT = {"EM-2": NO_IMAGES, "SAG": NO_IMAGES, "ORE": NO_IMAGES[2:]}
"""Sentences about the functions that each sensor lacks."""


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def headers(data_folder: Path, signed_in: Callable[..., dict[str, str]]) -> dict[str, str]:
    return signed_in(data_folder)


@pytest.fixture(scope="module")
def address(data_folder: Path, headers: dict[str, str], serve_units: Callable[..., Any]) -> Iterator[str]:
    del headers  # the admin exists before the server starts
    units = [f"{name}={instrument}@simulator" for name, instrument in UNITS.items()]
    with serve_units(data_folder, *units) as url:
        yield url


@pytest.fixture
def ask(address: str, headers: dict[str, str]) -> Callable[[str], Any]:
    """Function that returns the JSON of a GET."""
    return lambda path: httpx2.get(f"{address}{path}", headers=headers, timeout=60).raise_for_status().json()


def current(page: Page, unit: str) -> Locator:
    """Row of a unit on the Fleet page that reports at present."""
    return page.locator(f"[data-unit={unit}][data-current=true]")


def operate(page: Page, unit: str) -> None:
    """Open the Live page of a unit from the Fleet page."""
    page.goto("/fleet")
    expect(current(page, unit)).to_be_visible(timeout=START_MS)
    page.locator(f"[data-unit={unit}]").get_by_test_id("fleet-open").click()
    expect(page.get_by_test_id("unit-switch").locator("select")).to_have_value(unit)
    expect(page.get_by_test_id("link-state")).to_contain_text("up", timeout=LONG_MS)


def command(page: Page, name: str, title: str) -> None:
    """Press the button of a command on the Live page and wait until the command is completed."""
    page.get_by_test_id("sensor-commands").get_by_role("button", name=title, exact=True).click()
    expect(page.get_by_test_id(f"recent-{name}").first).to_have_attribute("data-result", "completed", timeout=LONG_MS)


def telemetry(page: Page, field: str) -> Locator:
    """Line of a field in the panel *Key telemetry*."""
    return page.get_by_test_id("key-telemetry").locator(f"[data-field={field}]")


def test_all_four_units_are_current_and_each_is_opened_by_its_name(page: Page) -> None:
    """The Fleet page lists the units with their state. Addresses, links and ABORT of a unit's pages name the unit."""
    page.goto("/")
    expect(page.get_by_test_id("fleet-unit")).to_have_count(4)
    for unit, instrument in UNITS.items():
        expect(current(page, unit)).to_be_visible(timeout=START_MS)
        expect(page.locator(f"[data-unit={unit}]")).to_contain_text("SIMULATED")
        expect(page.locator(f"[data-unit={unit}]")).to_contain_text(instrument)
        expect(page.locator(f"[data-unit={unit}]")).to_contain_text("up, received")
    expect(page.get_by_test_id("abort")).to_have_count(0)
    expect(page.locator("[data-unit=FM1]").get_by_test_id("fleet-abort")).to_have_text("ABORT FM1")
    for unit in ABSENT:
        expect(page.locator(f"[data-unit={unit}]").get_by_test_id("fleet-abort")).to_have_count(0)
        expect(page.locator(f"[data-unit={unit}]").get_by_test_id("fleet-no-abort")).to_have_text(NO_IMAGES[-1])
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator("[data-unit=FM1]").get_by_test_id("fleet-abort")).to_be_in_viewport(ratio=1)
    page.set_viewport_size({"width": 1440, "height": 900})

    operate(page, "FM1")
    expect(page.get_by_test_id("abort")).to_contain_text("ABORT FM1")
    expect(telemetry(page, "sensor_temperature_c")).to_contain_text("ok")
    expect(page.get_by_test_id("absent")).to_have_count(0)
    hrefs = page.locator("nav a[data-testid^=nav-]").evaluate_all("all => all.map((a) => a.getAttribute('href'))")
    assert hrefs
    assert all(href.startswith("/units/FM1/") for href in hrefs)
    page.get_by_test_id("nav-commands").click()
    page.wait_for_url("**/units/FM1/commands")

    for unit in (*ABSENT, "FM1"):
        page.get_by_test_id("unit-switch").locator("select").select_option(unit)
        page.wait_for_url(f"**/units/{unit}/commands")
        expect(page.get_by_test_id("unit-switch").locator("select")).to_have_value(unit)
        expect(page.get_by_test_id("header")).to_contain_text("SIMULATED", timeout=LONG_MS)
        expect(page.get_by_test_id("abort")).to_contain_text(f"ABORT {unit}")
    page.get_by_test_id("to-fleet").click()
    page.wait_for_url("**/fleet")
    page.get_by_test_id("nav-admin").click()
    page.wait_for_url("**/admin")


def test_the_tour_on_nos3(page: Page, picture: Callable[[str], None]) -> None:
    """Connect, command, telemetry, attitude. The page states what the sensor lacks, and has no panel for stages that it
    does not report."""
    operate(page, "EM-2")
    command(page, "REQUEST_DATA", "Request data")
    expect(telemetry(page, "valid")).to_contain_text("solved")
    expect(page.get_by_test_id("sensor-attitude")).to_contain_text("as reported")
    expect(page.get_by_test_id("sensor-ra")).to_have_text(re.compile(r"^\d+\.\d{4}°$"))
    expect(page.get_by_test_id("absent")).to_have_text(list(ABSENT["EM-2"]))
    expect(page.get_by_test_id("recent-commands")).to_be_visible()
    expect(page.get_by_test_id("cycle")).to_have_count(0)
    picture("unit-nos3")


def test_the_tour_on_sagitta(page: Page, picture: Callable[[str], None]) -> None:
    """The alarm and the information of the package lead to Boot; telemetry and attitude follow."""
    operate(page, "SAG")
    expect(page.get_by_test_id("sensor-notes")).to_contain_text("It sends telemetry only after BOOT")
    command(page, "BOOT", "Boot")
    expect(telemetry(page, "cmos_c")).to_contain_text("ok", timeout=LONG_MS)
    command(page, "REQUEST_SOLUTION", "Request solution")
    expect(page.get_by_test_id("sensor-attitude")).to_contain_text("as reported", timeout=LONG_MS)
    expect(page.get_by_test_id("sensor-dec")).to_have_text(re.compile(r"^−?\d+\.\d{4}°$"))
    expect(page.get_by_test_id("absent")).to_have_text(list(ABSENT["SAG"]))
    expect(page.get_by_test_id("alarm")).to_contain_text(re.compile("none|cleared"), timeout=LONG_MS)
    picture("unit-sagitta")


def test_the_tour_on_oresat(page: Page, picture: Callable[[str], None], ask: Callable[[str], Any]) -> None:
    """Connect, command, telemetry; an image is taken, downloaded by SDO and solved on the ground; the cycle gives
    attitudes."""
    operate(page, "ORE")
    command(page, "READ_STATUS", "Read status")
    expect(page.get_by_test_id("mode")).to_contain_text("STANDBY", timeout=LONG_MS)
    page.get_by_test_id("operation-take_image").click()
    expect(page.locator("[data-testid=sky-image][data-ready=true]")).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_test_id("ground-ra")).to_contain_text("°", timeout=LONG_MS)
    (frame,) = ask("/units/ORE/api/frames?source=device")["frames"]
    assert (frame["columns"], frame["rows"], frame["outcome"]) == (640, 480, "solved")
    page.get_by_test_id("operation-start_cycle").click()
    expect(telemetry(page, "known")).to_contain_text("solved", timeout=LONG_MS)
    expect(page.get_by_test_id("absent")).to_have_text(list(ABSENT["ORE"]))
    picture("unit-oresat")


def test_the_image_and_the_attitude_of_a_cubestar_beside_them(page: Page, picture: Callable[[str], None]) -> None:
    """The unit with the full chain takes an image and calculates its attitude while the others report theirs; *Fleet*
    shows the attitudes of all four."""
    operate(page, "FM1")
    page.get_by_test_id("cmd-TAKE_IMAGE").click()
    expect(page.locator("[data-testid=sky-image][data-ready=true]")).to_be_visible(timeout=LONG_MS)
    for step, words in (("FIND_CENTROIDS", "found"), ("MATCH_STARS", "stars"), ("CALCULATE_ATTITUDE", "solved")):
        page.get_by_test_id(f"cmd-{step}").click()
        expect(page.get_by_test_id(f"cmd-{step}")).to_contain_text(words, timeout=LONG_MS)
    expect(page.get_by_test_id("ground-ra")).to_contain_text("°", timeout=LONG_MS)
    picture("unit-cubestar")
    page.goto("/fleet")
    for unit in UNITS:
        expect(current(page, unit)).to_contain_text(re.compile(r"\d\.\d{3}° [+−]\d+\.\d{3}°"), timeout=LONG_MS)
    picture("fleet")


def _is_new(unit: Any, before: Any) -> bool:
    """True if the unit was restarted and has a new contact."""
    return bool(unit["current"] and unit["link"]["contact_id"] not in (None, before["link"]["contact_id"]))


def test_a_restart_asks_first_and_ends_only_one_process(page: Page, ask: Callable[[str], Any]) -> None:
    """*Restart …* needs a confirmation. The process starts again; the others keep their contacts. The audit log of the
    server names the unit."""
    page.goto("/fleet")
    for unit in UNITS:
        expect(current(page, unit)).to_be_visible(timeout=START_MS)
    before = {u["name"]: u for u in ask("/api/fleet")["units"]}
    restart = page.locator("[data-unit=SAG]").get_by_test_id("fleet-restart")
    page.once("dialog", lambda dialog: dialog.dismiss())
    restart.click()
    expect(current(page, "SAG")).to_be_visible()
    page.once("dialog", lambda dialog: dialog.accept())
    restart.click()
    # Between two updates of the page the process can be running again, so that the page need not show its end.
    deadline_s = time.monotonic() + LONG_MS / 1000
    while not _is_new(next(u for u in ask("/api/fleet")["units"] if u["name"] == "SAG"), before["SAG"]):
        assert time.monotonic() < deadline_s, "the process was not restarted"
        page.wait_for_timeout(100)
    expect(current(page, "SAG")).to_be_visible(timeout=START_MS)
    after = {u["name"]: u for u in ask("/api/fleet")["units"]}
    assert [after[name]["restarts"] - before[name]["restarts"] for name in UNITS] == [0, 0, 1, 0]
    kept = [name for name in UNITS if before[name]["link"]["contact_id"] == after[name]["link"]["contact_id"]]
    assert kept == ["FM1", "EM-2", "ORE"]
    assert after["SAG"]["last_end"] == "user admin"
    rows = [row for row in ask("/api/audit") if row["action"] == "fleet.restart_unit"]
    assert {(row["who"], row["result"], row["detail"]) for row in rows} == {("admin", "done", "SAG")}
