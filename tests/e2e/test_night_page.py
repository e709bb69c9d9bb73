"""Calibration and analyses on the page, from frames of a night and from bench measurements."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from io import BytesIO

import numpy as np
import pytest
from astropy.io import fits
from playwright.sync_api import Browser, Page, expect

from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.instruments.registry import shipped_camera
from gss.operations.frames.pictures import png
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.analysis.steady import SIDEREAL_RAD_S
from gss.pipeline.readout import HotPixel
from gss.pipeline.render import render
from gss.pipeline.second_lens import SecondLens, through_second_lens

pytestmark = pytest.mark.browser
PROFILE = shipped_camera("cubestar")
TRUE_CAMERA = replace(
    PROFILE.camera, focal_col_px=PROFILE.camera.focal_col_px * 1.001, focal_row_px=PROFILE.camera.focal_row_px * 1.001
)
FRAMES = 8


HOT = (HotPixel(300, 200, 4e4), HotPixel(701, 90, 4e4), HotPixel(120, 400, 4e4))
HOT_FRAMES = 30
"""Fewest frames of a health analysis."""
HEALTH_MS = 400_000


def hot_frame_files() -> Iterator[dict[str, str | bytes]]:
    """Yield frames of the documented camera with three hot pixels, two days apart."""
    stars, rng = SolverCache().stars(2026.5).brighter_than(6.0), np.random.default_rng(5)
    for k in range(HOT_FRAMES):
        attitude = matrix_from_quaternion(random_quaternion(rng))
        pixels = render(stars, PROFILE.camera, PROFILE.sensor, attitude, 0.25, rng, hot_pixels=HOT).pixels
        hdu = fits.PrimaryHDU(pixels)
        taken = datetime(2026, 7, 1, tzinfo=UTC) + timedelta(days=2 * k)
        hdu.header["DATE-OBS"], hdu.header["EXPTIME"] = taken.strftime("%Y-%m-%dT%H:%M:%S"), 0.25
        data = BytesIO()
        hdu.writeto(data)
        yield {"name": f"mission-{k}.fits", "mimeType": "application/fits", "buffer": data.getvalue()}


def frame_files() -> list[dict[str, str | bytes]]:
    """Return eight frames of a fixed camera, four minutes apart."""
    stars, rng = SolverCache().stars(2026.5).brighter_than(6.0), np.random.default_rng(11)
    uploads: list[dict[str, str | bytes]] = []
    for k in range(FRAMES):
        attitude = cam_from_icrs(1.4 + SIDEREAL_RAD_S * 240 * k, 0.2, 0.5)
        hdu = fits.PrimaryHDU(render(stars, TRUE_CAMERA, PROFILE.sensor, attitude, 0.25, rng).pixels)
        hdu.header["DATE-OBS"], hdu.header["EXPTIME"] = f"2026-07-01T00:{4 * k:02d}:00", 0.25
        data = BytesIO()
        hdu.writeto(data)
        uploads.append({"name": f"roof-{k}.fits", "mimeType": "application/fits", "buffer": data.getvalue()})
    return uploads


@pytest.fixture(scope="module")
def imported(address: str, browser, headers: dict[str, str]) -> str:  # type: ignore[no-untyped-def]
    """Range of the ids of imported frames, as the page expects it."""
    context = browser.new_context(base_url=address)
    ids = []
    for file in frame_files():
        answer = context.request.post(
            "/api/frames/import", headers=headers, multipart={"file": file, "profile": "cubestar"}
        )
        assert answer.ok, answer.text()
        ids.append(answer.json()["id"])
    context.close()
    return f"{min(ids)}-{max(ids)}"


def test_a_camera_is_calibrated_used_and_made_into_a_table(
    page: Page, imported: str, picture: Callable[[str], None]
) -> None:
    """Frames give a calibration with residuals, which can be used for reruns, sent as a table, and downloaded as a
    report.
    """
    page.goto("/calibration")
    form = page.get_by_test_id("calibrate-form")
    form.get_by_test_id("calibrate-frames").fill("12-")
    expect(form).to_contain_text("not a number or a range")
    form.get_by_test_id("calibrate-frames").fill("99999")
    expect(form.get_by_test_id("calibrate-frames-note")).to_have_text("Not stored: frame 99999.")
    form.get_by_test_id("calibrate-frames").fill(imported)
    expect(form).to_contain_text(f"{FRAMES} frames")
    form.get_by_label("Lens model").select_option("brown-4")
    form.get_by_test_id("calibrate-start").click()
    expect(page.get_by_test_id("version-row")).to_have_count(1)
    report = page.get_by_test_id("study-report")
    expect(report).to_contain_text("Residuals after")
    expect(report).to_contain_text("focal_px")
    page.get_by_test_id("use-calibration").click()
    expect(page.get_by_text("cubestar: calibration 1 active")).to_be_visible()
    page.get_by_test_id("make-table").click()
    expect(page.get_by_test_id("table-row")).to_have_count(1)
    picture("calibration")
    page.get_by_test_id("use-documented").click()
    expect(page.get_by_text("not used for reruns")).to_be_visible()
    with page.expect_download() as download:
        page.get_by_role("link", name="PDF").click()
    assert download.value.path().read_bytes().startswith(b"%PDF")


def test_a_night_becomes_a_report(page: Page, imported: str, picture: Callable[[str], None]) -> None:
    """The Earth-fixed analysis states the sidereal rate. A slew without its rate cannot be requested, and an analysis
    of too few frames fails with the reason, which a reload keeps.
    """
    page.goto("/calibration?tab=analyses")
    form = page.get_by_test_id("analyse-form")
    form.get_by_test_id("analyse-frames").fill(imported)
    form.get_by_test_id("analyse-kind").select_option("slew")
    expect(form.get_by_test_id("analyse-start")).to_be_disabled()
    form.get_by_test_id("analyse-kind").select_option("earth-fixed")
    form.get_by_test_id("analyse-start").click()
    report = page.get_by_test_id("study-report")
    expect(report).to_contain_text("camera rotation")
    expect(report).to_contain_text("expected 15.04")
    picture("analyses")
    form.get_by_test_id("analyse-frames").fill(imported.split("-")[0])
    form.get_by_test_id("analyse-start").click()
    expect(page.get_by_test_id("study-failed")).to_contain_text("Too few attitudes")
    page.reload()
    expect(page.get_by_test_id("study-failed")).to_contain_text("Too few attitudes")


def test_moving_objects_are_searched_for_and_offered_as_tdm(page: Page, imported: str) -> None:
    """A site must have three numbers. The search for moving objects gives a report and a TDM."""
    page.goto("/calibration?tab=analyses")
    form = page.get_by_test_id("analyse-form")
    form.get_by_test_id("analyse-kind").select_option("moving")
    form.get_by_test_id("analyse-frames").fill(imported)
    form.get_by_test_id("analyse-site").fill("48 north")
    expect(form.get_by_test_id("analyse-start")).to_be_disabled()
    form.get_by_test_id("analyse-site").fill("48.1, 11.3, 520")
    form.get_by_test_id("analyse-start").click()
    expect(page.get_by_test_id("study-report")).to_contain_text("faintest point found")
    expect(page.get_by_test_id("study-tdm")).to_have_attribute("href", re.compile("kind=tdm"))


def test_bad_pixels_of_a_health_analysis_become_a_table(
    page: Page, address: str, browser: Browser, headers: dict[str, str]
) -> None:
    """The report of a health analysis proposes a calibration. Its hot pixels become a table once, which the list of
    tables shows."""
    context = browser.new_context(base_url=address)
    ids = []
    for file in hot_frame_files():
        answer = context.request.post(
            "/api/frames/import", headers=headers, multipart={"file": file, "profile": "cubestar"}
        )
        assert answer.ok, answer.text()
        ids.append(answer.json()["id"])
    context.close()
    page.goto("/calibration?tab=analyses")
    form = page.get_by_test_id("analyse-form")
    form.get_by_test_id("analyse-kind").select_option("health")
    form.get_by_test_id("analyse-frames").fill(f"{min(ids)}-{max(ids)}")
    form.get_by_test_id("analyse-start").click()
    page.get_by_test_id("study-propose").click(timeout=HEALTH_MS)
    create = page.get_by_test_id("make-bad-pixel-table")
    expect(page.get_by_text(f"{len(HOT)} bad pixels: not on the sensor")).to_be_visible()
    create.click()
    expect(page.get_by_text(f"{len(HOT)} bad pixels: table stored, not on the sensor")).to_be_visible()
    expect(create).to_be_disabled()
    tables = page.get_by_test_id("tables")
    tables.get_by_role("button", name="Bad pixels").click()
    expect(tables.get_by_test_id("table-row")).to_have_count(1)


def test_a_pasted_bench_measurement_is_used_as_prior(page: Page, imported: str) -> None:
    """A pasted table with an invalid row is rejected. A valid one gives a version that a star calibration can use as
    prior.
    """
    page.goto("/calibration")
    form = page.get_by_test_id("calibrate-form")
    form.get_by_role("button", name="Bench").click()
    expect(form.get_by_test_id("calibrate-start")).to_be_disabled()
    form.get_by_test_id("bench-rows").fill("col,row\n1,2\n3")
    expect(form.get_by_test_id("bench-read")).to_contain_text("line 3 is not 2 numbers")
    angle = np.arange(24) * 2 * np.pi / 24
    rows = "\n".join(f"{511.5 + 9 * np.cos(a):.3f}\t{255.5 + 9 * np.sin(a):.3f}" for a in angle)
    form.get_by_test_id("bench-rows").fill("col\trow\n" + rows)
    expect(form.get_by_test_id("bench-read")).to_contain_text("24 rows")
    form.get_by_test_id("calibrate-start").click()
    expect(page.get_by_test_id("study-report")).to_contain_text("Optical centre from a dot")
    form.get_by_role("button", name="Stars").click()
    expect(form.get_by_test_id("prior")).to_have_count(1)
    form.get_by_test_id("prior").check()
    form.get_by_test_id("calibrate-frames").fill(imported)
    form.get_by_label("Lens model").select_option("brown-4")
    form.get_by_test_id("calibrate-start").click()
    expect(page.get_by_test_id("study-report")).to_contain_text("Residuals after")


def test_a_principal_point_is_measured_from_pictures_through_a_second_lens(
    page: Page,
    address: str,
    browser: Browser,
    headers: dict[str, str],
) -> None:
    """The method needs frames only. Its report shows the principal point of the rendered camera."""
    camera = replace(PROFILE.camera, centre_col_px=530.0, centre_row_px=240.0)
    picture = through_second_lens(camera, PROFILE.sensor, SecondLens(0.05), np.random.default_rng(2))
    file = {"name": "circle.png", "mimeType": "image/png", "buffer": png(picture)}
    context = browser.new_context(base_url=address)
    answer = context.request.post(
        "/api/frames/import", headers=headers, multipart={"file": file, "profile": "cubestar"}
    )
    assert answer.ok, answer.text()
    frame = answer.json()["id"]
    context.close()
    page.goto("/calibration")
    form = page.get_by_test_id("calibrate-form")
    form.get_by_role("button", name="Bench").click()
    form.get_by_test_id("bench-method").select_option("bench-second-lens")
    expect(form.get_by_test_id("bench-rows")).to_have_count(0)
    expect(form.get_by_test_id("calibrate-start")).to_be_disabled()
    form.get_by_test_id("bench-frames").fill(str(frame))
    form.get_by_test_id("calibrate-start").click()
    report = page.get_by_test_id("study-report")
    expect(report).to_contain_text("Principal point from a second lens")
    expect(report).to_contain_text(re.compile(r"(529\.9|530\.0)\d*, (239\.9|240\.0)"))
