"""Measure how long tasks block the main thread of the Live page while the sensor cycles at 1 Hz.

The tasks are read from the browser's trace, in processor time (time of the page) and in wall time (including the load
of the machine).
"""

from __future__ import annotations

import asyncio
import json
import tempfile
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np

from tools.bench_tables import BenchTable, Value
from tools.browser import chromium, launch_options
from tools.served import Served, served
from tools.soak import wait_for_rest

SEED = 1
LONG_MS = 50.0
SECONDS = 20.0
WARM_UP_S = 8.0
CATEGORIES = ["toplevel", "devtools.timeline", "disabled-by-default-devtools.timeline", "v8", "blink.user_timing"]
TASK = "ThreadControllerImpl::RunTask"
Event = dict[str, Any]


@dataclass(frozen=True)
class PageTask:
    """One task of a page's main thread. ``parts``: processor milliseconds by called function, without nested calls."""

    at_ms: float
    processor_ms: float
    wall_ms: float
    parts: dict[str, float]


def page_tasks(quick: bool) -> list[BenchTable]:
    """Return the tasks of the Live page while the sensor cycles."""
    if chromium() is None:
        return [BenchTable("page_tasks", "The Live page at 1 Hz", "Skipped: chromium is not installed.", SEED, [])]
    rows = []
    for width, height in ((1440, 900), (1920, 1080)):
        tasks, frames = traced(width, height, 5.0 if quick else SECONDS)
        rows.append((f"{width} x {height}", {"frames": frames, **summary(tasks)}))
    conditions = (
        "Debian's chromium, headless, drawn in software, on the server's machine; the Live page for 20 s while the simulated "
        "sensor cycles at 1 Hz and sends frames at the rate of the line. Tasks of the page's main thread from the browser's "
        "trace; long: above 50 ms. "
        "Processor time is that of the page; wall time includes waiting for other programs."
    )
    return [BenchTable("page_tasks", "The Live page at 1 Hz", conditions, SEED, rows)]


def traced(width: int, height: int, seconds: float) -> tuple[list[PageTask], int]:
    """Return the tasks of the page while the sensor cycles, and the number of frames received in that time."""
    with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "data", "--simulator", "cubestar") as server:
        wait_for_rest(server)
        events, frames = asyncio.run(_trace(server, width, height, seconds))
    return tasks(events), frames


async def _trace(server: Served, width: int, height: int, seconds: float) -> tuple[list[Event], int]:
    from playwright.async_api import async_playwright

    session = server.sign_in()
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(**launch_options())
        context = await browser.new_context(viewport={"width": width, "height": height})
        await context.add_cookies([{"name": "gss_session", "value": session, "url": server.address}])
        page = await context.new_page()
        await page.goto(f"{server.address}/live")
        await page.get_by_text("SIM-0001").first.wait_for()
        body = {"name": "START_CYCLE", "arguments": {}, "confirm": "yes"}
        httpx2.post(f"{server.address}/api/commands", headers=server.headers, json=body, timeout=30).raise_for_status()
        image = page.locator("[data-testid=sky-image]")
        await page.locator("[data-testid=sky-image][data-ready=true]").wait_for()
        await asyncio.sleep(WARM_UP_S)
        before = int(await image.get_attribute("data-frame") or 0)
        await browser.start_tracing(page=page, categories=CATEGORIES)
        await asyncio.sleep(seconds)
        events: list[Event] = json.loads(await browser.stop_tracing())["traceEvents"]
        frames = int(await image.get_attribute("data-frame") or 0) - before
        await browser.close()
    return events, frames


def tasks(events: Sequence[Event]) -> list[PageTask]:
    """Return the tasks of every renderer's main thread from the events of a trace, sorted by time."""
    main_threads = {
        (e["pid"], e["tid"]) for e in events if e["name"] == "thread_name" and e["args"]["name"] == "CrRendererMain"
    }
    complete_events = [e for e in events if e.get("ph") == "X" and (e["pid"], e["tid"]) in main_threads and "tdur" in e]
    long_tasks = []
    for main in main_threads:
        thread_events = sorted(
            (e for e in complete_events if (e["pid"], e["tid"]) == main), key=lambda e: (e["ts"], -e["dur"])
        )
        for outer, inner in _nested(thread_events):
            long_tasks.append(PageTask(outer["ts"] / 1e3, outer["tdur"] / 1e3, outer["dur"] / 1e3, _parts(inner)))
    return sorted(long_tasks, key=lambda task: task.at_ms)


def _nested(events: Sequence[Event]) -> Iterable[tuple[Event, list[Event]]]:
    """Yield each outermost task with all events inside it."""
    end, outer, inner = -1.0, None, []
    for event in events:
        if event["ts"] < end:
            inner.append(event)
        elif event["name"] == TASK:
            if outer is not None:
                yield outer, inner
            end, outer, inner = event["ts"] + event["dur"], event, []
    if outer is not None:
        yield outer, inner


def _parts(inner: Sequence[Event]) -> dict[str, float]:
    durations_ms: Counter[str] = Counter()
    stack: list[Event] = []
    for event in inner:
        while stack and event["ts"] >= stack[-1]["ts"] + stack[-1]["dur"]:
            stack.pop()
        durations_ms[_name(event)] += event["tdur"] / 1e3
        if stack:
            durations_ms[_name(stack[-1])] -= event["tdur"] / 1e3
        stack.append(event)
    return {name: ms for name, ms in durations_ms.most_common() if ms >= 0.05}


def _name(event: Event) -> str:
    data = event.get("args", {}).get("data") or {}
    where = data.get("functionName") or data.get("type") or ""
    return f"{event['name']} {where}".strip()


def summary(tasks: Sequence[PageTask]) -> dict[str, Value]:
    """Return the values of a table row."""
    processor, wall = np.array([t.processor_ms for t in tasks]), np.array([t.wall_ms for t in tasks])
    span_ms = tasks[-1].at_ms - tasks[0].at_ms
    return {
        "tasks": len(tasks),
        "longest_ms": float(processor.max()),
        "p99_ms": float(np.quantile(processor, 0.99)),
        "long": int((processor > LONG_MS).sum()),
        "longest_wall_ms": float(wall.max()),
        "long_wall": int((wall > LONG_MS).sum()),
        "busy_percent": float(100 * processor.sum() / span_ms),
    }


def main() -> None:
    """Print the longest tasks and their parts."""
    tasks, frames = traced(1440, 900, SECONDS)
    print(frames, "frames", summary(tasks))
    for task in sorted(tasks, key=lambda t: -t.processor_ms)[:12]:
        print(
            f"{task.processor_ms:7.1f} ms processor {task.wall_ms:7.1f} ms wall at {task.at_ms - tasks[0].at_ms:9.0f}"
        )
        for name, ms in list(task.parts.items())[:8]:
            print(f"        {ms:6.1f}  {name}")


if __name__ == "__main__":
    main()
