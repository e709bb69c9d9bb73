"""Measure waiting times in the browser: first view, its size, and the age of the latest state in ten browsers."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench_tables import BenchTable, Value
from tools.browser import chromium, launch_options
from tools.served import Served, served
from tools.soak import wait_for_rest

SEED = 1
BROWSERS = 10
FIRST_VIEW = """() => {
  const paint = performance.getEntriesByName('first-contentful-paint')[0];
  const bytes = (e) => e.transferSize;
  const files = [...performance.getEntriesByType('navigation'), ...performance.getEntriesByType('resource')];
  const page = files.filter((e) => !new URL(e.name).pathname.startsWith('/api/'));
  return { paint: paint ? paint.startTime : null, bytes: page.reduce((sum, e) => sum + bytes(e), 0), files: page.length };
}"""
PIXELS = """() => {
  const late = (window.late = []);
  const stream = new EventSource('/api/stream');
  stream.addEventListener('link', (e) => {
    const sentMs = Date.parse(JSON.parse(e.data).utc);
    requestAnimationFrame(() => requestAnimationFrame(() => late.push(Date.now() - sentMs)));
  });
}"""


def page_load(quick: bool) -> list[BenchTable]:
    """Return the time to the first view, and the delay from a state of the server to its painted frame."""
    if chromium() is None:
        return [BenchTable("page_load", "Pages in a browser", "Skipped: chromium is not installed.", SEED, [])]
    with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "data", "--simulator", "cubestar") as server:
        wait_for_rest(server)
        rows = asyncio.run(_watch(server, 2 if quick else 7, 5.0 if quick else 20.0))
    conditions = (
        "Debian's chromium, headless, drawn in software, on the server's machine. First view: the Live page from an empty cache "
        "until its header bar shows the sensor; bytes as received (gzip) of pages, scripts, styles and fonts, without the "
        "Rerun viewer. Event to pixels: from the time in the server's status message to the second animation frame after "
        "its arrival."
    )
    return [BenchTable("page_load", "Pages in a browser", conditions, SEED, rows)]


async def _watch(server: Served, times: int, seconds: float) -> list[tuple[str, dict[str, Value]]]:
    from playwright.async_api import async_playwright

    session = server.sign_in()
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(**launch_options())

        async def opened() -> tuple[Any, float]:
            context = await browser.new_context()
            await context.add_cookies([{"name": "gss_session", "value": session, "url": server.address}])
            page = await context.new_page()
            start_s = asyncio.get_running_loop().time()
            await page.goto(f"{server.address}/live")
            await page.get_by_text("SIM-0001").first.wait_for()
            return page, asyncio.get_running_loop().time() - start_s

        views = []
        for _ in range(times):
            page, duration_s = await opened()
            views.append((duration_s, await page.evaluate(FIRST_VIEW)))
            await page.context.close()
        rows: list[tuple[str, dict[str, Value]]] = [("first view, one browser", _view(views))]
        pages: list[Any] = []
        for number in (1, BROWSERS):
            pages += [(await opened())[0] for _ in range(number - len(pages))]
            await asyncio.gather(*(page.evaluate(PIXELS) for page in pages))
            await asyncio.sleep(seconds)
            late = [ms for page in pages for ms in await page.evaluate("() => window.late")]
            label = f"event to pixels, {number} browser{'s' if number > 1 else ''} on the Live page"
            rows.append(
                (
                    label,
                    {
                        "median_ms": float(np.median(late)),
                        "p95_ms": float(np.quantile(late, 0.95)),
                        "messages": len(late),
                    },
                )
            )
        await browser.close()
    return rows


def _view(views: list[tuple[float, dict[str, Any]]]) -> dict[str, Value]:
    durations_ms = [1e3 * duration_s for duration_s, _ in views]
    return {
        "median_ms": float(np.median(durations_ms)),
        "p95_ms": float(np.quantile(durations_ms, 0.95)),
        "first_paint_ms": float(np.median([facts["paint"] or 0.0 for _, facts in views])),
        "kB": round(views[-1][1]["bytes"] / 1000, 1),
        "files": views[-1][1]["files"],
    }
