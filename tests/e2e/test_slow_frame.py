"""Loading of a frame over a slow network, in a browser."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]
BYTES_PER_S = 150_000


def test_a_frame_that_loads_slowly_shows_received_and_total_bytes(page: Page, new_frame: Callable[[Page], int]) -> None:
    """While the pixels are received, the page states how many bytes of how many have arrived; afterwards the image is
    shown and the statement disappears."""
    number = new_frame(page)
    page.goto("/frames")
    row = page.get_by_role("link", name=str(number), exact=True).first
    expect(row).to_be_visible()
    network = page.context.new_cdp_session(page)
    limits = {"offline": False, "latency": 0, "uploadThroughput": -1}
    network.send("Network.setCacheDisabled", {"cacheDisabled": True})
    network.send("Network.emulateNetworkConditions", limits | {"downloadThroughput": BYTES_PER_S})
    row.click()
    expect(page.get_by_test_id("frame-loading")).to_have_text(
        re.compile(rf"Loading frame {number}: [\d.]+ (KiB|MiB) of [\d.]+ (KiB|MiB)")
    )
    network.send("Network.emulateNetworkConditions", limits | {"downloadThroughput": -1})
    expect(page.locator("[data-testid=sky-image][data-ready=true]")).to_be_visible()
    expect(page.get_by_test_id("frame-loading")).to_have_count(0)
