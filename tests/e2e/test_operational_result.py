"""The ground result on the pages stays that of the configured chain while campaigns run beside it."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def test_a_campaign_changes_no_ground_result_but_a_user_can(page, served, new_frame, at_rest, picture):
    """A campaign with another chain does not change the ground result. A user can select another result of a frame."""
    frame = new_frame(page)
    ra = page.get_by_test_id("ground-ra")
    expect(ra).not_to_have_text("–")
    before, chain_label = ra.inner_text(), page.get_by_test_id("ground-made-with")
    expect(chain_label).to_have_attribute("title", "reference chain, camera cubestar")
    job = served.ask("POST", "/campaigns/reprocess", {"chain": "oersted"})
    served.until(f"/jobs/{job['id']}", lambda j: j["state"] == "done")
    page.reload()
    at_rest(page)
    assert ra.inner_text() == before
    expect(chain_label).to_have_text("Ground, reference")
    picture("operational-live")
    page.goto("/campaigns")
    page.get_by_test_id("chain-row").filter(has_text="oersted").click()
    report = page.get_by_test_id("chain-report")
    expect(report).to_contain_text("Solved over time")
    expect(report).to_contain_text("against the operational ground result")
    page.get_by_test_id("reprocess-chain").select_option("cubestar")
    page.get_by_test_id("reprocess-options").fill("min_area_px")
    expect(page.get_by_test_id("reprocess-start")).to_be_disabled()
    page.get_by_test_id("reprocess-options").fill("min_area_px=2")
    page.get_by_test_id("reprocess-start").click()
    expect(page.get_by_test_id("chain-row").filter(has_text="min_area_px=2")).to_be_visible(timeout=30_000)
    page.get_by_test_id("chain-row").filter(has_text="min_area_px=2").click()
    expect(page.get_by_test_id("chain-report")).to_contain_text("min_area_px=2")
    page.get_by_test_id("against").select_option(
        label=page.get_by_test_id("against").locator("option").nth(1).inner_text()
    )
    expect(page.get_by_test_id("chain-report")).not_to_contain_text("against the operational ground result")
    picture("campaigns-chain")
    page.goto("/frames")
    row = page.locator(f"[data-testid=frame-row][data-frame='{frame}']")
    expect(row).to_contain_text("reference")
    at_rest(page)
    picture("operational-frames")
    row.click()
    expect(page.get_by_test_id("made-with")).to_contain_text("Ground result: reference chain, camera cubestar.")
    expect(page.get_by_test_id("pin-solution")).to_have_count(0)
    other = page.locator("[data-testid=chain-row][data-chain=oersted]")
    other.click()
    at_rest(page)
    picture("operational-frame")
    page.get_by_test_id("pin-solution").click()
    expect(other.get_by_test_id("operational")).to_be_visible()
    expect(page.get_by_test_id("made-with")).to_contain_text("Ground result: oersted chain, camera cubestar.")
    expect(page.get_by_test_id("operational")).to_have_count(1)


def test_an_unfinished_job_shows_only_a_result_of_an_experiment(page, served, new_frame):
    """An unfinished experiment shows the latest result of another one, a queued reprocess job shows no result.
    The address of a job that does not exist states this."""
    new_frame(page)
    first = served.ask("POST", "/campaigns/experiments", {"names": ["moniteq-4-2"], "trials": None, "seed": 1})
    served.until(f"/jobs/{first['id']}", lambda j: j["state"] == "done")
    jobs = [
        served.ask("POST", "/campaigns/experiments", {"names": ["huffman-8-2"], "trials": 1000, "seed": 1}),
        served.ask("POST", "/campaigns/reprocess", {"chain": "oersted"}),
    ]
    page.goto(f"/campaigns?job={jobs[0]['id']}")
    progress, result = page.get_by_test_id("run-progress"), page.get_by_test_id("result")
    expect(progress).to_contain_text("created")
    expect(result.get_by_role("heading", name="Latest result, moniteq-4-2")).to_be_visible()
    page.goto(f"/campaigns?job={jobs[1]['id']}")
    expect(progress).to_contain_text("Waiting")
    expect(progress).to_contain_text("not known yet")
    expect(result.get_by_role("heading", name="result")).to_have_count(0)
    page.goto(f"/campaigns?job={jobs[1]['id'] + 1}")
    expect(page.get_by_test_id("run-missing")).to_contain_text("No such job")
    for job in reversed(jobs):
        served.ask("POST", f"/jobs/{job['id']}/cancel")
