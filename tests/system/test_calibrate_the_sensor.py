"""A simulated sensor with a wrong lens model is calibrated from its own frames, through a real server."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.timeout(300)
LENS_OFF_PERCENT = 0.5
FRAMES = 8


def take_frames(console, attitudes) -> list[int]:
    """Run an iteration at each attitude and return the ids of the downlinked frames."""
    frame_ids = []
    for ra_deg, dec_deg, roll_deg in attitudes:
        console.command("SIM_SET_SKY", motion="inertial", ra_deg=ra_deg, dec_deg=dec_deg, roll_deg=roll_deg)
        console.command("SET_MODE", mode="lost_in_space")
        console.command("RUN_ITERATION")

        def arrived(known=tuple(frame_ids)):
            rows = [
                f
                for f in console.get("/frames", limit=500)["frames"]
                if f["complete"] and f["id"] > max(known, default=0)
            ]
            return rows[0]["id"] if rows else None

        frame_ids.append(console.wait("the frame", arrived, 40))
    return frame_ids


def on_board_results(console, ids: list[int]) -> tuple[int, list[int]]:
    """Return (number of frames solved on board, stars matched in each). Every ground replay must be equal."""
    solved, matched = 0, []
    for frame_id in ids:
        frame = console.wait(
            "the replay",
            lambda i=frame_id: next(
                (f for f in [console.get(f"/frames/{i}")] if (f["on_board"] or {}).get("replay")), None
            ),
            40,
        )
        on_board = frame["on_board"]
        assert on_board["replay"] == "equal", (frame_id, on_board["replay"])
        solved += on_board["outcome"] == "solved"
        matched.append(
            sum(s.get("hip") is not None for s in on_board["stars"]) if on_board["outcome"] == "solved" else 0
        )
    return solved, matched


def random_attitudes(count: int, seed: int) -> list[tuple[float, float, float]]:
    rng = np.random.default_rng(seed)
    ra, dec, roll = (
        rng.uniform(0, 360, count),
        np.degrees(np.arcsin(rng.uniform(-1, 1, count))),
        rng.uniform(0, 360, count),
    )
    return list(zip(ra.tolist(), dec.tolist(), roll.tolist(), strict=True))


def test_a_sensor_matches_better_after_its_own_frames_calibrated_it(serve):
    """A calibration from the sensor's frames, activated as a table, gives more attitudes and stars. Replays stay
    equal.
    """
    options = {"GSS_SIMULATOR_OPTIONS": f"--lens-off {LENS_OFF_PERCENT}"}
    console = serve("--simulator", "cubestar", **options).console
    console.wait("the sensor", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)
    console.wait("the tables on board", lambda: console.get("/tables/on-board"))

    first = take_frames(console, random_attitudes(FRAMES, 1))
    before, stars_before = on_board_results(console, first)
    body = {"kind": "stars", "profile": "cubestar", "frame_ids": first, "models": ["brown-4"], "psf": False}
    job = console.post("/calibrations", body, status=202)

    def done():
        row = next(j for j in console.get("/jobs") if j["id"] == job["id"])
        assert row["state"] not in ("failed", "cancelled"), row["text"]
        return row if row["state"] == "done" else None

    calibration = console.get(f"/calibrations/{console.wait('the calibration', done, 120)['result']['calibration_id']}")
    defaults = console.get("/tables/defaults", kind="calibration", profile="cubestar")["content"]
    assert calibration["values"]["focal_col_px"] / defaults["focal_col_px"] == pytest.approx(
        1 + LENS_OFF_PERCENT / 100, abs=4e-4
    )

    table = console.post(f"/calibrations/{calibration['id']}/table")
    transfer = console.post(f"/tables/{table['id']}/upload", {"bank": "A"})

    def committed():
        row = console.get(f"/transfers/{transfer['id']}")
        assert row["state"] not in ("failed", "aborted"), row["reason"]
        return row["state"] == "committed"

    console.wait("the table to be committed", committed, 60)
    for name, more in (("VERIFY_TABLE", {"bank": "A"}), ("ACTIVATE_TABLE", {"bank": "A"}), ("CONFIRM_TABLE", {})):
        ended = console.command(name, confirm=name, table="calibration", **more)
        assert ended["result"] == "completed", (name, ended["detail"])
    console.wait(
        "the calibration to be on the sensor",
        lambda: any("active" in p for p in console.get(f"/calibrations/{calibration['id']}")["places"]),
    )

    after, stars_after = on_board_results(console, take_frames(console, random_attitudes(FRAMES, 1)))
    assert after >= before + 3
    assert np.mean(stars_after) > 2 * np.mean(stars_before)
