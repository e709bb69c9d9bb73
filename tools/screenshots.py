"""Take screenshots of every console page at four sizes in both themes.

``python -m tools.screenshots --out FOLDER`` starts a server with a simulated sensor and fills it with example data. It
writes one picture for each page, size and theme, a contact sheet for each page, and ``faults.txt`` with text that is
cut off, pages that scroll sideways, and problems reported by axe.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page, sync_playwright

from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.render import render
from gss.pipeline.sheet.unit import scan
from tools.browser import launch_options
from tools.served import Served, served

ROOT = Path(__file__).resolve().parent.parent
AXE = ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"
SIZES = {"1920x1080": (1920, 1080), "1440x900": (1440, 900), "820x1180": (820, 1180), "390x844": (390, 844)}
THEMES = ("dark", "light")
# Address of each page, by the name of its picture.
PAGES = {
    "live": "/live",
    "commands": "/commands?command=ACTIVATE_BANK",
    "telemetry": "/telemetry?plot=housekeeping.sensor_temperature_c,housekeeping.stars_matched",
    "monitor": "/telemetry?below=monitor",
    "derived": "/telemetry/derived",
    "procedures": "/procedures",
    "frames": "/frames",
    "frame": "/frames/{frame}",
    "catalogues": "/catalogues",
    "builder": "/catalogues/{catalogue}",
    "design": "/catalogues/design",
    "calibration": "/calibration",
    "sheet": "/sheet",
    "campaigns": "/campaigns?job={job}",
    "contacts": "/contacts/{contact}",
    "passes": "/passes?days=1",
    "instruments": "/instruments",
    "admin": "/admin",
}
SWEEP = {
    "name": "sweep", "profile": "cubestar", "format": "cubestar", "orbit": "elements", "inclination_deg": 97.6,
    "raan_deg": [40, 42], "altitude_km": 557, "start": "2026-12-05", "days": 14, "pointing": "zenith", "faint_mag": 3.8,
    "brightest_per_field": 10,
}  # fmt: skip
STATION = {
    "name": "Stellenbosch", "latitude_deg": -33.9275, "longitude_deg": 18.865, "height_m": 136.0, "line_baud": 115_200,
    "mask": [{"azimuth_deg": 0.0, "elevation_deg": 4.0}],
}  # fmt: skip
SHEET_FRAMES = 10
PROCEDURE = """# Check the sensor

## status: Request the status

```command
GET_STATUS
```

## image: Take an image

```command
TAKE_IMAGE
```

## sign: Sign

