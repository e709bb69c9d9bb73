"""Page of performance sheets: figures from frames, and the requirements of missing rows."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO

import numpy as np
import pytest
from astropy.io import fits
from playwright.sync_api import Page, expect

from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.render import render
from gss.pipeline.sheet.unit import scan

pytestmark = pytest.mark.browser
PROFILE = shipped_camera("cubestar")
FRAMES = 10


@pytest.fixture(scope="module")
def imported(address: str, browser, headers: dict[str, str]) -> str:  # type: ignore[no-untyped-def]
    """Range of the ids of imported frames of ten pointings, as the page expects it."""
    stars, rng = SolverCache().stars(2026.5).brighter_than(6.0), np.random.default_rng(12)
    context = browser.new_context(base_url=address)
    ids = []
    for k, moment in enumerate(scan(FRAMES, rng)):
        hdu = fits.PrimaryHDU(render(stars, PROFILE.camera, PROFILE.sensor, moment.cam_from_icrs, 0.25, rng).pixels)
        hdu.header["DATE-OBS"], hdu.header["EXPTIME"] = f"2026-07-01T00:{k:02d}:00", 0.25
        data = BytesIO()
        hdu.writeto(data)
        file = {"name": f"sky-{k}.fits", "mimeType": "application/fits", "buffer": data.getvalue()}
        answer = context.request.post(
            "/api/frames/import", headers=headers, multipart={"file": file, "profile": "cubestar"}
        )
        assert answer.ok, answer.text()
        ids.append(answer.json()["id"])
    context.close()
    return f"{min(ids)}-{max(ids)}"


def test_a_sheet_is_made_from_frames(page: Page, imported: str, picture: Callable[[str], None]) -> None:
    """The sheet shows the errors of ten pointings in a table and a plot, states that the bias needs a second head, shows
    the methods on a phone, and can be downloaded as PDF.
    """
    page.goto("/sheet")
    page.get_by_test_id("sheet-camera").select_option("cubestar")
    page.get_by_test_id("sheet-frames").fill(imported)
    page.get_by_test_id("sheet-chain").select_option("reference")
    page.get_by_test_id("sheet-start").click()
    expect(page.get_by_test_id("sheet-row")).to_have_count(1, timeout=180_000)
    expect(page.get_by_test_id("sheet-field-of-view")).to_contain_text("one star", timeout=60_000)
    expect(page.get_by_test_id("sheet-bias")).to_contain_text("second head")
    expect(page.get_by_test_id("sheet-acquisition")).to_contain_text("100 %")
    expect(page.get_by_test_id("sheet-panel")).to_contain_text("after ECSS-E-ST-60-20C")
    budget = page.get_by_test_id("report-intervals")
    expect(budget.locator(".group")).to_have_text(["Field-of-view spatial error", "Pixel spatial error"])
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.get_by_test_id("sheet-field-of-view").get_by_text("slow variation")).to_be_visible()
    with page.expect_download() as download:
        page.get_by_test_id("sheet-pdf").click()
    assert download.value.path().read_bytes().startswith(b"%PDF")
    picture("page-sheet-made")
