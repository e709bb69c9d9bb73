"""A spacecraft with two heads in the browser: set up, agreement, misalignment with its alarm, and its correction."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(1200)]
START_MS = 600_000
LONG_MS = 240_000
MANY_POINTS = re.compile(r"^([4-9]|\d\d)")
"""The history has a point every 10 s; four make lines."""
BODY = """
time_zero: {now}
motion: inertial
attitude_deg: [84, 0, 20]
heads:
  A: {{mounting_deg: [0, 0, 0]}}
  B: {{mounting_deg: [8, 0, 80], misalignment_arcsec: [240, 0, 0]}}
"""
"""Both heads see the stars of the catalogue on board. Head B is rotated by 240″ about body x from its mounting."""


@pytest.fixture(scope="module")
def data_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def headers(data_folder: Path, signed_in: Callable[..., dict[str, str]]) -> dict[str, str]:
    return signed_in(data_folder)


@pytest.fixture(scope="module")
def address(data_folder: Path, headers: dict[str, str], serve_units: Callable[..., Any]) -> Iterator[str]:
    del headers  # the admin exists before the server starts
    body = data_folder / "sat.yaml"
    body.write_text(BODY.format(now=datetime.now(UTC).isoformat(timespec="seconds")))
    options = {"GSS_SIMULATOR_OPTIONS": f"--body {body}", "GSS_AUTO_DOWNLOAD": "false"}
    with serve_units(data_folder, "A=cubestar@simulator", "B=cubestar@simulator", **options) as url:
        yield url


def test_a_misaligned_head_is_found_and_corrected(
    page: Page, address: str, headers: dict[str, str], picture: Callable[[str], None]
) -> None:
    """Two sensors on one body report their attitudes. The page shows that they disagree with the stored mounting, estimates
    the injected misalignment and raises an alarm for it; after the correction of the mounting they agree."""

    def spacecraft() -> dict[str, Any]:
        reply = httpx2.get(f"{address}/api/fleet/spacecraft", headers=headers, timeout=60).raise_for_status()
        return dict(reply.json()[0])

    for unit in ("A", "B"):
        page.goto("/fleet")
        expect(page.locator(f"[data-unit={unit}][data-current=true]")).to_be_visible(timeout=START_MS)
        page.goto(f"/units/{unit}/live")
        expect(page.get_by_test_id("link-state")).to_contain_text("up", timeout=LONG_MS)
        page.get_by_test_id("cmd-cycle").click()
        expect(page.get_by_test_id("mode")).to_contain_text("TRACKING", timeout=LONG_MS)

    page.goto("/fleet")
    page.get_by_test_id("spacecraft-new").click()
    page.get_by_test_id("spacecraft-name").fill("SAT")
    second = page.get_by_test_id("head-form").nth(1)
    for axis, angle in (("x", "8"), ("y", "0"), ("z", "80")):
        second.get_by_test_id(f"mounting-{axis}").fill(angle)
    page.get_by_test_id("spacecraft-misalignment").fill("60")
    page.get_by_test_id("spacecraft-save").click()

    shown = page.get_by_test_id("spacecraft")
    expect(page.get_by_test_id("fused")).to_contain_text("A + B", timeout=LONG_MS)
    alarm = page.get_by_test_id("head-alarm")
    expect(alarm.filter(has_text="SAT: B is misaligned by 2")).to_be_visible(timeout=LONG_MS)
    expect(alarm.filter(has_text="SAT: A and B differ by 2")).to_be_visible(timeout=LONG_MS)
    expect(shown).to_have_attribute("data-state", re.compile("warning|critical"))
    (pair,) = spacecraft()["pairs"]
    for value, sigma, injected in zip(
        pair["misalignment_arcsec"], pair["misalignment_sigma_arcsec"], (240, 0, 0), strict=True
    ):
        assert abs(value - injected) < 5 * sigma, pair
    for plot in ("angle", "chi2", "misalignment", "drift"):
        expect(page.get_by_test_id(f"plot-{plot}")).to_have_attribute("data-points", MANY_POINTS, timeout=LONG_MS)
    picture("heads")

    alarm.first.get_by_role("button", name="Acknowledge").click()
    expect(page.locator("[data-testid=head-alarm][data-alarm-state=acked]")).to_have_count(1)
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_test_id("correct-head").click()
    expect(page.get_by_test_id("head-table")).to_contain_text(re.compile(r"\+8\.0[67]"), timeout=LONG_MS)
    expect(shown).to_have_attribute("data-state", "ok", timeout=LONG_MS)