```sign
The sensor responds.
```
"""
# Problems that axe classifies as serious or critical.
RUN_AXE = """axe.run(document, {resultTypes: ['violations']}).then((r) => r.violations
  .filter((v) => v.impact === 'serious' || v.impact === 'critical')
  .map((v) => `${v.impact} ${v.id}: ${v.help} (${v.nodes.length}) `
    + v.nodes.slice(0, 3).map((n) => n.html.slice(0, 120)).join(' | ')))"""
# Text that is invisible even after scrolling: cut at the edge of the screen, or hidden by an ancestor without an ellipsis.
FIND_CUT = """() => {
  const found = [];
  for (const e of document.querySelectorAll('body *')) {
    const text = [...e.childNodes].filter((n) => n.nodeType === 3).map((n) => n.textContent.trim()).join('');
    if (!text || e.closest('.sr, svg, [aria-hidden=true], option') || !e.checkVisibility()) continue;
    const range = document.createRange();
    range.selectNodeContents(e);
    const box = range.getBoundingClientRect();
    if (box.width < 2 || box.height < 2) continue;
    for (let a = e; a && a !== document.documentElement; a = a.parentElement) {
      const style = getComputedStyle(a), edge = a.getBoundingClientRect();
      if (style.position === 'fixed') break;
      if (/auto|scroll/.test(style.overflowX) || style.textOverflow === 'ellipsis' || style.webkitLineClamp !== 'none') break;
      const hides = style.overflowX !== 'visible' || a === document.body;
      if (hides && (box.right > edge.right + 2 || box.left < edge.left - 2)) { found.push(text.slice(0, 60)); break; }
    }
  }
  return [...new Set(found)];
}"""
# Elements that need horizontal scrolling.
FIND_SIDEWAYS = """() => [...document.querySelectorAll('body, body *')]
  .filter((e) => e.checkVisibility() && /auto|scroll/.test(getComputedStyle(e).overflowX) && e.scrollWidth > e.clientWidth + 2)
  .map((e) => `${e.tagName.toLowerCase()}.${[...e.classList].filter((c) => !c.startsWith('svelte')).join('.')} `
    + `${e.scrollWidth} px in ${e.clientWidth} px`)"""
WAIT_UNTIL_PAINTED = """() => document.fonts.ready.then(
  () => new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r))))"""


@dataclass(frozen=True)
class Seed:
    """Writer of the example data that the pages show."""

    server: Served

    def request(self, method: str, path: str, body: Any = None) -> Any:
        """Return the JSON response of the API."""
        reply = httpx2.request(
            method, f"{self.server.address}/api{path}", headers=self.server.headers, json=body, timeout=60
        )
        return reply.raise_for_status().json()

    def until(self, path: str, done: Callable[[Any], Any], seconds: float = 120) -> Any:
        """Request ``path`` until ``done`` returns a true value for the response, and return that value. Raises
        TimeoutError."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if result := done(self.request("GET", path)):
                return result
            time.sleep(0.3)
        raise TimeoutError(f"{path} did not show the expected state within {seconds} s")

    def fill(self, frames: int = 2) -> dict[str, int]:
        """Take frames, build a catalogue, run an experiment and import an orbit. Return the ids for the addresses of
        the pages."""
        self.until("/link", lambda link: link["connected"] and link["dictionary_match"])
        last_id = max((f["id"] for f in self.request("GET", "/frames?limit=1&source=device")["frames"]), default=0)
        self.request("POST", "/commands", {"name": "SET_MODE", "arguments": {"mode": "lost_in_space"}})
        self.request("POST", "/catalogues", SWEEP)
        self.request("PUT", "/spacecraft", {"text": two_line_elements(datetime.now(UTC)), "source": "tools"})
        self.request("POST", "/stations", STATION)
        job = self.request("POST", "/campaigns/experiments", {"names": ["moniteq-4-2"], "trials": None, "seed": 1})
        frame = last_id
        for _ in range(frames):
            self.request("POST", "/commands", {"name": "RUN_ITERATION", "arguments": {}})
            frame = self.until("/frames?limit=5", partial(_matched_after, frame))[0]
        catalogue = self.until("/catalogues", lambda rows: [c["id"] for c in rows if c["name"] == "sweep"])[0]
        self.until("/jobs", lambda rows: [j for j in rows if j["id"] == job["id"] and j["state"] == "done"])
        contact = self.request("GET", "/contacts")[0]["id"]
        return {"frame": frame, "catalogue": catalogue, "job": job["id"], "contact": contact}

    def fill_studies(self) -> None:
        """Import rendered frames of several pointings, and make a calibration, a sheet, a reprocessing with another
        chain, a derived parameter, a procedure with a run, and an alarm from the stored data."""
        ids = [self._import(k, pixels) for k, pixels in enumerate(rendered_pointings(SHEET_FRAMES))]
        for frame in ids:
            self.until(f"/frames/{frame}", lambda detail: detail["ground"])
        profile = "cubestar"
        calibration = {"kind": "stars", "profile": profile, "name": "rendered", "note": "", "frame_ids": ids}
        jobs = [
            self.request("POST", "/calibrations", calibration | {"models": [], "photometry": True, "psf": True}),
            self.request("POST", "/analyses", {"kind": "sheet", "profile": profile, "frame_ids": ids}),
            self.request("POST", "/campaigns/reprocess", {"chain": "cubestar"}),
        ]
        power = {"name": "power_mw", "expression": "housekeeping.supply_3v3_v * housekeeping.current_imager_ma"}
        self.request("POST", "/telemetry/derived", power | {"title": "Imager power", "unit": "mW", "decimals": 1})
        procedure = self.request("POST", "/procedures", {"text": PROCEDURE})
        self.request("POST", f"/procedures/{procedure['id']}/start", {"automatic": True})
        self.request("POST", "/commands", {"name": "SIM_INJECT", "arguments": {"fault": "overheat", "value": 60}})
        for job in jobs:
            self.until(f"/jobs/{job['id']}", lambda state: state["state"] in ("done", "failed"), 300)
        self.request("POST", "/authority/release")

    def _import(self, number: int, pixels: NDArray[np.generic]) -> int:
        hdu = fits.PrimaryHDU(pixels)
        hdu.header["DATE-OBS"], hdu.header["EXPTIME"] = f"2026-11-26T00:{number:02d}:00", 0.25
        data = BytesIO()
        hdu.writeto(data)
        reply = httpx2.post(
            f"{self.server.address}/api/frames/import",
            headers=self.server.headers,
            files={"file": (f"sky-{number}.fits", data.getvalue())},
            data={"profile": "cubestar"},
            timeout=60,
        )
        return int(reply.raise_for_status().json()["id"])


