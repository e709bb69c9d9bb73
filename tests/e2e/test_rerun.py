"""The embedded viewer of a frame and of live data, in a small window, because it is drawn without a graphics
processor.
"""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import datetime
from itertools import product

import pytest
from playwright.sync_api import Page, expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(600)]
SLOW_MS = 150_000
SMALL = {"width": 1024, "height": 560}
NO_DEBUG = "console.debug = () => {}"
"""The viewer logs 17 000 messages of this level. The browser, playwright and the test process would each handle them."""
IMAGE = re.compile("camera/image")


def viewer(page: Page):
    """Return the viewer's box with its reported state."""
    return page.get_by_test_id("rerun-viewer")


def pick_the_image(page: Page, box) -> None:
    """Click on the picture until the viewer reports it.

    The viewer finds the entity below the pointer some drawings after the pointer moved, and a drawing takes seconds on
    a busy machine. The viewer ignores a click if the button is held for more than 0.8 s between two drawings, so it
    is released immediately.
    """
    for wait_ms, across in product((500, 2000, 5000, 10_000, 20_000), (0.8, 0.72, 0.88)):
        y = box["y"] + box["height"] * 0.25
        for nudge in (0, 2, 1):
            page.mouse.move(box["x"] + box["width"] * across + nudge, y)
            page.wait_for_timeout(wait_ms // 3)
        page.mouse.down()
        page.mouse.up()
        with suppress(AssertionError):
            expect(viewer(page)).to_have_attribute("data-picked", IMAGE, timeout=wait_ms)
            return


def test_the_viewer_opens_on_the_frame_reports_its_selection_and_grows_live(page, new_frame, follow, picture):
    """The viewer shows the frame of the page and reports a clicked entity. The ABORT key works in the viewer, and a
    live recording receives new data.
    """
    page.add_init_script(NO_DEBUG)
    older, newest = new_frame(page), new_frame(page)
    page.set_viewport_size(SMALL)
    page.goto(f"/frames/{older}?rerun=1")
    expect(viewer(page)).to_have_attribute("data-opened", "true", timeout=SLOW_MS)
    expect(viewer(page)).to_have_attribute("data-frame", str(older), timeout=SLOW_MS)
    page.get_by_role("button", name="Newer frame").click(timeout=SLOW_MS)
    expect(page).to_have_url(re.compile(rf"/frames/{newest}\b"))
    expect(viewer(page)).to_have_attribute("data-frame", str(newest), timeout=SLOW_MS)
    box = viewer(page).locator("canvas").bounding_box()
    assert box is not None
    pick_the_image(page, box)
    expect(viewer(page)).to_have_attribute("data-picked", IMAGE)
    picture("rerun")
    page.keyboard.press("Shift+Escape")
    expect(page.get_by_test_id("abort-strip")).to_contain_text("ABORT")

    follow(page, "/rerun?live=1")
    expect(viewer(page)).to_have_attribute("data-pieces", re.compile(r"^[1-9]"), timeout=SLOW_MS)
    pieces = int(viewer(page).get_attribute("data-pieces") or 0)
    expect(viewer(page)).to_have_attribute("data-pieces", re.compile(rf"^(?!{pieces}$)\d+$"), timeout=SLOW_MS)
    assert viewer(page).get_attribute("data-failed") == "false"


def test_the_recording_of_a_contact_opens_at_its_latest_frame(page, new_frame, served):
    """The viewer receives the time of the contact's latest frame, not its first one. The viewer itself is not needed and
    is not loaded.
    """
    new_frame(page)
    newest = new_frame(page)
    frame = served.ask("GET", f"/frames/{newest}")
    page.route("**/*.wasm", lambda route: route.fulfill(status=404))
    page.goto(f"/rerun?contact={frame['contact_id']}")
    taken_ms = datetime.fromisoformat(frame["taken"]).timestamp() * 1000
    expect(viewer(page)).to_have_attribute("data-start", str(round(taken_ms) + 1))
