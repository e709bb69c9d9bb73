"""Loading of a frame over a slow network, in a browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
SLOW_MS = 120_000
SLOW_PIXELS = """(() => {
  const real = window.fetch;
  window.fetch = async (...request) => {
    const response = await real(...request);
    if (!response.url.endsWith('/raw')) return response;
    window.downloads = (window.downloads ?? 0) + 1;
    const bytes = new Uint8Array(await response.arrayBuffer());
    let sent = 0;
    const body = new ReadableStream({
      async pull(stream) {
        await new Promise((resolve) => setTimeout(resolve, 1000));
        if (sent < bytes.length) stream.enqueue(bytes.slice(sent, (sent += bytes.length / 8)));
        else stream.close();
      },
    });
    return new Response(body, { headers: response.headers });
  };
})();"""
"""The pixels are received in eight parts, one per second."""
COUNTED = r"""(start) => {
  const text = document.querySelector('[data-testid=frame-loading]')?.textContent ?? '';
  return text.startsWith(start) && /: [\d.]+ KiB of 512\.0 KiB$/.test(text);
}"""


def test_a_frame_that_loads_slowly_shows_results_and_received_bytes(
    page: Page, served: Any, new_frame: Callable[[Page], int]
) -> None:
    """While the pixels are received, the page shows the results of the frame and states how many bytes of how many have
    arrived. A new result of the frame is shown and does not restart the download. Afterwards the image is shown and the
    statement disappears."""
    number = new_frame(page)
    page.add_init_script(SLOW_PIXELS)
    page.goto(f"/frames/{number}")
    page.wait_for_function(COUNTED, arg=f"Loading frame {number}: ", polling=50, timeout=SLOW_MS)
    expect(page.get_by_test_id("star-row").first).to_be_visible()
    expect(page.get_by_test_id("sky-image")).to_have_count(0)
    results = page.get_by_test_id("chain-row").count()
    served.ask("POST", f"/frames/{number}/solve", {"chain": "reference", "profile": "cubestar"})
    expect(page.get_by_test_id("chain-row")).to_have_count(results + 1)
    expect(page.get_by_test_id("frame-loading")).to_have_count(1)
    expect(page.locator("[data-testid=sky-image][data-ready=true]")).to_be_visible(timeout=SLOW_MS)
    expect(page.get_by_test_id("frame-loading")).to_have_count(0)
    assert page.evaluate("window.downloads") == 1
