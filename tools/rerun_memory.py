"""Measure the memory of the Rerun viewer with the recording of a long contact, or with the live recording.

``python -m tools.rerun_memory --frames 10000`` lets a simulated sensor take one image, stores copies of its frame and
solutions one second apart in the same contact, and opens the recording of the contact in a browser. With
``--live SECONDS`` the browser shows the live recording while the cycle of the sensor runs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

from playwright.sync_api import Browser, Page, expect, sync_playwright
from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from gss.settings import Settings
from gss.store.engine import Database, open_engine
from gss.store.models import Frame, Solution
from tools.browser import launch_options
from tools.console_night import heap_mb
from tools.process_memory import Memory
from tools.screenshots import Seed, two_line_elements
from tools.served import Served, served

OPEN_MS = 900_000
SETTLE_S = 20.0
BATCH = 500
LIVE_STEP_S = 30
WATCH_WASM = """{
  window.wasmMemories = [];
  const keep = (result) => {
    const instance = result.instance ?? result;
    window.wasmMemories.push(...Object.values(instance.exports).filter((e) => e instanceof WebAssembly.Memory));
    return result;
  };
  for (const name of ["instantiate", "instantiateStreaming"]) {
    const original = WebAssembly[name];
    WebAssembly[name] = (...given) => original.apply(WebAssembly, given).then(keep);
  }
}"""


def main() -> None:
    """Measure once and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--live", type=int, metavar="SECONDS", help="measure the live recording for this time")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        if options.live:
            with served(data, "--simulator", "cubestar") as server:
                _one_frame(server)
                _watch_live(server, options.live)
            return
        with served(data, "--simulator", "cubestar") as server:
            contact = _one_frame(server)
        database = Database(open_engine(Settings(data=data).database_url))
        try:
            with database.unit_of_work() as session:
                _copy_frame(session, options.frames - 1)
        finally:
            database.close()
        with served(data) as server:
            print(_open_recording(server, contact))


def _one_frame(server: Served) -> int:
    """Take an image with an orbit set and wait for its ground result. Return the id of the contact."""
    seed = Seed(server)
    seed.until("/link", lambda link: link["dictionary_match"])
    seed.request("PUT", "/spacecraft", {"text": two_line_elements(datetime.now(UTC)), "source": "tools"})
    seed.request("POST", "/commands", {"name": "RUN_ITERATION", "arguments": {}})
    seed.until("/frames?source=device", lambda page: [f for f in page["frames"] if f["matched"]])
    return int(seed.request("GET", "/contacts")[0]["id"])


def _copy_frame(session: Session, copies: int) -> None:
    """Store copies of the only frame and its solutions, one second apart."""
    frame = session.scalars(select(Frame)).one()
    solutions = session.scalars(select(Solution)).all()
    for start in range(1, copies + 1, BATCH):
        later = range(start, min(start + BATCH, copies + 1))
        rows = [
            _values(frame) | {"id": frame.id + n, "number": (frame.number or 0) + n, "taken": _later(frame, n)}
            for n in later
        ]
        session.execute(insert(Frame), rows)
        for solution in solutions:
            copy = _values(solution)
            del copy["id"]
            session.execute(insert(Solution), [copy | {"frame_id": frame.id + n} for n in later])


def _values(row: Frame | Solution) -> dict[str, object]:
    return {column.key: getattr(row, column.key) for column in row.__mapper__.column_attrs}


def _later(frame: Frame, seconds: int) -> datetime:
    return frame.taken + timedelta(seconds=seconds)


def _watch_live(server: Served, seconds: int) -> None:
    """Print the memory of the live recording every ``LIVE_STEP_S`` while the cycle runs."""
    memory, seed = Memory(server.process.pid), Seed(server)
    with sync_playwright() as playwright, memory.watched():
        browser = playwright.chromium.launch(**launch_options())
        page = _viewer_page(browser, server, "live=1")
        seed.request("POST", "/commands", {"name": "START_CYCLE", "arguments": {}})
        for _ in range(0, seconds, LIVE_STEP_S):
            page.wait_for_timeout(LIVE_STEP_S * 1000)
            contact = seed.request("GET", "/contacts")[0]
            print(
                f"{contact['frames']} frames, {contact['rx_bytes'] / 1e6:.1f} MB received, {_viewer_memory(page)}, "
                f"all processes of the browser at most {memory.browser_mb:.0f} MB",
                flush=True,
            )
        browser.close()


def _viewer_page(browser: Browser, server: Served, query: str) -> Page:
    """Open the viewer with a recording."""
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.context.add_cookies([{"name": "gss_session", "value": server.sign_in(), "url": server.address}])
    page.add_init_script(WATCH_WASM)
    page.goto(f"{server.address}/rerun?{query}")
    expect(page.get_by_test_id("rerun-viewer")).to_have_attribute("data-opened", "true", timeout=OPEN_MS)
    return page


def _viewer_memory(page: Page) -> str:
    """Return the memory of the viewer and of the scripts as text."""
    wasm_mb = page.evaluate("() => Math.max(0, ...window.wasmMemories.map((m) => m.buffer.byteLength)) / 1e6")
    return f"script heap {heap_mb(page):.0f} MB, memory of the viewer {wasm_mb:.0f} MB"


def _open_recording(server: Served, contact: int) -> str:
    memory = Memory(server.process.pid)
    with sync_playwright() as playwright, memory.watched():
        browser = playwright.chromium.launch(**launch_options())
        start_s = time.monotonic()
        page = _viewer_page(browser, server, f"contact={contact}")
        opened_s = time.monotonic() - start_s
        page.wait_for_timeout(SETTLE_S * 1000)
        size_mb = int(page.get_by_test_id("rerun-viewer").get_attribute("data-bytes") or 0) / 1e6
        viewer = _viewer_memory(page)
        browser.close()
    return (
        f"opened after {opened_s:.0f} s, recording {size_mb:.1f} MB, {viewer}, all processes of the browser at most "
        f"{memory.browser_mb:.0f} MB, server at most {memory.server_mb:.0f} MB"
    )


if __name__ == "__main__":
    main()
