"""Real browsers on the Live page for the soak test: checks each page's own event stream, console and memory."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from typing import Any

from tools.browser import launch_options
from tools.served import Served

LATEST_S = 1.0
"""Product requirement; a hundred times the usual delay on an idle machine."""
WARM_SHARE = 0.25
GROWTH_MB, GROWTH_SHARE = 8.0, 0.25
"""Maximum growth after the warm-up: a page keeps bounded lists that fill up in the first minutes."""
# Wraps the page's EventSource: every message still reaches the page, and its numbers are checked as the page checks
# them.
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
class Seen:
    """One page. ``heap_mb``: memory held by its scripts after a full collection, once warm and at the end."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    heap_mb: list[float] = field(default_factory=list)
    stream: dict[str, float] = field(default_factory=dict)

    def problems(self) -> list[str]:
        """Return every limit that did not hold."""
        problems, stream = list(self.complaints), self.stream
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
    """Open the Live page in ``pages`` separate browsers until a time of ``time.monotonic``. Returns statistics and problems."""
    from playwright.async_api import async_playwright

    start_s = time.monotonic()
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(**launch_options())
        seen = [await _opened(browser, server, session) for _ in range(pages)]
        await asyncio.sleep(max(0.0, WARM_SHARE * (until_s - start_s) - (time.monotonic() - start_s)))
        await _weigh(seen)
        await asyncio.sleep(max(0.0, until_s - time.monotonic()))
        for each in seen:
            each.stream = await each.page.evaluate("() => window.streamCounts")
        await _weigh(seen)
        await browser.close()
    total = {name: sum(each.stream[name] for each in seen) for name in ("messages", "dropped", "jumps", "breaks")}
    return {
        "pages": pages,
        **total,
        "late": max(each.stream["late_s"] for each in seen),
        "latest": max(each.stream["latest_s"] for each in seen),
        "heap_mb": [each.heap_mb for each in seen],
        "problems": [f"page {k}: {text}" for k, each in enumerate(seen) for text in each.problems()],
    }


async def _opened(browser: Any, server: Served, session: str) -> Seen:
    context = await browser.new_context()
    await context.add_cookies([{"name": "gss_session", "value": session, "url": server.address}])
    await context.add_init_script(LISTEN)
    seen = Seen(await context.new_page())
    seen.page.on("pageerror", lambda error: seen.complaints.append(f"script: {error}"))
    seen.page.on("console", lambda m: seen.complaints.append(f"console: {m.text}") if m.type == "error" else None)
    await seen.page.goto(f"{server.address}/live")
    await seen.page.locator("[data-testid=link-state]").wait_for()
    return seen


async def _weigh(seen: list[Seen]) -> None:
    for each in seen:
        probe = await each.page.context.new_cdp_session(each.page)
        await probe.send("HeapProfiler.collectGarbage")
        usage = await probe.send("Runtime.getHeapUsage")
        each.heap_mb.append(round(usage["usedSize"] / 1e6, 2))
        await probe.detach()
