"""The task "200 photographs imported and compared": make the photographs, import their folder, run a second chain,
and open the comparison of both chains. Measures clicks, seconds, memory, and how long the page did not draw."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import FilePayload, Page, expect

PHOTOGRAPHS, CLOUDY = 200, 8
SEED = 7
NIGHT_MS = 1_800_000
CHAIN, CAMERA = "oersted", "nightcam"
WATCH_DRAWING = """() => {
  window.pauses = [];
  let last = performance.now();
  const draw = (now) => { if (now - last > 100) window.pauses.push(now - last); last = now; requestAnimationFrame(draw); };
  requestAnimationFrame(draw);
}"""


def make_photographs(sources: Sequence[Path], folder: Path) -> None:
    """Write ``PHOTOGRAPHS`` different TIFF files of one camera: the sources with half their own noise
    added, every second one rotated by 180°. ``CLOUDY`` of them show noise only."""
    rng = np.random.default_rng(SEED)
    images = [np.asarray(Image.open(source)) for source in sources]
    for number in range(PHOTOGRAPHS):
        image = images[number % len(images)]
        noise = rng.normal(0.0, np.diff(np.percentile(image, (16, 50)))[0] / 2, image.shape)
        clear = np.median(image) if number >= PHOTOGRAPHS - CLOUDY else np.rot90(image, 2 * (number % 2))
        pixels = np.clip(np.rint(clear + noise), 0, np.iinfo(image.dtype).max).astype(image.dtype)
        Image.fromarray(pixels).save(folder / f"night-{number:03d}.tiff")


def compare_chains(page: Page, chain: str) -> int:
    """Run a second chain on the imported frames and open its comparison with the operational result. Return the
    number of clicks."""
    page.get_by_test_id("nav-campaigns").click()
    page.get_by_test_id("reprocess-chain").select_option(chain)
    page.get_by_test_id("reprocess-source").select_option("import")
    page.get_by_test_id("reprocess-start").click()
    row = page.get_by_test_id("chain-row").filter(has_text=chain).first
    expect(page.get_by_test_id("campaign-job").first).to_have_attribute("data-state", "done", timeout=NIGHT_MS)
    row.click()
    expect(page.get_by_test_id("chain-failure").first).to_be_visible(timeout=NIGHT_MS)
    return 5


def heap_mb(page: Page) -> float:
    """Return the script memory of the page after a garbage collection in MB."""
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    return float(session.send("Runtime.getHeapUsage")["usedSize"]) / 1e6


def add_camera(page: Page, sources: Sequence[Path]) -> None:
    """Import the sources and install the package ``CAMERA`` made from them."""
    headers = {"X-GSS": str(page.request.get("/api/session").json()["csrf"])}
    ids = []
    for source in sources:
        file = FilePayload(name=source.name, mimeType="image/tiff", buffer=source.read_bytes())
        answer = page.request.post("/api/frames/import", headers=headers, multipart={"file": file, "profile": ""})
        ids.append(answer.json()["id"])
    body = {"name": CAMERA, "frame_ids": ids}
    started = page.request.post("/api/instruments/photographs", headers=headers, data=body)
    if not started.ok:
        raise RuntimeError(started.text())
    job = f"/api/jobs/{started.json()['id']}"
    _until(lambda: page.request.get(job).json()["state"] not in ("queued", "running"), "the package of the camera")
    if (ended := page.request.get(job).json())["state"] != "done":
        raise RuntimeError(ended["text"])


def wait_until_solved(page: Page, frames: int) -> dict[str, int]:
    """Wait until this number of imported frames has a ground result; return the number of frames by outcome."""
    counts: dict[str, int] = {}

    def complete() -> bool:
        for outcome in ("solved", "none"):
            answer = page.request.get(f"/api/frames?source=import&limit=1&outcome={outcome}")
            counts[outcome] = int(answer.json()["total"])
        return sum(counts.values()) >= frames

    _until(complete, "the ground results")
    return counts


def _until(done: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + NIGHT_MS / 1000
    while not done():
        if time.monotonic() > end:
            raise TimeoutError(what)
        time.sleep(0.5)
