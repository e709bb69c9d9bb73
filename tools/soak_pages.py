"""Open browsers on the Live page for the soak test, and check the event stream, console and memory of each page."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from typing import Any

from tools.browser import launch_options
from tools.served import Served

LATEST_S = 1.0
"""Maximum delay, which is a product requirement. It is a hundred times the typical delay on an idle machine."""
WARM_UP_SHARE = 0.25
GROWTH_MB, GROWTH_SHARE = 8.0, 0.25
"""Maximum growth after the warm-up, during which the bounded lists of a page fill up."""
# This script wraps the page's EventSource to check the numbers of all messages, which are still passed to the page.
LISTEN = """(() => {
  const counts = (window.streamCounts = { messages: 0, dropped: 0, jumps: 0, breaks: 0, late_s: 0, latest_s: 0 });
  const Own = window.EventSource;
  window.EventSource = class extends Own {
    constructor(...given) {
      super(...given);
      let [last, seq] = [0, 0];
      this.addEventListener('error', () => { counts.breaks += 1; });
      this.own = (kind, e) => {
        counts.messages += 1;
        const [event, count] = e.lastEventId.split('.').map(Number);
        if (kind === 'dropped') { counts.dropped += JSON.parse(e.data).dropped; last = 0; }
        else if (kind === 'event') { counts.jumps += seq > 0 && event !== seq + 1; seq = event; }
        else if (count) { counts.jumps += last > 0 && count !== last + 1; last = count; seq ||= event; }
        if (kind !== 'link') return;
        counts.late_s = (Date.now() - Date.parse(JSON.parse(e.data).utc)) / 1000;
        counts.latest_s = Math.max(counts.latest_s, counts.late_s);
      };
    }
    addEventListener(kind, listener, ...more) {
      super.addEventListener(kind, (e) => { if (e instanceof MessageEvent) this.own(kind, e); listener(e); }, ...more);
    }
  };
})();"""


@dataclass
class WatchedPage:
    """One watched page. ``heap_mb``: script memory after a full garbage collection, after warm-up and at the end."""

    page: Any
    script_errors: list[str] = field(default_factory=list)
    heap_mb: list[float] = field(default_factory=list)
    stream: dict[str, float] = field(default_factory=dict)

    def problems(self) -> list[str]:
        """Return a text for each exceeded limit."""
        problems, stream = list(self.script_errors), self.stream
        if stream["dropped"] or stream["breaks"] or stream["jumps"]:
            counts = f"{stream['dropped']} dropped, {stream['jumps']} jumps in the numbers"
            problems.append(f"{counts}, the stream broke {stream['breaks']} times")
        if not stream["messages"] or stream["late_s"] >= LATEST_S:
            problems.append(f"the last header bar of {stream['messages']} messages was {stream['late_s']:.2f} s late")
        before, after = self.heap_mb
        if after - before > max(GROWTH_MB, GROWTH_SHARE * before):
            problems.append(f"the page grew from {before:.1f} to {after:.1f} MB")
        return problems


async def watch(server: Served, session: str, until_s: float, pages: int = 1) -> dict[str, Any]:
    """Keep the Live page open in ``pages`` browser contexts until ``until_s`` of ``time.monotonic``. Return statistics
    and problems."""
    from playwright.async_api import async_playwright

    start_s = time.monotonic()
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(**launch_options())
        watched = [await _opened(browser, server, session) for _ in range(pages)]
        await asyncio.sleep(max(0.0, WARM_UP_SHARE * (until_s - start_s) - (time.monotonic() - start_s)))
        await _measure_heap(watched)
        await asyncio.sleep(max(0.0, until_s - time.monotonic()))
        for page_state in watched:
            page_state.stream = await page_state.page.evaluate("() => window.streamCounts")
        await _measure_heap(watched)
        await browser.close()
    total = {
        name: sum(page_state.stream[name] for page_state in watched)
        for name in ("messages", "dropped", "jumps", "breaks")
    }
    return {
        "pages": pages,
        **total,
        "late": max(page_state.stream["late_s"] for page_state in watched),
        "latest": max(page_state.stream["latest_s"] for page_state in watched),
        "heap_mb": [page_state.heap_mb for page_state in watched],
        "problems": [f"page {k}: {text}" for k, page_state in enumerate(watched) for text in page_state.problems()],
    }


async def _opened(browser: Any, server: Served, session: str) -> WatchedPage:
    context = await browser.new_context()
    await context.add_cookies([{"name": "gss_session", "value": session, "url": server.address}])
    await context.add_init_script(LISTEN)
    watched = WatchedPage(await context.new_page())
    watched.page.on("pageerror", lambda error: watched.script_errors.append(f"script: {error}"))
    watched.page.on(
        "console", lambda m: watched.script_errors.append(f"console: {m.text}") if m.type == "error" else None
    )
    await watched.page.goto(f"{server.address}/live")
    await watched.page.locator("[data-testid=link-state]").wait_for()
    return watched


async def _measure_heap(watched: list[WatchedPage]) -> None:
    for page_state in watched:
        probe = await page_state.page.context.new_cdp_session(page_state.page)
        await probe.send("HeapProfiler.collectGarbage")
        usage = await probe.send("Runtime.getHeapUsage")
        page_state.heap_mb.append(round(usage["usedSize"] / 1e6, 2))
        await probe.detach()