def _matched_after(frame: int, response: Any) -> list[int]:
    """Return the ids of the matched frames that are later than a frame."""
    return [f["id"] for f in response["frames"] if f["matched"] and f["id"] > frame]


def rendered_pointings(count: int) -> Iterator[NDArray[np.generic]]:
    """Render frames of the camera cubestar at different pointings."""
    camera, rng = shipped_camera("cubestar"), np.random.default_rng(12)
    stars = SolverCache().stars(2026.9).brighter_than(6.0)
    for moment in scan(count, rng):
        yield render(stars, camera.camera, camera.sensor, moment.cam_from_icrs, 0.25, rng).pixels


def two_line_elements(epoch: datetime) -> str:
    """Return two-line elements of a low polar orbit."""
    day = (epoch - datetime(epoch.year, 1, 1, tzinfo=UTC)) / timedelta(days=1) + 1
    lines = [
        f"1 25544U 98067A   {epoch:%y}{day:012.8f}  .00001764  00000-0  38792-4 0  999",
        "2 25544  97.6439 211.2001 0007417  17.6667  85.6398 15.2010347220248",
    ]
    return "ZA-1\n" + "".join(f"{x}{sum(int(c) if c.isdigit() else c == '-' for c in x) % 10}\n" for x in lines)


@contextmanager
def signed_in(server: Served) -> Iterator[Page]:
    """Open a browser page with a signed-in administrator."""
    cookie = server.sign_in("picture-admin")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(**launch_options())
        context = browser.new_context(base_url=server.address)
        context.add_cookies([{"name": "gss_session", "value": cookie, "url": server.address}])
        yield context.new_page()
        browser.close()


def take(page: Page, out: Path, ids: dict[str, int], pages: list[str], sizes: list[str]) -> list[str]:
    """Write the pictures of the pages. Return the detected faults."""
    faults: list[str] = []
    for name in pages:
        files = []
        page.set_viewport_size({"width": 1440, "height": 900})
        page.goto(PAGES[name].format(**ids))
        page.evaluate(AXE.read_text())
        for theme in THEMES:
            if page.locator("html").get_attribute("data-theme") != theme:
                page.get_by_test_id("theme").click()
            for size in sizes:
                width, height = SIZES[size]
                page.set_viewport_size({"width": width, "height": height})
                page.wait_for_timeout(900)
                page.evaluate(WAIT_UNTIL_PAINTED)
                files.append(out / f"{name}-{theme}-{size}.png")
                page.screenshot(path=files[-1])
                where = f"{name} {theme} {size}"
                faults += [f"{where}: {violation}" for violation in page.evaluate(RUN_AXE)]
                if theme == "dark":
                    faults += [f"{where}: cut off: {text}" for text in page.evaluate(FIND_CUT)]
                    faults += [f"{where}: sideways: {part}" for part in page.evaluate(FIND_SIDEWAYS)]
        contact_sheet(files, out / f"sheet-{name}.png")
        print(name, flush=True)
    return faults


def contact_sheet(files: list[Path], out: Path, height: int = 700) -> None:
    """Write the pictures side by side, each ``height`` pixels high, with one row for each theme."""
    rows = [files[: len(files) // 2], files[len(files) // 2 :]]
    pictures = [[_scaled(file, height) for file in row] for row in rows]
    width = max(sum(picture.width + 8 for picture in row) for row in pictures)
    sheet = Image.new("RGB", (width, len(rows) * (height + 8)), "#666")
    for y, row in enumerate(pictures):
        x = 0
        for picture in row:
            sheet.paste(picture, (x, y * (height + 8)))
            x += picture.width + 8
    sheet.save(out)


def _scaled(file: Path, height: int) -> Image.Image:
    with Image.open(file) as full:
        return full.convert("RGB").resize((round(full.width * height / full.height), height), Image.Resampling.LANCZOS)


def main() -> None:
    """Write the pictures and the list of faults."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the pictures")
    parser.add_argument("--pages", nargs="*", choices=list(PAGES), default=list(PAGES))
    parser.add_argument("--sizes", nargs="*", choices=list(SIZES), default=list(SIZES))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "data", "--simulator", "cubestar") as server:
        seed = Seed(server)
        ids = seed.fill()
        seed.fill_studies()
        with signed_in(server) as page:
            faults = take(page, options.out, ids, options.pages, options.sizes)
    (options.out / "faults.txt").write_text("".join(f"{fault}\n" for fault in faults))
    print(f"{len(faults)} faults, see {options.out / 'faults.txt'}")


if __name__ == "__main__":
    main()
