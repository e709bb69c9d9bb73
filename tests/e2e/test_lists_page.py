"""Page of star lists: upload, results, export and rejected files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tools.bench_scenes import CAMERAS, Disturbance, star_lists, visible_stars

pytestmark = pytest.mark.browser
OPTICS = CAMERAS[0]


def test_a_file_of_lists_is_solved(page: Page, tmp_path: Path) -> None:
    """A file with an invalid line is rejected with the line number. A valid file gives a row per list and a JSON
    download. The address of a file opens it, also if it is not in the list, and states if there is none.
    """
    scenes = star_lists(visible_stars(OPTICS), OPTICS, 2, Disturbance(3), 31)
    rows = ["list,col_px,row_px,flux"]
    for number, scene in enumerate(scenes):
        pixels = scene.offset_px + np.array([OPTICS.columns - 1, OPTICS.rows - 1]) / 2
        flux = 10 ** (-0.4 * scene.magnitude)
        rows += [f"{number},{float(c)!r},{float(r)!r},{float(f)!r}" for (c, r), f in zip(pixels, flux, strict=True)]
    (tmp_path / "bad.csv").write_text("\n".join([*rows, "1,2,three,4"]))
    (tmp_path / "night.csv").write_text("\n".join(rows))
    page.goto("/frames")
    page.get_by_test_id("import-lists").click()
    page.get_by_test_id("lists-camera").select_option("cubestar")
    page.get_by_test_id("lists-flat").check()
    page.get_by_test_id("lists-file").set_input_files(tmp_path / "bad.csv")
    page.get_by_test_id("lists-start").click()
    expect(page.get_by_test_id("lists-problem")).to_contain_text(f"Line {len(rows) + 1} of bad.csv")
    page.get_by_test_id("lists-file").set_input_files(tmp_path / "night.csv")
    page.get_by_test_id("lists-start").click()
    expect(page.get_by_test_id("lists-result")).to_have_count(2, timeout=240_000)
    expect(page.get_by_test_id("lists-result").first).to_contain_text("solved")
    expect(page.get_by_test_id("lists-row")).to_contain_text("2 of 2 solved")
    with page.expect_download() as file:
        page.get_by_test_id("lists-json").click()
    assert [r["outcome"] for r in json.loads(file.value.path().read_text())["results"]] == ["solved", "solved"]
    run_id = json.loads(file.value.path().read_text())["id"]
    page.route("**/api/lists", lambda route: route.fulfill(json=[]))  # as if 50 other files were newer
    page.goto(f"/frames/lists?id={run_id}")
    expect(page.get_by_test_id("lists-result")).to_have_count(2)
    page.unroute("**/api/lists")
    page.goto(f"/frames/lists?id={run_id + 1}")
    expect(page.get_by_test_id("lists-missing")).to_contain_text("There is no star list run with this number")
