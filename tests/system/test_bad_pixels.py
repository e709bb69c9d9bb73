"""Bad pixels from the health analysis to the sensor, through a real server and a real simulator."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.timeout(600)
FRAMES, GROUPS = 32, 12


def false_centroids(console, frame: dict, hot: np.ndarray) -> int:
    """Return the number of centroids on board that lie on a group of hot pixels."""
    detail = console.wait(
        "the centroids",
        lambda: (d := console.get(f"/frames/{frame['id']}"))["on_board"] and d["on_board"]["stars"] and d,
    )
    stars = [(s["col_px"], s["row_px"]) for s in detail["on_board"]["stars"]]
    return sum(bool((np.abs(hot - np.array(s)).max(axis=1) < 2).any()) for s in stars)


def new_frame(console, number: int) -> dict:
    return console.wait(
        f"frame {number}",
        lambda: next(
            (f for f in console.get("/frames", limit=1)["frames"] if f["complete"] and f["number"] == number), None
        ),
    )


def iteration(console, number: int) -> dict:
    """Take and process an image on board, and return its frame."""
    console.command("SET_MODE", mode="lost_in_space")
    console.command("RUN_ITERATION")
    return new_frame(console, number)


def test_bad_pixels_of_the_health_analysis_are_masked_on_board(serve):
    """Hot pixels are injected. The health analysis of the frames finds them, its proposal becomes a table, and the table
    is uploaded and activated. The sensor's false detections then end, and its results are replayed equally on the
    ground."""
    console = serve("--simulator", "cubestar").console
    console.wait("the tables on board", lambda: console.get("/tables/on-board"), 60)
    console.command("SIM_INJECT", fault="hot_pixels", value=GROUPS)
    rng = np.random.default_rng(4)
    ids = []
    for number in range(1, FRAMES + 1):
        sky = {"ra_deg": float(rng.uniform(0, 360)), "dec_deg": float(np.degrees(np.arcsin(rng.uniform(-1, 1))))}
        console.command("SIM_SET_SKY", motion="inertial", roll_deg=0.0, rate_deg_s=0.0, **sky)
        console.command("TAKE_IMAGE", slot=number % 4)
        ids.append(new_frame(console, number)["id"])

    body = {"kind": "health", "profile": "cubestar", "frame_ids": ids}
    job = console.post("/analyses", body, 202)
    done = console.wait(
        "the analysis",
        lambda: (j := console.get(f"/jobs/{job['id']}"))["state"] not in ("queued", "running") and j,
        400,
    )
    assert done["state"] == "done", done["text"]
    analysis = done["result"]["analysis_id"]
    bad = np.array(console.get(f"/analyses/{analysis}")["figures"]["proposal"]["bad"])
    assert len(bad) >= 0.9 * 9 * GROUPS
    calibration = console.post(f"/analyses/{analysis}/calibration")
    assert (calibration["bad_pixels"], calibration["no_bad_pixel_table"]) == (len(bad), "")
    table = console.post(f"/calibrations/{calibration['id']}/bad-pixel-table")
    assert table["kind"] == "bad_pixels"
    assert len(table["content"]["pixels"].split()) == len(bad)
    assert console.post(f"/calibrations/{calibration['id']}/bad-pixel-table")["id"] == table["id"]

    before = false_centroids(console, iteration(console, FRAMES + 1), bad)
    assert before >= GROUPS // 2
    transfer = console.post(f"/tables/{table['id']}/upload", {"bank": "A"})
    console.wait("the upload", lambda: console.get(f"/transfers/{transfer['id']}")["state"] == "committed")
    console.command("SET_MODE", mode="lost_in_space")
    sent = console.command("ACTIVATE_TABLE", confirm="ACTIVATE_TABLE", table="bad_pixels", bank="A")
    assert sent["result"] == "completed", sent["detail"]
    console.command("CONFIRM_TABLE", table="bad_pixels")
    places = console.wait(
        "the report of the table",
        lambda: [p for p in console.get(f"/calibrations/{calibration['id']}")["bad_pixel_places"] if "active" in p],
    )
    assert places == ["A, active"]

    frame = iteration(console, FRAMES + 2)
    assert false_centroids(console, frame, bad) == 0
    console.wait("the replay", lambda: console.get(f"/frames/{frame['id']}")["on_board"]["replay"] == "equal")
