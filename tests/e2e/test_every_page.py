"""Every page in both themes and two sizes: pictures, no scroll of the document, no serious finding of axe, no console error.

One server, one browser and one seeding serve all of it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2 as httpx
import pytest
from playwright.sync_api import Browser, Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
AXE = "web/node_modules/axe-core/axe.min.js"
SIZES = {"1280x800": (1280, 800), "1920x1080": (1920, 1080)}
# What axe calls serious or critical; rules about whole documents are judged with the page around them.
RUN_AXE = """axe.run(document, {resultTypes: ['violations']}).then((r) => r.violations
  .filter((v) => v.impact === 'serious' || v.impact === 'critical')
  .map((v) => `${v.impact} ${v.id}: ${v.help} (${v.nodes.length}) `
    + v.nodes.slice(0, 3).map((n) => n.html.slice(0, 120)).join(' | ')))"""
# Address, name of the picture, what must stand there.
PAGES = [
    ("/live", "page-live", "command-panel"),
    ("/commands?command=ACTIVATE_BANK", "page-commands", "history-row"),
    ("/telemetry?plot=housekeeping.sensor_temperature_c,housekeeping.stars_matched", "page-telemetry", "plot-stack"),
    ("/frames", "page-frames", "nav-frames"),
    ("/frames/{frame}", "page-frame", "nav-frames"),
    ("/catalogues", "page-catalogues", "catalogue-row"),
    ("/catalogues/{catalogue}", "page-builder", "sweep"),
    ("/catalogues/design", "page-design", "tile-limit_mag"),
    ("/calibration", "page-calibration", "calibration"),
    ("/campaigns?job={job}", "page-campaigns", "paper-ours"),
    ("/contacts?contact=1", "page-contacts", "contact-timeline"),
    ("/admin", "page-admin", "nav-admin"),
]


class Client:
    """Asks the server past the page."""

    def __init__(self, address: str, headers: dict[str, str]) -> None:
        self._address, self._headers = address, headers

    def __call__(self, path: str, body: Any = None) -> Any:
        with httpx.Client(base_url=f"{self._address}/api", headers=self._headers, timeout=30) as client:
            answer = client.get(path) if body is None else client.post(path, json=body)
        return answer.raise_for_status().json()

    def until(self, path: str, done: Callable[[Any], Any], seconds: float = 90) -> Any:
        """Ask until something is found."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = done(self(path))
            if found:
                return found
            time.sleep(0.3)
        raise AssertionError(f"{path} never said so within {seconds} s")


@pytest.fixture(scope="module")
def seeded(address: str, headers: dict[str, str]) -> dict[str, int]:
    """A frame that is solved, a catalogue with a sweep, an experiment: what the pages show."""
    ask = Client(address, headers)
    ask.until("/link", lambda link: link["connected"] and link["dictionary_match"])
    for name in ("SET_MODE", "RUN_ITERATION"):
        ask("/commands", {"name": name, "arguments": {"mode": "lost_in_space"} if name == "SET_MODE" else {}})
    request = {
        "name": "sweep", "profile": "cubestar", "format": "cubestar", "orbit": "elements", "inclination_deg": 97.6,
        "raan_deg": [40, 42], "altitude_km": 557, "start": "2026-12-05", "days": 14, "pointing": "zenith", "faint_mag": 3.8,
        "brightest_per_field": 10,
    }  # fmt: skip
    ask("/catalogues", request)
    job = ask("/campaigns/experiments", {"names": ["moniteq-4-2"], "trials": None, "seed": 1})
    catalogue = ask.until("/catalogues", lambda found: [c["id"] for c in found if c["name"] == "sweep"])
    frame = ask.until("/frames?limit=5", lambda found: [f["id"] for f in found["frames"] if f["matched"]])
    ask.until("/jobs", lambda found: [j for j in found if j["id"] == job["id"] and j["state"] == "done"])
    return {"frame": frame[0], "catalogue": catalogue[0], "job": job["id"]}


@pytest.fixture(scope="module")
def views(browser: Browser, address: str, headers: dict[str, str]) -> Iterator[dict[str, tuple[Page, list[str]]]]:
    """One page per theme, signed in, with the console errors it has had."""
    made = {}
    contexts = []
    for theme in ("dark", "light"):
        context = browser.new_context(base_url=address, viewport={"width": 1280, "height": 800})
        cookie = headers["Cookie"].split("=", 1)[1]
        context.add_cookies(
            [{"name": "gss_session", "value": cookie, "url": address, "httpOnly": True, "sameSite": "Strict"}]
        )
        context.add_init_script(f"localStorage.setItem('gss-theme', '{theme}')")
        page = context.new_page()
        page.set_default_timeout(30_000)
        errors: list[str] = []
        page.on("console", lambda m, errors=errors: errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e, errors=errors: errors.append(str(e)))
        contexts.append(context)
        made[theme] = (page, errors)
    yield made
    for context in contexts:
        context.close()


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("path", "name", "there"), PAGES, ids=[name for _, name, _ in PAGES])
def test_a_page_fits_reads_and_says_what_it_is(
    views, seeded, root: Path, tmp_path: Path, docs_pictures: Path | None, path, name, there, theme
):
    """At 1280x800 the document does not scroll; axe finds nothing serious; the console stays quiet."""
    page, errors = views[theme]
    errors.clear()
    page.set_viewport_size({"width": 1280, "height": 800})
    page.goto(path.format(**seeded))
    expect(page.get_by_test_id(there).first).to_be_visible()
    page.wait_for_timeout(700)
    page.screenshot(path=tmp_path / f"{name}-{theme}-1280x800.png")
    if docs_pictures is not None and theme == "dark":
        page.screenshot(path=docs_pictures / f"{name}.png")
    assert page.evaluate(
        "[document.documentElement.scrollHeight - innerHeight, document.documentElement.scrollWidth - innerWidth]"
    ) == [0, 0]
    page.evaluate((root / AXE).read_text())
    assert page.evaluate(RUN_AXE) == []
    page.set_viewport_size({"width": 1920, "height": 1080})
    page.wait_for_timeout(250)
    page.screenshot(path=tmp_path / f"{name}-{theme}-1920x1080.png")
    assert errors == []
